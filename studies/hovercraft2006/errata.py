"""What is wrong, missing or ambiguous in the source, and what stands in its place here; the docs page renders it.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from studies.hovercraft2006._errata_navigation import ENTRIES as NAVIGATION
from studies.hovercraft2006._errata_rig import ENTRIES as RIG
from studies.hovercraft2006._errata_vehicle import ENTRIES as VEHICLE

ERRATA = (*VEHICLE, *NAVIGATION, *RIG)
