"""Which rule lowers which primitive."""

from trimtab.export.lower import Rule
from trimtab.export.rules import control, elementwise, index, linalg, reduce, shape

RULES: dict[str, Rule] = {
    **elementwise.RULES,
    **shape.RULES,
    **reduce.RULES,
    **index.RULES,
    **control.RULES,
    **linalg.RULES,
}
"""Primitive name -> rule."""
