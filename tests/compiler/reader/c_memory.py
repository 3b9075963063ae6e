"""Memory, arithmetic and the C library as Python sees them: what C leaves undefined is refused."""

import ctypes
import ctypes.util
import math
import struct
from typing import Any

from compiler.reader.c_grammar import SIZES, Refusal, Type

LIBRARY = ctypes.CDLL(ctypes.util.find_library("m") or None)
ONE = "sqrt floor ceil trunc rint round fabs exp exp2 expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh"
ONE += " acosh atanh erf erfc cbrt lgamma tgamma"
TWO, THREE = "pow fmod atan2 nextafter fmin fmax copysign", "fma"
COUNTS = {name: k for k, names in enumerate((ONE, TWO, THREE), 1) for name in names.split()}
FORMATS = {"f64": "d", "f32": "f", "i8": "b", "u8": "B", "bool": "B", "i16": "h", "u16": "H"}
FORMATS |= {"i32": "i", "u32": "I", "i64": "q", "u64": "Q"}


def library_function(name: str) -> tuple[Any, int, str] | None:
    """A function of math.h, the number of its arguments and their type, or None."""
    short = name[-1] == "f" and name[:-1] in COUNTS and name not in COUNTS
    if not short and name not in COUNTS:
        return None
    count, kind = COUNTS[name[:-1] if short else name], ctypes.c_float if short else ctypes.c_double
    function = LIBRARY[name]
    function.restype, function.argtypes = kind, [kind] * count
    return function, count, "f32" if short else "f64"


class Memory(list[Any]):
    """Numbers of one type, side by side; None where nothing was written."""

    __slots__ = ("type",)

    def __init__(self, values: Any, type_: Any) -> None:
        super().__init__(values)
        self.type = type_


class Workspace:
    """Bytes without a type: what was written at an address is read there in the same type."""

    def __init__(self, size: int) -> None:
        self.size, self.cells = size, {}


class View:
    """A workspace seen as numbers of one type, from its beginning."""

    def __init__(self, workspace: Workspace, type_: str, first: int) -> None:
        self.workspace, self.type, self.first, self.width = workspace, type_, first, SIZES[type_]
        if first % self.width:
            raise Refusal(f"{type_} at byte {first}")

    def _address(self, k: int) -> int:
        address = self.first + k * self.width
        if not 0 <= address <= self.workspace.size - self.width:
            raise Refusal(f"byte {address} of a workspace of {self.workspace.size}")
        return address

    def __getitem__(self, k: int) -> Any:
        kind, value = self.workspace.cells.get(self._address(k), (self.type, None))
        if kind != self.type:
            raise Refusal(f"{kind} read as {self.type}")
        return value

    def __setitem__(self, k: int, value: Any) -> None:
        address, cells = self._address(k), self.workspace.cells
        for near in range(address - 7, address + self.width):
            if near in cells and near + SIZES[cells[near][0]] > address:
                del cells[near]
        cells[address] = self.type, value


class Pointer:
    """A place in a memory."""

    __slots__ = ("memory", "offset")

    def __init__(self, memory: Any, offset: int = 0) -> None:
        self.memory, self.offset = memory, offset


def cell(type_: Any, count: int = 1) -> Pointer:
    """Memory of so many numbers that nobody has written."""
    return Pointer(Memory([None] * count, type_))


def at(p: Pointer, i: int) -> Any:
    """p[i]."""
    k = p.offset + i
    if k < 0:
        raise Refusal(f"index {k}")
    value = p.memory[k]
    if value is None:
        raise Refusal("memory is read that was not written")
    return value


def put(p: Pointer, i: int, value: Any) -> None:
    """p[i] = value."""
    k = p.offset + i
    if k < 0:
        raise Refusal(f"index {k}")
    p.memory[k] = value


def known(value: Any) -> Any:
    """A local's value, or a function's."""
    if value is None:
        raise Refusal("a value is read that was not given")
    return value


def shift_pointer(p: Pointer, n: int) -> Pointer:
    """p + n."""
    return Pointer(p.memory, p.offset + n)


def cast_pointer(p: Any, type_: Any) -> Any:
    """A pointer to another type: of a workspace, or the type that the memory has."""
    if type_ in ("void", "char") or (isinstance(type_, Type) and type_.of in ("void", "char")):
        return p
    type_ = type_.of if isinstance(type_, Type) and not type_.shape else type_
    if isinstance(p.memory, Workspace):
        return Pointer(View(p.memory, type_, p.offset))
    if p.memory.type != type_:
        raise Refusal(f"a pointer to {p.memory.type} is taken for one to {type_}")
    return p


def copy_bytes(to: Pointer, source: Pointer, size: int) -> None:
    """memcpy."""
    a, b = to.memory.type, source.memory.type
    if size % SIZES[a] or SIZES[a] != SIZES[b]:
        raise Refusal(f"memcpy of {size} bytes of {b} to {a}")
    for i in range(size // SIZES[a]):
        value = at(source, i)
        put(to, i, value if a == b else struct.unpack("<" + FORMATS[a], struct.pack("<" + FORMATS[b], value))[0])


def round_single(x: float) -> float:
    """The nearest float32. Sums, products, quotients and roots of two of them may be rounded twice: it is the same."""
    return ctypes.c_float(x).value


def single_of_integer(n: int) -> float:
    """The nearest float32, rounded once, ties to even."""
    size = abs(n)
    extra = size.bit_length() - 24
    if extra <= 0:
        return float(n)
    high, low, half = size >> extra, size & ((1 << extra) - 1), 1 << (extra - 1)
    high += low > half or (low == half and high & 1)
    return math.copysign(float(high << extra), n)


def divide(a: float, b: float) -> float:
    """a / b of floating-point numbers."""
    if b:
        return a / b
    if a != a or a == 0 or b != b:
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def quotient(a: int, b: int, least: int) -> int:
    """a / b of integers, towards zero."""
    if b == 0 or (b == -1 and a == least):
        raise Refusal(f"{a} / {b}")
    q = abs(a) // abs(b)
    return q if (a < 0) == (b < 0) else -q


def remainder(a: int, b: int, least: int) -> int:
    """a % b of integers, with the sign of a."""
    return a - b * quotient(a, b, least)


def shift_count(n: int, bits: int) -> int:
    """A shift's distance."""
    if not 0 <= n < bits:
        raise Refusal(f"shift by {n} of {bits} bits")
    return n


def shift_left(a: int, n: int, most: int) -> int:
    """a << n of a signed number, which is defined where it is neither negative nor too large afterwards."""
    if a < 0 or a << n > most:
        raise Refusal(f"{a} << {n} of a signed number")
    return a << n


def truncate(x: float, least: int, most: int) -> int:
    """A floating-point number as an integer."""
    if x != x or math.isinf(x) or not least <= int(x) <= most:
        raise Refusal(f"{x} as an integer from {least}")
    return int(x)


class Fuel:
    """Turns of loops that are left."""

    def __init__(self, turns: int) -> None:
        self.turns = turns

    def burn(self) -> None:
        """One turn more."""
        self.turns -= 1
        if self.turns < 0:
            raise Refusal("a loop does not end")
