"""Memory, arithmetic and the C library as Python sees them: what C leaves undefined is refused."""

import ctypes
import ctypes.util
import math
import struct
from typing import Any

import numpy as np

from compiler.reader.c_grammar import BITS, SIZES, Refusal, bounds

LIBRARY = ctypes.CDLL(ctypes.util.find_library("m") or None)
ONE = "sqrt floor ceil trunc rint round fabs exp exp2 expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh"
ONE += " acosh atanh erf erfc cbrt lgamma tgamma"
TWO = "pow fmod atan2 fmin fmax copysign"
COUNTS = {name: k for k, names in enumerate((ONE, TWO, "fma"), 1) for name in names.split()}
FORMATS = {"f64": "d", "f32": "f", "i8": "b", "u8": "B", "bool": "B", "i16": "h", "u16": "H"}
FORMATS |= {"i32": "i", "u32": "I", "i64": "q", "u64": "Q"}


def library_function(name: str) -> tuple[Any, int, str] | None:
    """A function of math.h, the number of its arguments and their type, or None."""
    single = name not in COUNTS and name[-1] == "f"
    count = COUNTS.get(name[:-1] if single else name)
    if count is None:
        return None
    function, kind = LIBRARY[name], ctypes.c_float if single else ctypes.c_double
    function.restype, function.argtypes = kind, [kind] * count
    return function, count, "f32" if single else "f64"


class Memory(list[Any]):
    """Numbers of one type, side by side; None where nothing was written."""

    def __init__(self, values: Any, type_: Any) -> None:
        super().__init__(values)
        self.type = type_


class Workspace:
    """Bytes without a type. What begins at one of them as numbers of one type is a memory of these."""

    def __init__(self, size: int) -> None:
        self.size, self.memories, self.type = size, dict[Any, Memory](), "void"

    def view(self, first: int, type_: str) -> Memory:
        """The numbers of a type from a byte on."""
        if first % SIZES[type_] or not 0 <= first <= self.size:
            raise Refusal(f"{type_} at byte {first} of {self.size}")
        return self.memories.setdefault((first, type_), cell(type_, (self.size - first) // SIZES[type_]).memory)


class Pointer:
    """A place in a memory."""

    def __init__(self, memory: Any, offset: int = 0) -> None:
        self.memory, self.offset = memory, offset


def cell(type_: Any, count: int = 1) -> Pointer:
    """Memory of so many numbers that nobody has written."""
    return Pointer(Memory([None] * count, type_))


def at(p: Pointer, i: int) -> Any:
    """p[i]."""
    if p.offset + i < 0:
        raise Refusal(f"index {i}")
    return known(p.memory[p.offset + i])


def put(p: Pointer, i: int, value: Any) -> None:
    """p[i] = value."""
    if p.offset + i < 0:
        raise Refusal(f"index {i}")
    p.memory[p.offset + i] = value


def known(value: Any) -> Any:
    """What was written, or given back."""
    if value is None:
        raise Refusal("a value is read that was not given")
    return value


def shift_pointer(p: Pointer, n: int) -> Pointer:
    """p + n."""
    return Pointer(p.memory, p.offset + n)


def cast_pointer(p: Any, type_: Any) -> Any:
    """A pointer to another type: into a workspace, or to the type that the memory has."""
    if type_ in ("void", "char"):
        return p
    if isinstance(p.memory, Workspace):
        return Pointer(p.memory.view(p.offset, type_))
    if p.memory.type not in (type_, "void"):
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


def single(x: Any) -> float:
    """The nearest float32. Sums, products, quotients and roots of two of them may be rounded twice: it is the same."""
    kind = np.float64 if isinstance(x, float) else np.uint64 if x >= 0 else np.int64
    with np.errstate(over="ignore"):
        return float(kind(x).astype(np.float32))


def divide(a: float, b: float) -> float:
    """a / b of floating-point numbers."""
    with np.errstate(all="ignore"):
        return a / b if b else float(np.float64(a) / b)


def quotient(a: int, b: int, t: str) -> int:
    """a / b of integers, towards zero."""
    if b == 0 or (b == -1 and a == bounds(t)[0]):
        raise Refusal(f"{a} / {b}")
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def remainder(a: int, b: int, t: str) -> int:
    """a % b of integers, with the sign of a."""
    return a - b * quotient(a, b, t)


def shift(a: int, n: int, t: str, left: bool) -> int:
    """a << n or a >> n; of a signed number to the left where it is neither negative nor too large afterwards."""
    if not 0 <= n < BITS[t] or (left and t[0] == "i" and not 0 <= a << n <= bounds(t)[1]):
        raise Refusal(f"shift of {a} by {n} of {BITS[t]} bits")
    return (a << n) & bounds("u" + t[1:])[1] if left else a >> n


def truncate(x: float, t: str) -> int:
    """A floating-point number as an integer."""
    if not math.isfinite(x) or not bounds(t)[0] <= int(x) <= bounds(t)[1]:
        raise Refusal(f"{x} as {t}")
    return int(x)


class Fuel:
    """Turns of loops that are left."""

    turns = 0

    def burn(self) -> None:
        """One turn more."""
        self.turns -= 1
        if self.turns < 0:
            raise Refusal("a loop does not end")
