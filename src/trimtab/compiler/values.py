"""Operands of the intermediate representation between JAX and C: scalar values, and arrays in memory."""

from typing import Any

from trimtab.core.errors import InputError

LARGEST = 2**31 - 2**16
"""Maximum number of elements of an array, so that an index and the end of a loop fit an int32."""


class Value:
    """Scalar value. kind: "const" for a number; "input" for an argument; "carry" or "index" for a value set by a loop;
    "join" for a value set by a branch."""

    __slots__ = ("args", "attr", "const", "dtype", "invariant", "op")

    def __init__(self, op: str, args: tuple["Value", ...], dtype: str, attr: Any = None, const: Any = None) -> None:
        self.op, self.args, self.dtype, self.attr, self.const = op, args, dtype, attr, const
        self.invariant = op == "const"


class Buffer:
    """Array in memory, row-major. kind: "const" (data known), "input" (read-only), "state" or "local"."""

    __slots__ = ("data", "dtype", "kind", "name", "size")

    def __init__(self, dtype: str, size: int, kind: str, name: str = "", data: Any = None) -> None:
        if size > LARGEST:
            problem, fix = (
                f"an array of {size} numbers is too large",
                f"split the array into parts of at most {LARGEST} numbers: indices have 32 bits",
            )
            raise InputError("compiler", problem, fix=fix)
        self.dtype, self.size, self.kind, self.name, self.data = dtype, size, kind, name, data

    @property
    def is_read_only(self) -> bool:
        """Return True if nothing ever writes to the buffer."""
        return self.kind in ("const", "input")
