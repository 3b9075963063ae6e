"""What a program is between JAX and C: scalars computed once, buffers for what is large, branches and loops.

Every value is assigned once and belongs to one block; equal computations are found and shared. A branch joins values,
a loop carries them. The same program is printed as scalar C or as C++ over lanes.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

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
    """Whether values of this type are floating point."""
    return dtype[0] == "f"


class Value:
    """One scalar. op "const" has a number, "input", "carry", "index" and "join" are given by what surrounds them."""

    __slots__ = ("args", "attr", "const", "dtype", "invariant", "op")

    def __init__(self, op: str, args: tuple["Value", ...], dtype: str, attr: Any = None, const: Any = None) -> None:
        self.op, self.args, self.dtype, self.attr, self.const = op, args, dtype, attr, const
        self.invariant = op == "const"


class Buffer:
    """An array in memory, row-major. kind: "const" (data known), "input" (read only), "state" or "local"."""

    __slots__ = ("data", "dtype", "kind", "name", "size")

    def __init__(self, dtype: str, size: int, kind: str, name: str = "", data: Any = None) -> None:
        self.dtype, self.size, self.kind, self.name, self.data = dtype, size, kind, name, data

    @property
    def is_read_only(self) -> bool:
        """Whether nothing ever writes to it."""
        return self.kind in ("const", "input")


class Block:
    """Statements in order."""

    def __init__(self) -> None:
        self.items: list[Any] = []


class Define:
    """A value is computed."""

    def __init__(self, value: Value) -> None:
        self.value = value


class Local:
    """A buffer of this block begins to exist."""

    def __init__(self, buffer: Buffer) -> None:
        self.buffer = buffer


class Store:
    """buffer[index] = value."""

    def __init__(self, buffer: Buffer, index: Value, value: Value) -> None:
        self.buffer, self.index, self.value = buffer, index, value


class If:
    """Either block; joins are (result, value of the first, value of the second)."""

    def __init__(self, test: Value, first: Block, second: Block) -> None:
        self.test, self.first, self.second = test, first, second
        self.joins: list[tuple[Value, Value, Value]] = []

    def join(self, x: Value, y: Value) -> Value:
        """x where the first block is taken, else y."""
        if x is y:
            return x
        joined = Value("join", (), x.dtype)
        self.joins.append((joined, x, y))
        return joined


class Emit:
    """Values that are handed to the outside, as text that whoever prints the program writes."""

    def __init__(self, values: list[Value]) -> None:
        self.values = values


class Loop:
    """count times (a number, or the name of one), or, where count is None, while the head block's test holds.

    carries are (variable, start, next).
    """

    def __init__(self, count: int | str | None, index: Value, body: Block) -> None:
        self.count, self.index, self.body = count, index, body
        self.head = Block()
        self.test: Value | None = None
        self.carries: list[tuple[Value, Value, Value]] = []


class Builder:
    """Writes a program. With `hoist`, what depends on invariant inputs alone is put before everything else, once."""

    def __init__(
        self, fold: Callable[["Builder", str, tuple[Value, ...], str, Any], Value | None], hoist: bool
    ) -> None:
        self.prologue, self.top = Block(), Block()
        self.blocks: list[Block] = [self.prologue, self.top]
        self.known: list[dict[Any, Any]] = [{}, {}]
        self.constants: dict[Any, Value] = {}
        self.fold, self.hoist = fold, hoist

    @property
    def block(self) -> Block:
        """Where statements go now."""
        return self.blocks[-1]

    @contextmanager
    def write_into(self, block: Block) -> Iterator[None]:
        """Write into a block; what is computed there is unknown outside."""
        self.blocks.append(block)
        self.known.append({})
        try:
            yield
        finally:
            self.blocks.pop()
            self.known.pop()

    def memoise(self, key: Any, make: Callable[[], Any]) -> Any:
        """What has this key already, here or around; else what is made now."""
        for table in reversed(self.known):
            if key in table:
                return table[key]
        made = self.known[-1][key] = make()
        return made

    def const(self, number: Any, dtype: str) -> Value:
        """A known number."""
        exact = np.asarray(number).astype(TYPES[dtype])
        found = self.constants.get((dtype, exact.tobytes()))
        if found is None:
            found = Value("const", (), dtype, const=exact[()])
            self.constants[dtype, exact.tobytes()] = found
        return found

    def index(self, number: int) -> Value:
        """A known index."""
        return self.const(number, "i32")

    def op(self, op: str, *args: Value, dtype: str, attr: Any = None) -> Value:
        """A computed value: folded, found again, or new."""
        folded = self.fold(self, op, args, dtype, attr)
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
        """An element of a buffer, as it is now."""
        if buffer.data is not None and index.op == "const":
            return self.const(buffer.data[int(index.const)], buffer.dtype)
        if buffer.is_read_only:
            return self.op("load", index, dtype=buffer.dtype, attr=buffer)
        value = Value("load", (index,), buffer.dtype, buffer)
        self.block.items.append(Define(value))
        return value

    def local_buffer(self, dtype: str, size: int) -> Buffer:
        """A new buffer of this block."""
        buffer = Buffer(dtype, size, "local")
        self.block.items.append(Local(buffer))
        return buffer

    def store(self, buffer: Buffer, index: Value, value: Value) -> None:
        """Write one element."""
        self.block.items.append(Store(buffer, index, value))

    def loop(self, count: int, starts: list[Value], body: Callable[[Value, list[Value]], list[Value]]) -> list[Value]:
        """Run body(index, carried) `count` times; returns what is carried at the end."""
        made = Loop(count, Value("index", (), "i32"), Block())
        variables = [Value("carry", (), s.dtype) for s in starts]
        with self.write_into(made.body):
            nexts = body(made.index, variables)
        made.carries = list(zip(variables, starts, nexts, strict=True))
        self.block.items.append(made)
        return variables

    def repeat(self, count: int, body: Callable[[Value], None]) -> None:
        """Run body(index) `count` times."""

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
        """Run body(carried) while test(carried) holds."""
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
        """first() where the test holds, else second(); only one of them is computed."""
        made = If(test, Block(), Block())
        with self.write_into(made.first):
            x = first()
        with self.write_into(made.second):
            y = second()
        self.block.items.append(made)
        return made.join(x, y)


Fold = Callable[[Builder, str, tuple[Value, ...], str, Any], Value | None]
"""(builder, operation, operands, type, attribute) -> the value that it is known to have, or None."""
