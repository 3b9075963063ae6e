"""Variables of random programs."""

from typing import NamedTuple

INTEGERS = ("i32", "i64", "u32")
DTYPES = {"f": "float64", "i32": "int32", "i64": "int64", "u32": "uint32", "b": "bool"}


class Var(NamedTuple):
    """A variable. kind: "f", "i32", "i64", "u32" or "b".

    size, fine: of an exact float, |x| <= 2^size in steps of 2^-fine.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    exact: bool = True
    size: int = 0
    fine: int = 0
    growth: float = 1.0
