"""Intermediate representation between JAX and C: scalar values, buffers for large arrays, branches and loops.

Each value is assigned once and belongs to one block. Equal computations are found and done once. The results of a
branch are joins. Values that pass from one iteration of a loop to the next are carries. The same program is written as
scalar C, or as C++ for lanes (vectors with one run in each lane).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from trimtab.compiler.narrow import narrow_integer
from trimtab.compiler.ranges import certain_result
from trimtab.compiler.values import Buffer, Value

TYPES = {
    "bool": np.bool_,
    "i8": np.int8,
    "i16": np.int16,
    "i32": np.int32,
    "i64": np.int64,
    "u8": np.uint8,
    "u16": np.uint16,
    "u32": np.uint32,
    "u64": np.uint64,
    "f32": np.float32,
    "f64": np.float64,
}
NAMES = {np.dtype(t): name for name, t in TYPES.items()}


def is_float(dtype: str) -> bool:
    """Return True if this is a floating-point type."""
    return dtype[0] == "f"


class Block:
    """Block of a program: a sequence of statements."""

    def __init__(self) -> None:
        self.items: list[Any] = []


class Define:
    """Statement that computes a value."""

    def __init__(self, value: Value) -> None:
        self.value = value


class Local:
    """Statement that declares a buffer in a block."""

    def __init__(self, buffer: Buffer) -> None:
        self.buffer = buffer


class Store:
    """Statement that writes a value to buffer[index]."""

    def __init__(self, buffer: Buffer, index: Value, value: Value) -> None:
        self.buffer, self.index, self.value = buffer, index, value


class If:
    """Branch statement. joins: (result, value from the first block, value from the second block)."""

    def __init__(self, test: Value, first: Block, second: Block) -> None:
        self.test, self.first, self.second = test, first, second
        self.joins: list[tuple[Value, Value, Value]] = []

    def join(self, x: Value, y: Value) -> Value:
        """Return the value that is x if the first block is executed, else y."""
        if x is y:
            return x
        joined = Value("join", (), x.dtype)
        self.joins.append((joined, x, y))
        return joined


class Emit:
    """Statement that outputs values, e.g. a row of the log. `Writer.record` writes its C text."""

    def __init__(self, values: list[Value]) -> None:
        self.values = values


class Loop:
    """Loop statement that repeats `count` times or, if count is None, while the test computed in its head block holds.

    count: an integer, the name of a C variable, or a value that is equal in all lanes.
    carries: (variable, value before the first iteration, value after each iteration).
    """

    def __init__(self, count: "int | str | Value | None", index: Value, body: Block) -> None:
        self.count, self.index, self.body = count, index, body
        self.head = Block()
        self.test: Value | None = None
        self.carries: list[tuple[Value, Value, Value]] = []


class Builder:
    """Builder of a program. With `hoist`, computations that use only invariant inputs move to the beginning of the
    program."""

    def __init__(self, hoist: bool = False) -> None:
        self.prologue, self.top = Block(), Block()
        self.blocks: list[Block] = [self.prologue, self.top]
        self.known: list[dict[Any, Any]] = [{}, {}]
        self.constants: dict[Any, Value] = {}
        self.hoist = hoist

    @property
    def block(self) -> Block:
        """Return the block to which statements are appended now."""
        return self.blocks[-1]

    @contextmanager
    def write_into(self, block: Block) -> Iterator[None]:
        """Append statements to this block. Values computed in it cannot be used outside it."""
        self.blocks.append(block)
        self.known.append({})
        try:
            yield
        finally:
            self.blocks.pop()
            self.known.pop()

    @property
    def is_in_loop(self) -> bool:
        """Return True if the statements added now are inside a loop or branch."""
        return len(self.blocks) > 2

    def before_all(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return the value with this key. If it is new, compute it before all enclosing loops and branches."""
        if key not in self.known[1]:
            blocks, known = self.blocks, self.known
            self.blocks, self.known = blocks[:2], known[:2]
            self.known[1][key] = make()
            self.blocks, self.known = blocks, known
        return self.known[1][key]

    def memoise(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return the value with this key from this block or an enclosing block. Create the value if it is missing."""
        for table in reversed(self.known):
            if key in table:
                return table[key]
        return self.known[-1].setdefault(key, make())

    def const(self, number: Any, dtype: str) -> Value:
        """Return a constant number of this type as a value."""
        exact = np.asarray(number).astype(TYPES[dtype])
        key = dtype, exact.tobytes()
        if key not in self.constants:
            self.constants[key] = Value("const", (), dtype, const=exact[()])
        return self.constants[key]

    def index(self, number: int) -> Value:
        """Return a constant index (int32) as a value."""
        return self.constants.get(number) or self.constants.setdefault(number, self.const(number, "i32"))

    def op(self, op: str, *args: Value, dtype: str, attr: Any = None) -> Value:
        """Return the value of an operation: a known constant, an equal value computed before, or a new one."""
        folded = _fold(self, op, args, dtype)
        if folded is not None:
            return folded
        key = (op, tuple(map(id, args)), dtype, attr)
        for table in reversed(self.known):
            if key in table:
                return table[key]
        value = Value(op, args, dtype, attr)
        value.invariant = self.hoist and bool(args) and all(a.invariant for a in args)
        at = 0 if value.invariant else -1
        self.blocks[at].items.append(Define(value))
        self.known[at][key] = value
        return value

    def load(self, buffer: Buffer, index: Value) -> Value:
        """Return the current value of an element of a buffer."""
        if buffer.data is not None and index.op == "const":
            return self.const(buffer.data[int(index.const)], buffer.dtype)
        if buffer.is_read_only:
            return self.op("load", index, dtype=buffer.dtype, attr=buffer)
        value = Value("load", (index,), buffer.dtype, buffer)
        self.block.items.append(Define(value))
        return value

    def local_buffer(self, dtype: str, size: int) -> Buffer:
        """Declare a new buffer in the current block and return it."""
        buffer = Buffer(dtype, size, "local")
        self.block.items.append(Local(buffer))
        return buffer

    def store(self, buffer: Buffer, index: Value, value: Value) -> None:
        """Write one element of a buffer."""
        self.block.items.append(Store(buffer, index, value))

    def loop(
        self, count: int | Value, starts: list[Value], body: Callable[[Value, list[Value]], list[Value]]
    ) -> list[Value]:
        """Write a loop that runs body(index, carried) `count` times. Return the values carried at its end."""
        made = Loop(count, Value("index", (), "i32", attr=count), Block())
        variables = [Value("carry", (), s.dtype) for s in starts]
        with self.write_into(made.body):
            nexts = body(made.index, variables)
        made.carries = list(zip(variables, starts, nexts, strict=True))
        self.block.items.append(made)
        return variables

    def repeat(self, count: int | Value, body: Callable[[Value], None]) -> None:
        """Write a loop that runs body(index) `count` times."""

        def nothing(index: Value, carried: list[Value]) -> list[Value]:
            body(index)
            return carried

        self.loop(count, [], nothing)

    def loop_while(
        self,
        starts: list[Value],
        test: Callable[[list[Value]], Value],
        body: Callable[[list[Value]], list[Value]],
    ) -> list[Value]:
        """Write a loop that runs body(carried) while test(carried) holds. Return the values carried at its end."""
        made = Loop(None, Value("index", (), "i32"), Block())
        variables = [Value("carry", (), s.dtype) for s in starts]
        with self.write_into(made.head):
            made.test = test(variables)
        with self.write_into(made.body):
            nexts = body(variables)
        made.carries = list(zip(variables, starts, nexts, strict=True))
        self.block.items.append(made)
        return variables

    def branch(self, test: Value, first: Callable[[], Value], second: Callable[[], Value]) -> Value:
        """Write a branch and return its result: first() if the test holds, else second(). Only one is computed."""
        made = If(test, Block(), Block())
        with self.write_into(made.first):
            x = first()
        with self.write_into(made.second):
            y = second()
        self.block.items.append(made)
        return made.join(x, y)


_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
}


def _are_zeros(x: Any, y: Any) -> bool:
    """Return True if both numbers are floating-point zeros. -0 is less than +0 here; numpy does not guarantee that."""
    return x == 0 and y == 0 and isinstance(x, np.floating)


_ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "abs": np.abs,
    "max": lambda x, y: x + y if _are_zeros(x, y) else np.maximum(x, y),
    "min": lambda x, y: -(-x - y) if _are_zeros(x, y) else np.minimum(x, y),
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "floor": np.floor,
    "ceil": np.ceil,
    "sqrt": np.sqrt,
}


def _fold(b: Builder, op: str, args: tuple[Value, ...], dtype: str) -> Value | None:
    """Return the value of an operation if it is known without computing it at run time, else None.

    The value is known if all operands are constants, or by an identity that is exact for every input, including NaN,
    infinities and signed zeros. A product with zero is not folded: it is NaN if the other factor is not finite.
    """
    if op == "select":
        return _fold_select(b, args)
    if args and all(a.op == "const" for a in args):
        return _fold_constants(b, op, [a.const for a in args], dtype)
    if op in ("eq", "ne", "le", "ge") and args[0].dtype == "bool" and args[1].op == "const":
        return _fold_comparison(b, op, args[0], bool(args[1].const))
    if op == "convert":
        return args[0] if args[0].dtype == dtype else narrow_integer(b, args[0], dtype)
    if op == "not" and args[0].op == "not":
        return args[0].args[0]
    certain = certain_result(op, args)
    if certain is not None:
        return b.const(certain, "bool") if isinstance(certain, bool) else args[certain]
    if len(args) == 2:
        return _fold_identity(b, op, args[0], args[1], dtype)
    return None


def _fold_constants(b: Builder, op: str, numbers: list[Any], dtype: str) -> Value | None:
    with np.errstate(all="ignore"):
        if op in _COMPARISONS:
            return b.const(_COMPARISONS[op](*numbers), "bool")
        if op in _ARITHMETIC and not (op in ("floor", "ceil", "sqrt") and not is_float(dtype)):
            return b.const(_ARITHMETIC[op](*numbers), dtype)
        if op == "div" and is_float(dtype):
            return b.const(np.divide(*numbers), dtype)
        if op in ("div", "rem") and not is_float(dtype) and int(numbers[1]) > 0 and int(numbers[0]) >= 0:
            return b.const(divmod(int(numbers[0]), int(numbers[1]))[op == "rem"], dtype)
        if op == "convert":
            return _convert_constant(b, numbers[0], dtype)
    return None


def _convert_constant(b: Builder, number: Any, dtype: str) -> Value | None:
    if np.issubdtype(type(number), np.floating) and not is_float(dtype) and dtype != "bool":
        limits = np.iinfo(TYPES[dtype])
        if np.isnan(number):
            return b.const(0, dtype)
        number = int(min(max(float(number), float(limits.min)), float(limits.max)))
        number = min(max(number, int(limits.min)), int(limits.max))
        return b.const(np.asarray(number, TYPES[dtype]), dtype)
    return b.const(number, dtype)


def _fold_select(b: Builder, args: tuple[Value, ...]) -> Value | None:
    test, yes, no = args
    if test.op == "const":
        return yes if test.const else no
    if yes is no:
        return yes
    if yes.dtype == "bool" and yes.op == no.op == "const":
        return test if yes.const else b.op("not", test, dtype="bool")
    return None


def _fold_comparison(b: Builder, op: str, value: Value, wanted: bool) -> Value | None:
    if op in ("eq", "ne"):
        return value if (op == "eq") == wanted else b.op("not", value, dtype="bool")
    if op == "ge" and wanted:
        return value
    if op == "le" and not wanted:
        return b.op("not", value, dtype="bool")
    return None


def _is_number(value: Value, number: float) -> bool:
    """Return True if a value is the constant `number`, including the sign of a zero."""
    if value.op != "const" or value.const != number:
        return False
    return not is_float(value.dtype) or np.signbit(value.const) == np.signbit(np.float64(number))


def _fold_identity(b: Builder, op: str, x: Value, y: Value, dtype: str) -> Value | None:
    float_ = is_float(dtype)
    zero = -0.0 if float_ else 0
    if op == "add":
        return y if _is_number(x, zero) else x if _is_number(y, zero) else None
    if op == "mul":
        if not float_ and (_is_number(x, 0) or _is_number(y, 0)):
            return b.const(0, dtype)
        return y if _is_number(x, 1) else x if _is_number(y, 1) else None
    if (op == "sub" and _is_number(y, 0)) or (op == "div" and _is_number(y, 1)):
        return x
    if op == "rem" and not float_ and _is_number(y, 1):
        return b.const(0, dtype)
    if op in ("shift_left", "shift_right_logical", "shift_right_arithmetic") and _is_number(y, 0):
        return x
    if dtype == "bool" and op in ("and", "or"):
        for one, other in ((x, y), (y, x)):
            if one.op == "const":
                return other if bool(one.const) == (op == "and") else one
        return x if x is y else None
    of_truth = x.op == "convert" and x.args[0].dtype == "bool" and not is_float(x.dtype)
    if op in ("eq", "ne") and of_truth and y.op == "const" and int(y.const) in (0, 1):
        return _fold_comparison(b, op, x.args[0], bool(y.const))
    return None
