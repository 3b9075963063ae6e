"""Lowering rules for primitives that work element by element."""

from collections.abc import Callable

from jax import lax

from trimtab.compiler.arrays import (
    Array,
    ElementUpdate,
    Index,
    apply_updates,
    build_array,
    element_list,
    read_element,
)
from trimtab.compiler.ir import Builder, is_float
from trimtab.compiler.lower import Rule, Site, is_alone
from trimtab.compiler.values import Value
from trimtab.core.errors import InputError

Element = Callable[[Site, list[Value]], Value]

SAME = ("add", "sub", "mul", "div", "max", "min", "neg", "abs", "and", "or", "xor", "not", "rem", "pow", "atan2")
SAME += ("shift_left", "shift_right_logical", "shift_right_arithmetic", "nextafter", "clz", "population_count", "sign")
SAME += ("sqrt", "rsqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "tan", "asin", "acos", "atan")
SAME += ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf", "erfc", "logistic", "floor", "ceil")
COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")


def elementwise(element: Element) -> Rule:
    """Return the rule that applies element(site, values) at every index. Operands of shape () are broadcast."""

    def rule(site: Site) -> list[Array]:
        return [map_elements(site, lambda values: element(site, values), site.operands)]

    return rule


def map_elements(site: Site, element: Callable[[list[Value]], Value], operands: list[Array]) -> Array:
    """Return the array with element(values) at every index. values: elements of the operands at this index."""

    def one(index: Index) -> Value:
        return element([read_element(site.b, a, index if a.shape else []) for a in operands])

    return build_array(site.b, site.shape, site.dtype, one)


def _same_operation(op: str) -> Element:
    def element(site: Site, v: list[Value]) -> Value:
        return site.b.op(op, *v, dtype=site.dtype)

    return element


def _comparison(op: str) -> Element:
    def element(site: Site, v: list[Value]) -> Value:
        return site.b.op(op, *v, dtype="bool")

    return element


def _select(site: Site) -> list[Array]:
    """Select element by element. If two arrays differ only in pending updates, only those elements are written."""
    b, [test, *cases] = site.b, site.operands
    if any(c.updates for c in cases):
        shared = all(c.buffer is cases[0].buffer and c.offset is None for c in cases)
        if shared and not test.shape and test.dtype == "bool":
            return [_select_updates(site, element_list(b, test)[0], cases)]
        alone = [dies and is_alone(site.operands, i) for i, dies in enumerate(site.dying) if i]
        cases = [apply_updates(b, c, a) if c.updates else c for c, a in zip(cases, alone, strict=True)]
    return [map_elements(site, lambda v: select_case(b, v[0], v[1:]), [test, *cases])]


def _select_updates(site: Site, test: Value, cases: list[Array]) -> Array:
    """Return the array in the buffer that both cases share, with the updates of the chosen case."""
    b, updates = site.b, list[ElementUpdate]()
    for case, chosen in zip(cases, (b.op("not", test, dtype="bool"), test), strict=True):
        updates += [u._replace(inside=b.op("and", chosen, u.inside, dtype="bool")) for u in case.updates]
    array = Array(site.shape, site.dtype, buffer=cases[0].buffer, updates=tuple(updates))
    return apply_updates(b, array, True) if all(site.dying[1:]) else array


def select_case(b: Builder, which: Value, cases: list[Value]) -> Value:
    """Return the case that `which` chooses: a bool, or an integer that is clipped to the range."""
    if which.dtype == "bool":
        return b.op("select", which, cases[1], cases[0], dtype=cases[0].dtype) if len(cases) > 1 else cases[0]
    found = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        test = b.op("le", which, b.const(i, which.dtype), dtype="bool")
        found = b.op("select", test, cases[i], found, dtype=found.dtype)
    return found


def _clamp(site: Site, v: list[Value]) -> Value:
    low, x, high = v
    return site.b.op("min", site.b.op("max", x, low, dtype=x.dtype), high, dtype=x.dtype)


def _integer_pow(site: Site, v: list[Value]) -> Value:
    b, x, y = site.b, v[0], site.params["y"]
    one = b.const(1, x.dtype)
    if y == 0:
        return one
    left, found = abs(y), None
    while left:
        if left & 1:
            found = x if found is None else b.op("mul", found, x, dtype=x.dtype)
        left >>= 1
        if left:
            x = b.op("mul", x, x, dtype=x.dtype)
    assert found is not None
    return b.op("div", one, found, dtype=x.dtype) if y < 0 else found


def _square(site: Site, v: list[Value]) -> Value:
    return site.b.op("mul", v[0], v[0], dtype=site.dtype)


def _sin_or_cos(which: int) -> Element:
    def element(site: Site, v: list[Value]) -> Value:
        pair = site.b.op("sincos", v[0], dtype=site.dtype)
        return site.b.op(("sin_of", "cos_of")[which], pair, dtype=site.dtype)

    return element


def _pow(site: Site, v: list[Value]) -> Value:
    b = site.b
    if v[1].dtype != site.dtype:
        v = [v[0], b.op("convert", v[1], dtype=site.dtype)]
    return b.op("pow", *v, dtype=site.dtype)


def _round(site: Site, v: list[Value]) -> Value:
    even = site.params["rounding_method"] == lax.RoundingMethod.TO_NEAREST_EVEN
    return site.b.op("round_even" if even else "round_away", v[0], dtype=site.dtype)


def _is_finite(site: Site, v: list[Value]) -> Value:
    return site.b.op("is_finite", v[0], dtype="bool")


def convert(b: Builder, value: Value, dtype: str) -> Value:
    """Return a value converted to another type as in JAX: a number out of range saturates, NaN becomes 0."""
    if dtype == "bool" and value.dtype != "bool":
        return b.op("ne", value, b.const(0, value.dtype), dtype="bool")
    return b.op("convert", value, dtype=dtype)


def _convert(site: Site, v: list[Value]) -> Value:
    return convert(site.b, v[0], site.dtype)


def _bitcast(site: Site) -> list[Array]:
    source = site.operands[0]
    if source.dtype == site.dtype:
        return [source]
    if source.dtype[1:] != site.dtype[1:] or "bool" in (source.dtype, site.dtype):
        problem = f"bitcast of {source.dtype} to {site.dtype} changes the width"
        raise InputError("export", problem, fix="cast between types of the same width")
    return [map_elements(site, lambda v: site.b.op("bitcast", v[0], dtype=site.dtype), [source])]


def _iota(site: Site) -> list[Array]:
    axis = site.params["dimension"]
    return [build_array(site.b, site.shape, site.dtype, lambda index: convert(site.b, index[axis], site.dtype))]


def _total_less(site: Site, v: list[Value]) -> Value:
    """Return x < y with NaN as the largest number, as in jnp.searchsorted. JAX has made all zeros and all NaN equal."""
    b, (x, y) = site.b, v
    less = b.op("lt", x, y, dtype="bool")
    if not is_float(x.dtype):
        return less
    last = b.op("and", b.op("eq", x, x, dtype="bool"), b.op("ne", y, y, dtype="bool"), dtype="bool")
    return b.op("or", less, last, dtype="bool")


def _total_less_or_equal(site: Site, v: list[Value]) -> Value:
    b, (x, y) = site.b, v
    return _or_all_nan(b, b.op("le", x, y, dtype="bool"), [y])


def _total_equal(site: Site, v: list[Value]) -> Value:
    return _or_all_nan(site.b, site.b.op("eq", *v, dtype="bool"), v)


def _or_all_nan(b: Builder, test: Value, values: list[Value]) -> Value:
    """Return a test that is true if `test` is true, or if all these values are NaN."""
    if not is_float(values[0].dtype):
        return test
    nan = b.const(1, "bool")
    for x in values:
        nan = b.op("and", nan, b.op("ne", x, x, dtype="bool"), dtype="bool")
    return b.op("or", test, nan, dtype="bool")


def _empty(site: Site) -> list[Array]:
    """Return zeros for an uninitialised array, which is written before it is read."""
    return [build_array(site.b, site.shape, site.dtype, lambda index: site.b.const(0, site.dtype))]


def _same_array(site: Site) -> list[Array]:
    return [*site.operands]


RULES: dict[str, Rule] = {op: elementwise(_same_operation(op)) for op in SAME}
RULES |= {op: elementwise(_comparison(op)) for op in COMPARISONS}
RULES |= {
    "select_n": _select,
    "clamp": elementwise(_clamp),
    "integer_pow": elementwise(_integer_pow),
    "square": elementwise(_square),
    "sin": elementwise(_sin_or_cos(0)),
    "cos": elementwise(_sin_or_cos(1)),
    "pow": elementwise(_pow),
    "round": elementwise(_round),
    "is_finite": elementwise(_is_finite),
    "convert_element_type": elementwise(_convert),
    "add_any": elementwise(_same_operation("add")),
    "lt_to": elementwise(_total_less),
    "le_to": elementwise(_total_less_or_equal),
    "eq_to": elementwise(_total_equal),
    "bitcast_convert_type": _bitcast,
    "iota": _iota,
    "empty2": _empty,
    "copy": _same_array,
    "device_put": _same_array,
    "name": _same_array,
    "optimization_barrier": _same_array,
    "stop_gradient": _same_array,
}

__all__ = ["RULES", "convert", "map_elements", "select_case"]
