"""Table of the rules that lower JAX primitives."""

from trimtab.compiler.lower import Rule
from trimtab.compiler.rules import (
    composite,
    control,
    elementwise,
    factors,
    index,
    linalg,
    product,
    random,
    reduce,
    shape,
    special,
    window,
)

RULES: dict[str, Rule] = {
    **elementwise.RULES,
    **shape.RULES,
    **reduce.RULES,
    **product.RULES,
    **index.RULES,
    **control.RULES,
    **linalg.RULES,
    **composite.RULES,
    **factors.RULES,
    **special.RULES,
    **random.RULES,
    **window.RULES,
}
RULES |= {name: random.key_rule(RULES[name]) for name in random.OF_KEYS if name in RULES}
RULES |= {name: composite.one_or_each(RULES[name], rule) for name, rule in composite.EACH.items()}
"""Name of a JAX primitive -> the rule that lowers it."""
