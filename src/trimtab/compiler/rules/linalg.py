"""Rules for Cholesky factors and triangular solves of single matrices; batches of them: `composite`."""

from collections.abc import Callable

import numpy as np

from trimtab.compiler.arrays import Array, build_array, copy_array, flat_index, is_small, read_element
from trimtab.compiler.ir import Buffer, Value
from trimtab.compiler.lower import Rule, Site


class Matrix:
    """A matrix in a buffer, read and written by indices that are numbers or values."""

    def __init__(self, site: Site, array: Array) -> None:
        self.b, self.array, self.dtype = site.b, array, array.dtype

    def __getitem__(self, ij: tuple[Value, Value]) -> Value:
        return read_element(self.b, self.array, list(ij))

    def __setitem__(self, ij: tuple[Value, Value], value: Value) -> None:
        buffer = self.array.buffer
        assert isinstance(buffer, Buffer)
        self.b.store(buffer, flat_index(self.b, self.array.shape, list(ij)), value)


def _cholesky(site: Site) -> list[Array]:
    """The lower factor, zeros above it; all NaN where the matrix is not positive definite, as in JAX."""
    b, dtype, n = site.b, site.dtype, site.shape[0]
    if is_small(site.shape):
        L, ok = _unroll_cholesky(site, n)
    else:
        L, ok = _loop_cholesky(site, n)
    nan, zero = b.const(np.nan, dtype), b.const(0, dtype)

    def element(index: list[Value]) -> Value:
        i, j = index
        value = b.op("select", ok, read_element(b, L, index), nan, dtype=dtype)
        return b.op("select", b.op("lt", i, j, dtype="bool"), zero, value, dtype=dtype)

    return [build_array(b, site.shape, dtype, element)]


def _unroll_cholesky(site: Site, n: int) -> tuple[Array, Value]:
    b, dtype, A = site.b, site.dtype, site.operands[0]
    zero = b.const(0, dtype)
    L = np.full((n, n), zero, object)
    ok = b.const(1, "bool")
    for j in range(n):
        for i in range(j, n):
            total = read_element(b, A, [b.index(i), b.index(j)])
            for k in range(j):
                total = b.op("sub", total, b.op("mul", L[i, k], L[j, k], dtype=dtype), dtype=dtype)
            if i == j:
                ok = b.op("and", ok, b.op("gt", total, zero, dtype="bool"), dtype="bool")
                L[j, j] = b.op("sqrt", total, dtype=dtype)
            else:
                L[i, j] = b.op("div", total, L[j, j], dtype=dtype)
    return Array((n, n), dtype, L), ok


def _loop_cholesky(site: Site, n: int) -> tuple[Array, Value]:
    b, dtype = site.b, site.dtype
    made = copy_array(b, site.operands[0])
    L = Matrix(site, made)

    def entry(i: Value, j: Value) -> Value:
        # the loop runs over all k and takes those below j: counts are fixed
        def add(k: Value, carried: list[Value]) -> list[Value]:
            less = b.op("sub", carried[0], b.op("mul", L[i, k], L[j, k], dtype=dtype), dtype=dtype)
            return [b.op("select", b.op("lt", k, j, dtype="bool"), less, carried[0], dtype=dtype)]

        return b.loop(n, [L[i, j]], add)[0]

    def column(j: Value, carried: list[Value]) -> list[Value]:
        pivot = entry(j, j)
        root = b.op("sqrt", pivot, dtype=dtype)
        L[j, j] = root

        def row(i: Value) -> None:
            below = b.op("gt", i, j, dtype="bool")
            new = b.op("div", entry(i, j), root, dtype=dtype)
            L[i, j] = b.op("select", below, new, L[i, j], dtype=dtype)

        b.repeat(n, row)
        good = b.op("gt", pivot, b.const(0, dtype), dtype="bool")
        return [b.op("and", carried[0], good, dtype="bool")]

    [ok] = b.loop(n, [b.const(1, "bool")], column)
    return made, ok


def _triangular_solve(site: Site) -> list[Array]:
    """X with op(A) X = B, or X op(A) = B: forward or backward substitution."""
    b, dtype, p = site.b, site.dtype, site.params
    A, B = site.operands
    n, left = A.shape[0], bool(p["left_side"])
    m = B.shape[1] if left else B.shape[0]
    flipped = bool(p["transpose_a"]) == left  # X op(A) = B is solved as op(A)' X' = B'
    forwards = bool(p["lower"]) != flipped

    def a(i: Value, j: Value) -> Value:
        return read_element(b, A, [j, i] if flipped else [i, j])

    def place(i: Value, j: Value) -> list[Value]:
        return [i, j] if left else [j, i]

    def divide(i: Value, total: Value) -> Value:
        return total if p["unit_diagonal"] else b.op("div", total, a(i, i), dtype=dtype)

    if is_small(A.shape) and is_small(B.shape):
        return [_unroll_substitution(site, n, m, forwards, a, place, divide)]
    made = copy_array(b, B)
    X = Matrix(site, made)

    def solve(j: Value) -> None:
        def turn(k: Value) -> None:
            i = k if forwards else b.op("sub", b.index(n - 1), k, dtype="i32")

            def add(q: Value, carried: list[Value]) -> list[Value]:
                r, s = place(q, j)
                less = b.op("sub", carried[0], b.op("mul", a(i, q), X[r, s], dtype=dtype), dtype=dtype)
                known = b.op("lt" if forwards else "gt", q, i, dtype="bool")
                return [b.op("select", known, less, carried[0], dtype=dtype)]

            r, s = place(i, j)
            X[r, s] = divide(i, b.loop(n, [X[r, s]], add)[0])

        b.repeat(n, turn)

    b.repeat(m, solve)
    return [made]


def _unroll_substitution(
    site: Site,
    n: int,
    m: int,
    forwards: bool,
    a: Callable[[Value, Value], Value],
    place: Callable[[Value, Value], list[Value]],
    divide: Callable[[Value, Value], Value],
) -> Array:
    b, dtype, B = site.b, site.dtype, site.operands[1]
    found = np.empty(site.shape, object)
    order = list(range(n)) if forwards else list(range(n - 1, -1, -1))
    index = [b.index(i) for i in range(max(n, m))]
    for j in range(m):
        column: dict[int, Value] = {}
        for i in order:
            total = read_element(b, B, place(index[i], index[j]))
            for q, known in column.items():
                total = b.op("sub", total, b.op("mul", a(index[i], index[q]), known, dtype=dtype), dtype=dtype)
            column[i] = divide(index[i], total)
            found[tuple(int(v.const) for v in place(index[i], index[j]))] = column[i]
    return Array(site.shape, dtype, found)


RULES: dict[str, Rule] = {"cholesky": _cholesky, "triangular_solve": _triangular_solve}
