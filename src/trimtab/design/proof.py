"""Proofs as lists of conditions. Each condition is evaluated independently, and its result contains a number, e.g. a
margin. Definiteness is proved without rounding.

Source: this module; proofs of definiteness as in `exact`.
"""

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh

from trimtab import __version__
from trimtab.core.errors import InputError
from trimtab.design import exact

IDENTITY_ERROR_MAX = 1e-9
"""Largest accepted error of an identity (e.g. a Riccati equation), relative to a term of the identity, in scaled
units."""


class ProofCondition(NamedTuple):
    """Condition of a proof, and its result.

    name: name of the condition.  holds: True if proved.  number: margin, deviation or value.  meaning: quantity that
    the number states.  how: method.  why: reason for failure, or a remark.
    """

    name: str
    holds: bool
    number: float
    meaning: str
    how: str
    why: str = ""


class CertificateProof(NamedTuple):
    """Result of a proof: all conditions. holds: True if every condition holds."""

    conditions: tuple[ProofCondition, ...]
    holds: bool


Line = tuple[str, Callable[[], ProofCondition]]
"""Pair: name of a condition, and the function that evaluates the condition."""


def evaluate_lines(lines: Iterable[Line]) -> CertificateProof:
    """Evaluate all conditions, even after one has failed. A condition that can't be computed fails, with the reason."""
    conditions = []
    for name, compute in lines:
        try:
            with np.errstate(all="ignore"):
                condition = compute()
        except InputError as error:
            condition = ProofCondition(name, False, float("nan"), "not computable", "", error.problem)
        except (ArithmeticError, ValueError) as error:
            condition = ProofCondition(name, False, float("nan"), "not computable", "", str(error))
        conditions.append(condition._replace(name=name))
    return CertificateProof(tuple(conditions), all(c.holds for c in conditions))


def version_line(written: str) -> Line:
    """Return the condition that this version of the package wrote the certificate.

    A certificate of another version can't be proved, because the conditions may differ between versions.
    """
    same = written == __version__
    why = "" if same else f"written by version {written!r}, but this is version {__version__}; design the gain again"
    return "version is that of this package", lambda: ProofCondition(
        "", same, float(not same), "differences", "text", why
    )


def definite_condition(M: Any, names: Sequence[str], unit: Any = None, label: str = "its diagonal") -> ProofCondition:
    """Return the condition that a matrix is positive definite, with a proved margin.

    Args:
        M: matrix of floats or of Fractions; the condition fails if it is not symmetric.
        names: names of the matrix's rows.
        unit: positive definite matrix that is the unit of the margin; default: the diagonal of M.
        label: name of the unit, for the report.
    """
    meaning = f"margin in {label}"
    apart = np.argwhere(M != M.T)
    if len(apart):
        i, j = apart[0].tolist()
        why = (
            f"not symmetric: {names[i]}, {names[j]} is {float(M[i, j])!r}, {names[j]}, {names[i]} is {float(M[j, i])!r}"
        )
        return ProofCondition("", False, float(M[i, j] - M[j, i]), "difference", exact.EXACT, why)
    M = exact.as_fractions(M)
    proof = exact.prove_definite(M)
    if proof.pivot is not None:
        why = f"pivot at {names[proof.pivot]} is {proof.value:.6g}"
        return ProofCondition("", False, _smallest_eigenvalue(M, unit), meaning, proof.how, why)
    unit = np.diag(np.diag(M)) if unit is None else unit
    lowest = _smallest_eigenvalue(M, unit)
    margin = (
        float(f"{0.99 * lowest:.2e}") if np.isfinite(lowest) else 0.0
    )  # rounded, so that the proved margin is the margin that is printed
    if not (margin > 0 and exact.prove_definite(M - Fraction(margin) * unit).holds):
        return ProofCondition(
            "", True, 0.0, meaning, proof.how, "positive definite; the margin is below the resolution of floats"
        )
    return ProofCondition("", True, margin, meaning, proof.how)


def identity_condition(apart: Any, term: Any, names: tuple[Sequence[str], Sequence[str]]) -> ProofCondition:
    """Return the condition that an identity holds.

    Args:
        apart: difference of the identity's two sides, scaled.
        term: one of the identity's terms, scaled.
        names: names of rows and columns.
    """
    off = float(np.abs(apart).max() / np.abs(term).max())
    i, j = (int(k) for k in np.unravel_index(int(np.abs(apart).argmax()), apart.shape))
    why = "" if off <= IDENTITY_ERROR_MAX else f"largest deviation at {names[0][i]}, {names[1][j]}"
    return ProofCondition(
        "", off <= IDENTITY_ERROR_MAX, off, "relative deviation, scaled", "exact, compared in floats", why
    )


def _smallest_eigenvalue(M: Any, unit: Any) -> float:
    """Return the smallest eigenvalue of M in units of `unit`, in floats; NaN if floats can't resolve it."""
    a = np.array(M, float)
    b = np.diag(np.abs(np.diag(a))) if unit is None else np.array(unit, float)
    size = np.sqrt(np.where(np.diag(b) > 0, np.diag(b), 1.0))
    b = b / np.outer(size, size) if np.diag(b).all() else np.eye(len(a))
    try:
        values: Any = eigh(a / np.outer(size, size), b, eigvals_only=True)
    except (np.linalg.LinAlgError, ValueError):  # the unit is positive definite exactly, but not in floats
        return float("nan")
    return float(values[0])
