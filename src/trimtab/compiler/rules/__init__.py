"""Which rule lowers which primitive."""

from trimtab.compiler.lower import Rule
from trimtab.compiler.rules import control, elementwise, index, linalg, reduce, shape

RULES: dict[str, Rule] = {
    **elementwise.RULES,
    **shape.RULES,
    **reduce.RULES,
    **index.RULES,
    **control.RULES,
    **linalg.RULES,
}
"""Primitive name -> rule."""
