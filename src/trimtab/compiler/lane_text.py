"""C++ text of one operation over lanes: GCC vector extensions, one run in each lane, truth values as masks."""

from trimtab.compiler.c_functions import vector_type
from trimtab.compiler.ir import Buffer, Value, is_float
from trimtab.compiler.scalar_text import (
    C_NAMES,
    COMPARE,
    ELEMENTARY,
    INFIX,
    SHIFTS,
    SHORT_NAMES,
    Name,
    Use,
    is_known_number,
    is_safe_divisor,
)
from trimtab.core.errors import InputError

LANE_TYPES = ("bool", "i32", "i64", "u32", "u64", "f64")


def check_type(dtype: str) -> None:
    """Refuse numbers that lanes don't carry; the caller falls back to scalar code."""
    if dtype not in LANE_TYPES:
        raise InputError(
            "lanes", f"numbers of type {dtype} are not carried in lanes", choices=LANE_TYPES, fix="lanes=1"
        )


def lane_mask(mask: str, dtype: str) -> str:
    """A mask as wide as the numbers that it selects."""
    return f"__builtin_convertvector({mask}, vi32)" if dtype in ("i32", "u32", "f32") else mask


def lane_expression(v: Value, name: Name, use: Use, varies: object) -> str:
    """The right-hand side of a value that differs between lanes. name gives operands as vectors, except an index."""
    check_type(v.dtype)
    op = v.op
    if op == "load":
        return _lane_load(v, name, use, varies)
    a = [name(x) for x in v.args]
    t = v.args[0].dtype
    if op in COMPARE:
        if t == "bool":  # true is -1 in a mask
            a = [a[1], a[0]]
        return _lane_mask_text(f"{a[0]} {COMPARE[op]} {a[1]}", t)
    if op == "select":
        return f"{lane_mask(a[0], v.dtype)} ? {a[1]} : {a[2]}"
    if op == "convert":
        return _lane_conversion(v, a[0], t, use)
    if op == "bitcast":
        return f"({vector_type(v.dtype)}){a[0]}"
    if op in ("div", "rem") and not is_float(t):
        if is_safe_divisor(v.args[1]):
            return f"{a[0]} {'/' if op == 'div' else '%'} {a[1]}"
        return f"{use(f'tv_{op}_{t}')}({a[0]}, {a[1]})"
    if op in INFIX:
        return f"{a[0]} {INFIX[op]} {a[1]}"
    if op in SHIFTS:
        return _lane_shift(v, a, t, use)
    return _lane_other(v, a, t, use)


def _lane_mask_text(text: str, t: str) -> str:
    return f"__builtin_convertvector({text}, vi64)" if t in ("i32", "u32") else f"(vi64)({text})"


def _lane_other(v: Value, a: list[str], t: str, use: Use) -> str:
    op = v.op
    if op == "neg":
        return f"-{a[0]}"
    if op == "not":
        return f"~{a[0]}"
    if op == "abs":
        if is_float(t):
            return f"(vf64)((vu64){a[0]} & {use('tv_splat_u64')}(0x7fffffffffffffffULL))"
        return a[0] if t[0] == "u" else f"{a[0]} < 0 ? -{a[0]} : {a[0]}"
    if op in ("max", "min"):
        return _lane_extreme(v, a, t, use)
    if op == "is_finite":
        return f"(vi64)({a[0]} - {a[0]} == 0)"
    if op == "sign":
        splat = use(f"tv_splat_{t}")
        below = a[0] if t[0] == "u" else f"({a[0]} < 0 ? {splat}(-1) : {a[0]})"
        return f"{a[0]} > 0 ? {splat}(1) : {below}"
    if op in ("clz", "population_count"):
        return f"{use(f'tv_{SHORT_NAMES.get(op, op)}_{t}')}({a[0]})"
    if op == "nextafter":
        return f"{use('tv_nextafter_f64')}({a[0]}, {a[1]})"
    if op in ELEMENTARY or op == "rem":
        return f"{use(f'ttv_{C_NAMES.get(op, op)}')}({', '.join(a)})"
    raise KeyError(op)


def _lane_extreme(v: Value, a: list[str], t: str, use: Use) -> str:
    if t == "bool":
        return f"{a[0]} {'|' if v.op == 'max' else '&'} {a[1]}"
    if not is_float(t):
        return f"{a[0]} {'>' if v.op == 'max' else '<'} {a[1]} ? {a[0]} : {a[1]}"
    for x, y, known in ((a[0], a[1], v.args[1]), (a[1], a[0], v.args[0])):
        if is_known_number(known):
            return f"{x} {'<' if v.op == 'max' else '>'} {y} ? {y} : {x}"
    return f"{use(f'tv_{v.op}_{t}')}({a[0]}, {a[1]})"


def _lane_shift(v: Value, a: list[str], t: str, use: Use) -> str:
    by, bits = v.args[1], int(t[1:])
    if by.op != "const" or not 0 <= int(by.const) < bits:
        return f"{use(f'tv_{SHIFTS[v.op]}_{t}')}({a[0]}, {a[1]})"
    n = int(by.const)
    if v.op == "shift_right_arithmetic":
        return f"{a[0]} >> {n}" if t[0] == "i" else f"(v{t})((vi{bits}){a[0]} >> {n})"
    sign = "<<" if v.op == "shift_left" else ">>"
    return f"{a[0]} {sign} {n}" if t[0] == "u" else f"(v{t})((vu{bits}){a[0]} {sign} {n})"


def _lane_conversion(v: Value, a: str, source: str, use: Use) -> str:
    to = v.dtype
    check_type(source)
    if source == "bool":
        one = f"{use(f'tv_splat_{to}')}(1)"
        return f"{lane_mask(a, to)} ? {one} : (v{to}){{}}"
    if is_float(source):
        return f"{use(f'tv_{to}_of_f64')}({a})"
    return f"__builtin_convertvector({a}, v{to})"


def _lane_load(v: Value, name: Name, use: Use, varies: object) -> str:
    buffer, index = v.attr, v.args[0]
    assert isinstance(buffer, Buffer)
    assert callable(varies)
    if not varies(index):
        return f"{name(buffer)}[{name(index)}]"  # pyright: ignore[reportArgumentType]
    kind = "pick" if varies(buffer) else "take"
    return f"{use(f'tv_{kind}_{v.dtype}')}({name(buffer)}, {name(index)})"  # pyright: ignore[reportArgumentType]
