"""Proofs about matrices of floats: positive definiteness and rank, without rounding.

Every float is a fraction with a power of two below; sums and products of fractions are exact. A symmetric matrix is
positive definite where all its leading principal minors are positive; elimination without fractions (Bareiss) gives
them as integers. Above LARGEST rows a Cholesky factorisation with a bound of its rounding takes over, which also
proves, but may fail where the matrix is nearly singular.

Source: [1] E. H. Bareiss, "Sylvester's identity and multistep integer-preserving Gaussian elimination", Math. Comp. 22
(1968); [2] S. M. Rump, "Verification of positive definiteness", BIT Numerical Mathematics 46 (2006).
"""

import math
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

LARGEST = 32
"""Matrices of more rows are proved by Cholesky with bounds."""
EXACT, BOUNDED = "exact, leading minors", "Cholesky, rounding bounded"
UNIT = 2.0**-53


class DefinitenessProof(NamedTuple):
    """Whether a symmetric matrix is positive definite.

    holds: proved.  how: by what.  pivot: 0-based place of the first pivot that is not positive, or None.  value: that
    pivot, minor over the minor before, in the matrix's own unit; nan where there is none.
    """

    holds: bool
    how: str
    pivot: int | None
    value: float


def as_fractions(M: Any) -> Any:
    """A matrix of floats as the same matrix of Fractions (dtype object), which `@`, `+`, `-`, `*` then keep exact."""
    values: Any = np.asarray(M)
    fractions = np.empty(values.shape, object)
    for i in np.ndindex(values.shape):
        fractions[i] = Fraction(values[i])
    return fractions


def exact_inverse(M: Any) -> Any:
    """The inverse of a positive definite matrix of Fractions, exactly."""
    n = len(M)
    work = np.hstack([M, as_fractions(np.eye(n))])
    for k in range(n):
        row = next(i for i in range(k, n) if work[i, k] != 0)
        work[[k, row]] = work[[row, k]]
        work[k] = work[k] / work[k, k]
        for i in range(n):
            if i != k and work[i, k] != 0:
                work[i] = work[i] - work[i, k] * work[k]
    return work[:, n:]


def prove_definite(M: Any) -> DefinitenessProof:
    """Whether a symmetric matrix, of floats or of Fractions, is positive definite.

    Source: [1], Sylvester's criterion; above LARGEST rows [2].
    """
    exact = as_fractions(M)
    if any(exact[i, j] != exact[j, i] for i in range(len(exact)) for j in range(i)):
        raise ValueError("not symmetric")
    bad = next((i for i in range(len(exact)) if exact[i, i] <= 0), None)
    if bad is not None:
        return DefinitenessProof(False, EXACT, bad, float(exact[bad, bad]))
    return _prove_by_minors(exact) if len(exact) <= LARGEST else _prove_by_cholesky(exact)


def exact_rank(M: Any) -> int:
    """Rank of a matrix of floats or Fractions, exactly. Source: [1]."""
    work = _integers(as_fractions(M))
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


def _prove_by_minors(M: Any) -> DefinitenessProof:
    """Leading minors of the matrix times the common denominator: the pivots of Bareiss' elimination."""
    work = _integers(M)
    scale, before = _denominator(M), 1
    for k in range(len(work)):
        minor = work[k, k]
        if minor <= 0:
            return DefinitenessProof(False, EXACT, k, float(Fraction(minor, before * scale)))
        for i in range(k + 1, len(work)):
            work[i, k + 1 :] = (work[i, k + 1 :] * minor - work[k, k + 1 :] * work[i, k]) // before
        before = minor
    return DefinitenessProof(True, EXACT, None, float("nan"))


def _prove_by_cholesky(M: Any) -> DefinitenessProof:
    """[2]: if the floating-point factorisation of M - c I runs through, c above its largest error, M is positive.

    The matrix is first scaled by powers of two to a diagonal in [1/4, 1), without error, and then rounded: c holds
    for that too.
    """
    n = len(M)
    halves = [math.floor(math.log2(d.numerator) - math.log2(d.denominator)) // 2 + 1 for d in np.diag(M)]
    size = [Fraction(2) ** -k for k in halves]
    rounded = np.array([[float(M[i, j] * size[i] * size[j]) for j in range(n)] for i in range(n)])
    gamma = (n + 2) * UNIT / (1 - (n + 2) * UNIT)
    error = gamma / (1 - 2 * gamma) * np.trace(rounded) + 4 * UNIT * np.abs(rounded).sum(axis=1).max() + n * 1e-300
    try:
        np.linalg.cholesky(rounded - 2 * error * np.eye(n))
    except np.linalg.LinAlgError:
        return DefinitenessProof(False, BOUNDED, n - 1, float(np.linalg.eigvalsh(rounded)[0]))
    return DefinitenessProof(True, BOUNDED, None, float("nan"))


def _denominator(M: Any) -> int:
    return math.lcm(*(v.denominator for v in M.ravel()))


def _integers(M: Any) -> Any:
    common = _denominator(M)
    integers = np.empty(M.shape, object)
    for i in np.ndindex(M.shape):
        integers[i] = M[i].numerator * (common // M[i].denominator)
    return integers
