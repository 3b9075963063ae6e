"""All cases of primitives, in groups of one compilation each."""

from contracts import array_cases as arrays
from contracts import control_cases as control
from contracts import elementwise_cases as elements

ELEMENTS = (elements.arithmetic, elements.unary, elements.elementary, elements.conversions, elements.choices)
ARRAYS = (arrays.moves, arrays.reductions, arrays.indexed, arrays.matrices)
CONTROL = (control.calls, control.old_arrays, control.branches, control.scans, control.whiles, control.derivatives)
ALL = (*ELEMENTS, *ARRAYS, *CONTROL)
