"""What is wrong, missing or ambiguous in the source, and what stands in its place here; the docs page renders it.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from studies.hypersonic2022._errata_estimator import ENTRIES as ESTIMATOR
from studies.hypersonic2022._errata_law import ENTRIES as LAW
from studies.hypersonic2022._errata_model import ENTRIES as MODEL
from studies.hypersonic2022._errata_numbers import ENTRIES as NUMBERS

ERRATA = (*MODEL, *ESTIMATOR, *LAW, *NUMBERS)
