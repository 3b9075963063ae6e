"""Exact proofs about float matrices: positive definiteness and rank, without rounding.

Every float is a fraction with a power of two as denominator. Sums and products of fractions are exact. A symmetric
matrix is positive definite if all its leading principal minors are positive. Fraction-free elimination (Bareiss)
computes these minors as integers of any size, so that no rounding error has to be bounded.

Source: [1] E. H. Bareiss, "Sylvester's identity and multistep integer-preserving Gaussian elimination", Math. Comp. 22
(1968).
"""

import math
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

EXACT = "exact, leading minors"


class DefinitenessProof(NamedTuple):
    """Result of a proof that a symmetric matrix is positive definite.

    holds: True if proved.  how: method.  pivot: index from 0 of the first non-positive pivot, or None.  value: value of
    this pivot, in the unit of the matrix; NaN if all pivots are positive.
    """

    holds: bool
    how: str
    pivot: int | None
    value: float


def as_fractions(M: Any) -> Any:
    """Convert a matrix of floats or integers to an array of Fractions, for which `@`, `+`, `-` and `*` are exact."""
    values: Any = np.asarray(M)
    fractions = np.empty(values.shape, object)
    for i in np.ndindex(values.shape):
        fractions[i] = Fraction(values.item(*i))  # Python's own number: NumPy's integers would overflow
    return fractions


def exact_inverse(M: Any) -> Any:
    """Return the exact inverse of a matrix of Fractions; raise ZeroDivisionError if it is singular."""
    n = len(M)
    work = np.hstack([M, as_fractions(np.eye(n))])
    for k in range(n):
        row = next((i for i in range(k, n) if work[i, k] != 0), None)
        if row is None:
            raise ZeroDivisionError("the matrix has no inverse")
        work[[k, row]] = work[[row, k]]
        work[k] = work[k] / work[k, k]
        for i in range(n):
            if i != k and work[i, k] != 0:
                work[i] = work[i] - work[i, k] * work[k]
    return work[:, n:]


def prove_definite(M: Any) -> DefinitenessProof:
    """Check exactly whether a symmetric matrix of floats or Fractions is positive definite.

    Raises: ValueError if the matrix is not symmetric.

    Source: [1], Sylvester's criterion: the pivots of the elimination are the leading minors of the matrix times the
    common denominator. Rows and columns are first scaled alike by powers of two. The scaling changes no sign, and keeps
    the integers short.
    """
    exact = as_fractions(M)
    if any(exact[i, j] != exact[j, i] for i in range(len(exact)) for j in range(i)):
        raise ValueError("not symmetric")
    bad = next((i for i in range(len(exact)) if exact[i, i] <= 0), None)
    if bad is not None:
        return DefinitenessProof(False, EXACT, bad, float(exact[bad, bad]))
    size = np.array([Fraction(2) ** -(_binary_exponent(d) // 2) for d in np.diag(exact)], object)
    scaled = exact * size * size[:, None]
    scale, before = _denominator(scaled), 1
    work = as_integers(scaled, scale)
    for k in range(len(work)):
        minor = work[k, k]
        if minor <= 0:
            return DefinitenessProof(False, EXACT, k, float(Fraction(minor, before * scale) / size[k] ** 2))
        for i in range(k + 1, len(work)):  # elimination keeps the matrix symmetric
            work[i, i:] = (work[i, i:] * minor - work[k, i:] * work[k, i]) // before
        before = minor
    return DefinitenessProof(True, EXACT, None, float("nan"))


def exact_rank(M: Any) -> int:
    """Return the exact rank of a matrix of floats or Fractions. Source: [1]."""
    exact = as_fractions(M)
    work = as_integers(exact, _denominator(exact))
    rank, before = 0, 1
    for column in range(work.shape[1]):
        row = next((i for i in range(rank, len(work)) if work[i, column]), None)
        if row is None:
            continue
        work[[rank, row]] = work[[row, rank]]
        for i in range(rank + 1, len(work)):
            work[i] = (work[i] * work[rank, column] - work[rank] * work[i, column]) // before
        before = work[rank, column]
        rank += 1
    return rank


def _binary_exponent(value: Fraction) -> int:
    """Return an integer k with 2^(k-1) < value < 2^(k+1); the value must be positive."""
    return value.numerator.bit_length() - value.denominator.bit_length()


def _denominator(M: Any) -> int:
    return math.lcm(*(v.denominator for v in M.ravel()))


def as_integers(M: Any, common: int) -> Any:
    """Return a matrix of Fractions times a common denominator, as integers of any size (dtype object)."""
    integers = np.empty(M.shape, object)
    for i in np.ndindex(M.shape):
        integers[i] = M[i].numerator * (common // M[i].denominator)
    return integers
