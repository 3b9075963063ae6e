"""The proof of a certificate, from its matrices alone: no solver, and no rounding where a matrix must be definite.

Every entry counts as the fraction that its float is. From P = P' > 0 and P (A + B K) + (A + B K)'P < 0 follows that
A + B K is Hurwitz (Lyapunov): no eigenvalue is trusted. What is only compared with what the file records says so.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 14, 15, corrected as in `composite`; proofs as in `exact`.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh

from trimtab.core.errors import InputError
from trimtab.design import composite, exact
from trimtab.design.certificate import Certificate, ObserverPart, certificate_digest
from trimtab.design.observability import constant_rank
from trimtab.design.poles import format_pole, sorted_poles

CLOSE = 1e-9
"""How far identities (Riccati equations, K = -R_e^-1 B'P, L = P_eta C'R^-1) may be off, in parts of their largest term,
scaled."""
SAME = 1e-6
"""How far a number that is computed again may be from the recorded one, relative."""
HUGE = 1e50
"""Products of entries up to this, and down to its inverse on the diagonals that are inverted, are floats."""
ROBUST = {"K": 0.0, "K + R_e^-1 B'P/2": 0.5, "K - R_e^-1 B'P/2": -0.5}
FLOATS = "floats"
RECORDED = "recorded only"


class ProofCondition(NamedTuple):
    """One line of the proof.

    name: the condition.  holds: whether it is proved.  number: margin, deviation or value.  meaning: of the number.
    how: by what.  why: what broke it, or what else is worth knowing.
    """

    name: str
    holds: bool
    number: float
    meaning: str
    how: str
    why: str = ""


class CertificateProof(NamedTuple):
    """All conditions; holds: whether every one does."""

    conditions: tuple[ProofCondition, ...]
    holds: bool


def prove_certificate(certificate: Certificate, written: str | None = None) -> CertificateProof:
    """Prove a certificate again.

    Args:
        certificate: of `build_certificate` or of a file.
        written: the digest in the file, where there is one.
    """
    conditions = [*_entry_conditions(certificate)]
    if all(c.holds for c in conditions):  # else what follows has no meaning
        conditions += _feedback_conditions(certificate)
        conditions += _observer_conditions(certificate)
        conditions += _recorded_conditions(certificate)
    if written is not None and written != certificate_digest(certificate):
        why = "the file was changed after it was written; the other lines say what that did"
        name = "the file is as it was written"
        conditions.append(ProofCondition(name, False, float("nan"), "digest", "SHA-256", why))
    return CertificateProof(tuple(conditions), all(c.holds for c in conditions))


def _entry_conditions(c: Certificate) -> Iterator[ProofCondition]:
    """Entries of a size that can be shown, symmetry, and weights that are positive."""
    o = c.observer
    matrices = {n: getattr(c, n) for n in ("A", "B", "K", "P", "Qe", "Re", "Q", "scale") if getattr(c, n) is not None}
    matrices |= {} if o is None else {f"observer.{n}": getattr(o, n) for n in ("A", "C", "Q", "R", "P", "L")}
    for name, M in matrices.items():
        most = float(np.abs(M).max())
        least = float(np.abs(np.diag(M)).min()) if name in ("Re", "observer.R", "Qe") else 1.0
        if most > HUGE or 0 < least < 1 / HUGE:
            number = most if most > HUGE else least
            yield ProofCondition(f"{name} within floats", False, number, "largest or smallest entry", FLOATS)
            return
    pairs = [("P", c.P), ("Q_e", c.Qe), ("R_e", c.Re), *([] if c.Q is None else [("Q", c.Q)])]
    pairs += [] if o is None else [("P_eta", o.P), ("Q_eta", o.Q), ("R", o.R)]
    for name, M in pairs:
        apart = float(np.abs(M - M.T).max())
        if apart:
            i, j = np.unravel_index(int(np.abs(M - M.T).argmax()), M.shape)
            why = f"[{i}, {j}] is {M[i, j]!r}, [{j}, {i}] is {M[j, i]!r}"
            yield ProofCondition(f"{name} = {name}'", False, apart, "largest difference", "exact", why)
    if not all(np.array_equal(M, M.T) for _, M in pairs):
        return
    for name, M in (("Q_e > 0", c.Qe), ("R_e > 0", c.Re), *([] if o is None else [("R > 0", o.R)])):
        yield _definite_condition(name, exact.as_fractions(M), [str(i) for i in range(len(M))])


def _feedback_conditions(c: Certificate) -> Iterator[ProofCondition]:
    f = _rational_feedback(c)
    yield _definite_condition("P > 0", f.P, c.states)
    yield _definite_condition("(14)", composite.inequality_matrix(f), c.states, f.Qe, "Q_e")
    poles = sorted_poles((c.A + c.B @ c.K) * c.scale / c.scale[:, None])
    stable = _definite_condition("A + B K Hurwitz", composite.lyapunov_matrix(f), c.states, f.Qe, "Q_e")
    yield stable._replace(why=stable.why or f"rightmost pole {format_pole(poles[0])}")
    yield _poles_condition("poles of A + B K", poles, c.poles)
    if c.Q is None:
        return
    d, weight = c.scale, np.sqrt(np.diag(c.Re))
    K, optimal = (np.array(M, float) * d * weight[:, None] for M in (f.K, -(f.Re_inverse @ f.B.T @ f.P)))
    yield _residual_condition("K = -R_e^-1 B'P", K - optimal, optimal, (c.inputs, c.states))
    residual = np.array(composite.inequality_matrix(f) + f.Qe - exact.as_fractions(c.Q), float) * np.outer(d, d)
    yield _residual_condition("left side of (14) = Q_e - Q", residual, c.Q * np.outer(d, d), (c.states, c.states))


def _observer_conditions(c: Certificate) -> Iterator[ProofCondition]:
    if c.observer is None:
        return
    o, f, r = c.observer, _rational_feedback(c), _rational_observer(c, c.observer)
    yield _definite_condition("P_eta > 0", r.P, o.estimated)
    poles = sorted_poles(o.A - o.L @ o.C)
    stable = _definite_condition("A_eta - L C Hurwitz", composite.observer_lyapunov_matrix(r), o.estimated)
    yield stable._replace(why=stable.why or f"rightmost pole {format_pole(poles[0])}")
    yield _poles_condition("poles of A_eta - L C", poles, o.poles)
    yield _observability_condition(o, r)
    size = np.sqrt(np.diag(o.P))
    L, steady = (np.array(M, float) / size[:, None] for M in (r.L, r.P @ r.C.T @ r.R_inverse))
    yield _residual_condition("L = P_eta C'R^-1", L - steady, steady, (o.estimated, [str(i) for i in range(len(o.R))]))
    apart = composite.observer_lyapunov_matrix(r) - composite.dissipation_matrix(r)
    apart, term = (np.array(M, float) / np.outer(size, size) for M in (apart, r.A @ r.P))
    yield _residual_condition("Riccati equation of P_eta", apart, term, (o.estimated, o.estimated))
    yield _weight_condition(c, o)
    weight, names = Fraction(o.weight), (*c.states, *(f"w.{n}" for n in o.estimated))
    yield _definite_condition(f"(15) z({o.weight:.6g}) > 0", composite.weighted_matrix(f, r, weight), names)
    for gain, robust in ROBUST.items():
        M = composite.decrease_matrix(f, r, weight, Fraction(robust))
        yield _definite_condition(f"V falls, gain {gain}", M, names)


def _recorded_conditions(c: Certificate) -> Iterator[ProofCondition]:
    for name, number in c.recorded.items():
        inside = number.low <= number.value < number.high
        limits = f"at least {number.low:g}, below {number.high:g}; {number.how}"
        yield ProofCondition(name, inside, number.value, "value", RECORDED, limits)


def _weight_condition(c: Certificate, o: ObserverPart) -> ProofCondition:
    name, meaning = "least weight lambda*, as recorded", "relative deviation"
    try:
        least = composite.least_weight(c.feedback_matrices(), c.observer_matrices(o))
    except InputError as error:
        return ProofCondition(name, False, float("inf"), meaning, FLOATS, error.problem)
    off = abs(least - o.least_weight) / max(abs(least), np.finfo(float).tiny)
    why = "" if off <= SAME else f"now {least!r}, recorded {o.least_weight!r}"
    return ProofCondition(name, bool(off <= SAME), off, meaning, FLOATS, why)


def _observability_condition(o: ObserverPart, r: composite.Observer) -> ProofCondition:
    blocks = [r.C]
    for _ in range(len(o.A) - 1):
        blocks.append(blocks[-1] @ r.A)
    rank, k = exact.exact_rank(np.vstack(blocks)), len(o.A)
    name, ratio = f"(A_eta, C) observable, rank {rank} of {k}", constant_rank(o.A, o.C).ratio
    return ProofCondition(name, rank == k, ratio, "singular ratio, scaled", "exact rank")


def _definite_condition(name: str, M: Any, names: Any, unit: Any = None, label: str = "its diagonal") -> ProofCondition:
    """The line of one matrix that must be positive definite, with a margin that is proved too.

    Args:
        name: of the condition.
        M: symmetric matrix of Fractions.
        names: of its rows.
        unit: what the margin is measured in, positive definite; its own diagonal where not given.
        label: name of that.
    """
    proof = exact.prove_definite(M)
    meaning = f"margin in {label}"
    if not proof.holds:
        row = "" if proof.pivot is None else f" at {list(names)[proof.pivot]}"
        why = f"pivot{row} is {proof.value:.6g}"
        return ProofCondition(name, False, _smallest_eigenvalue(M, unit), meaning, proof.how, why)
    unit = np.diag(np.diag(M)) if unit is None else unit
    margin = float(f"{0.99 * _smallest_eigenvalue(M, unit):.2e}")  # so that what is shown is what is proved
    if not (margin > 0 and exact.prove_definite(M - Fraction(margin) * unit).holds):
        return ProofCondition(name, True, 0.0, meaning, proof.how, "positive, by less than floats can tell")
    return ProofCondition(name, True, margin, meaning, proof.how)


def _rational_feedback(c: Certificate) -> composite.Feedback:
    """The feedback's matrices as fractions; R_e is inverted exactly."""
    A, B, K, P, Qe, Re = (exact.as_fractions(M) for M in (c.A, c.B, c.K, c.P, c.Qe, c.Re))
    return composite.Feedback(A, B, K, P, Qe, exact.exact_inverse(Re))


def _rational_observer(c: Certificate, o: ObserverPart) -> composite.Observer:
    """The observer's matrices as fractions."""
    A, C, Q, P, L, R = (exact.as_fractions(M) for M in (o.A, o.C, o.Q, o.P, o.L, o.R))
    return composite.Observer(A, C, Q, P, L, exact.exact_inverse(R), c.estimated_indices())


def _smallest_eigenvalue(M: Any, unit: Any) -> float:
    """Smallest eigenvalue of M in units of `unit`, in floats."""
    a = np.array(M, float)
    b = np.diag(np.abs(np.diag(a))) if unit is None else np.array(unit, float)
    size = np.sqrt(np.where(np.diag(b) > 0, np.diag(b), 1.0))
    b = b / np.outer(size, size) if np.diag(b).all() else np.eye(len(a))
    try:
        values: Any = eigh(a / np.outer(size, size), b, eigvals_only=True)
    except np.linalg.LinAlgError:  # positive, but not for floats
        return float("nan")
    return float(values[0])


def _poles_condition(name: str, now: Any, then: Any) -> ProofCondition:
    """Each pole beside the nearest recorded one."""
    apart = np.abs(now[:, None] - then[None, :])
    worst = max(apart.min(axis=1).argmax(), 0)
    off = float(max(apart.min(axis=1).max(), apart.min(axis=0).max()) / np.abs(now).max())
    why = "" if off <= SAME else f"now {format_pole(now[worst])}, recorded {format_pole(then[apart[worst].argmin()])}"
    return ProofCondition(f"{name}, as recorded", bool(off <= SAME), off, "relative deviation", FLOATS, why)


def _residual_condition(name: str, apart: Any, term: Any, names: tuple[Any, Any]) -> ProofCondition:
    off = float(np.abs(apart).max() / np.abs(term).max())
    i, j = np.unravel_index(int(np.abs(apart).argmax()), apart.shape)
    why = "" if off <= CLOSE else f"worst at {names[0][i]}, {names[1][j]}"
    return ProofCondition(name, bool(off <= CLOSE), off, "relative deviation, scaled", "exact, compared in floats", why)
