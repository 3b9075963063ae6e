"""Lowering rules for Cholesky and LU factors and triangular systems of single matrices. Batches are in `composite`."""

from collections.abc import Callable

import numpy as np

from trimtab.compiler.arrays import (
    Array,
    build_array,
    copy_array,
    flat_index,
    is_small,
    loop_over_indices,
    read_element,
    store_in_memory,
)
from trimtab.compiler.lower import Rule, Site
from trimtab.compiler.values import Buffer, Value

SIDES = 4
"""Minimum number of right-hand sides that are solved side by side. A smaller number is solved one by one."""


class Matrix:
    """Matrix in a buffer. Its indices are constants, or values known only at run time."""

    def __init__(self, site: Site, array: Array) -> None:
        self.b, self.array, self.dtype = site.b, array, array.dtype

    def __getitem__(self, ij: tuple[Value, Value]) -> Value:
        return read_element(self.b, self.array, list(ij))

    def __setitem__(self, ij: tuple[Value, Value], value: Value) -> None:
        buffer = self.array.buffer
        assert isinstance(buffer, Buffer)
        self.b.store(buffer, flat_index(self.b, self.array.shape, list(ij)), value)


class Vector:
    """Vector that is stored in a separate buffer."""

    def __init__(self, site: Site, size: int) -> None:
        self.b, self.buffer = site.b, site.b.local_buffer(site.dtype, size)

    def __getitem__(self, i: Value) -> Value:
        return self.b.load(self.buffer, i)

    def __setitem__(self, i: Value, value: Value) -> None:
        self.b.store(self.buffer, i, value)


def _cholesky(site: Site) -> list[Array]:
    """Return the lower Cholesky factor with zeros above it, or all NaN if the matrix is not positive definite."""
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
    """Factorise column by column. After each column, the rest of the matrix is updated along its rows (vectorised)."""
    b, dtype = site.b, site.dtype
    result = copy_array(b, site.operands[0])
    L = Matrix(site, result)
    column = Vector(site, n)

    def eliminate(j: Value, carried: list[Value]) -> list[Value]:
        pivot = L[j, j]
        root = b.op("sqrt", pivot, dtype=dtype)
        L[j, j] = root
        rest = b.op("sub", b.index(n - 1), j, dtype="i32")

        def below(k: Value) -> Value:
            return b.op("add", b.op("add", j, k, dtype="i32"), b.index(1), dtype="i32")

        def divide(k: Value) -> None:
            value = b.op("div", L[below(k), j], root, dtype=dtype)
            L[below(k), j] = value
            column[k] = value

        def update(row: Value) -> None:
            i = below(row)
            factor = column[row]

            def one(k: Value) -> None:
                L[i, below(k)] = b.op("sub", L[i, below(k)], b.op("mul", factor, column[k], dtype=dtype), dtype=dtype)

            b.repeat(b.op("add", row, b.index(1), dtype="i32"), one)

        b.repeat(rest, divide)
        b.repeat(rest, update)
        good = b.op("gt", pivot, b.const(0, dtype), dtype="bool")
        return [b.op("and", carried[0], good, dtype="bool")]

    [ok] = b.loop(n, [b.const(1, "bool")], eliminate)
    return result, ok


def _triangular_solve(site: Site) -> list[Array]:
    """Solve op(A) X = B or X op(A) = B for X by forward or backward substitution."""
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
    return [_loop_substitution(site, n, m, forwards, a, place, divide)]


def _loop_substitution(
    site: Site,
    n: int,
    m: int,
    forwards: bool,
    a: Callable[[Value, Value], Value],
    place: Callable[[Value, Value], list[Value]],
    divide: Callable[[Value, Value], Value],
) -> Array:
    """Solve for the unknowns row by row, with all right-hand sides side by side."""
    b, dtype, B = site.b, site.dtype, site.operands[1]
    rows = Array((n, m), dtype, buffer=b.local_buffer(dtype, n * m))
    X = Matrix(site, rows)
    loop_over_indices(b, (n, m), lambda at: X.__setitem__((at[0], at[1]), read_element(b, B, place(*at))))

    def turn(k: Value) -> None:
        i = k if forwards else b.op("sub", b.index(n - 1), k, dtype="i32")

        def earlier(q: Value) -> Value:  # in the order of their index, forwards and backwards
            return q if forwards else b.op("add", b.op("add", i, q, dtype="i32"), b.index(1), dtype="i32")

        def subtract(q: Value) -> None:
            factor = a(i, earlier(q))

            def one(j: Value) -> None:
                X[i, j] = b.op("sub", X[i, j], b.op("mul", factor, X[earlier(q), j], dtype=dtype), dtype=dtype)

            b.repeat(m, one)

        def subtract_all(j: Value) -> Value:
            def add(q: Value, carried: list[Value]) -> list[Value]:
                return [
                    b.op("sub", carried[0], b.op("mul", a(i, earlier(q)), X[earlier(q), j], dtype=dtype), dtype=dtype)
                ]

            return b.loop(k, [X[i, j]], add)[0]

        if m < SIDES:
            b.repeat(m, lambda j: X.__setitem__((i, j), divide(i, subtract_all(j))))
        else:
            b.repeat(k, subtract)
            b.repeat(m, lambda j: X.__setitem__((i, j), divide(i, X[i, j])))

    b.repeat(n, turn)
    return build_array(b, site.shape, dtype, lambda index: X[place(*index)[0], place(*index)[1]])


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


def _lu(site: Site) -> list[Array]:
    """Return the LU factors in one matrix, the row exchanged at each step, and the resulting order of the rows.

    As in LAPACK, the pivot is the largest element of a column, the first one if several are equal. A column of zeros
    is left as it is.
    """
    b, dtype = site.b, site.dtype
    m, n = site.operands[0].shape
    steps, one = min(m, n), b.index(1)
    result = copy_array(b, store_in_memory(b, site.operands[0]))
    A, row = Matrix(site, result), Vector(site, n)
    pivots, order = b.local_buffer("i32", steps), b.local_buffer("i32", m)
    b.repeat(m, lambda i: b.store(order, i, i))

    def exchange(j: Value, p: Value, ok: Value) -> None:
        def column(c: Value) -> None:
            upper, lower = A[j, c], A[p, c]
            A[j, c] = lower
            A[p, c] = upper
            row[c] = b.op("select", ok, lower, b.const(0, dtype), dtype=dtype)

        b.repeat(n, column)
        upper, lower = b.load(order, j), b.load(order, p)
        b.store(order, j, lower)
        b.store(order, p, upper)
        b.store(pivots, j, p)

    def find_pivot(j: Value) -> Value:
        def compare(k: Value, carried: list[Value]) -> list[Value]:
            i = b.op("add", b.op("add", j, k, dtype="i32"), one, dtype="i32")
            size, [best, place] = b.op("abs", A[i, j], dtype=dtype), carried
            first = b.op("eq", best, best, dtype="bool")
            nan = b.op("and", b.op("ne", size, size, dtype="bool"), first, dtype="bool")
            wins = b.op("or", b.op("gt", size, best, dtype="bool"), nan, dtype="bool")
            return [b.op("select", wins, size, best, dtype=dtype), b.op("select", wins, i, place, dtype="i32")]

        start = [b.op("abs", A[j, j], dtype=dtype), j]
        return b.loop(b.op("sub", b.index(m - 1), j, dtype="i32"), start, compare)[1]

    def eliminate(j: Value) -> None:
        p = find_pivot(j)
        pivot = A[p, j]
        ok = b.op("ne", pivot, b.const(0, dtype), dtype="bool")
        exchange(j, p, ok)
        after = b.op("add", j, one, dtype="i32")

        def update(k: Value) -> None:
            i = b.op("add", after, k, dtype="i32")
            factor = b.op("select", ok, b.op("div", A[i, j], pivot, dtype=dtype), A[i, j], dtype=dtype)
            A[i, j] = factor

            def column(k: Value) -> None:
                c = b.op("add", after, k, dtype="i32")
                A[i, c] = b.op("sub", A[i, c], b.op("mul", factor, row[c], dtype=dtype), dtype=dtype)

            b.repeat(b.op("sub", b.index(n - 1), j, dtype="i32"), column)

        b.repeat(b.op("sub", b.index(m - 1), j, dtype="i32"), update)

    b.repeat(steps, eliminate)
    return [result, Array((steps,), "i32", buffer=pivots), Array((m,), "i32", buffer=order)]


RULES: dict[str, Rule] = {"lu": _lu, "cholesky": _cholesky, "triangular_solve": _triangular_solve}
