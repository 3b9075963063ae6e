"""All cases of primitives, in groups of one compilation each."""

from contracts import array_cases as arrays
from contracts import control_cases as control
from contracts import elementwise_cases as elements
from contracts import library_cases as library
from contracts import special_cases as special

ELEMENTS = (elements.arithmetic, elements.unary, elements.elementary, elements.conversions, elements.choices)
ARRAYS = (arrays.moves, arrays.reductions, arrays.indexed, arrays.matrices)
CONTROL = (control.calls, control.old_arrays, control.branches, control.scans, control.whiles, control.derivatives)
LIBRARY = (library.factors, library.orders, library.windows, library.randoms, library.functions)
LIBRARY += (special.reflections, special.singular, special.families, special.raised)
ALL = (*ELEMENTS, *ARRAYS, *CONTROL, *LIBRARY)
