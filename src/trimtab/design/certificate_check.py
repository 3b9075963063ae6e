"""Proof, without a solver, that a certificate belongs to the named system and that its claims are true.

The system is built again from its code, and all data of the certificate is compared with the system, entry by entry.
Each entry is then converted without rounding from a float to a fraction. P = P' > 0 and P (A + B K) + (A + B K)'P < 0
imply that A + B K is Hurwitz (Lyapunov); the proof needs no eigenvalues. This code defines the conditions and their
limits. All conditions are evaluated, even after one has failed.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 14, 15, corrected as in `composite`; proofs as in `exact`.
"""

from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from trimtab.design import composite, exact
from trimtab.design.certificate import Certificate, ObserverPart
from trimtab.design.certificate_file import certificate_digest
from trimtab.design.certified_system import CertifiedSystem, compare_with_system, number_lines
from trimtab.design.observability import constant_rank
from trimtab.design.poles import format_pole, sorted_poles
from trimtab.design.proof import (
    CertificateProof,
    Line,
    ProofCondition,
    definite_condition,
    evaluate_lines,
    identity_condition,
    version_line,
)

SAME = 1e-6
"""Largest accepted relative deviation of a recomputed number from the number recorded in a certificate."""
SLOW = 1e-7
"""Fraction of the fastest pole that is added to each pole's size before relative deviations are computed. This share
allows for rounding errors of slow poles."""
ROBUST = {"K": 0.0, "K + R_e^-1 B'P/2": 0.5, "K - R_e^-1 B'P/2": -0.5}
FLOATS = "floats"


def prove_certificate(
    certificate: Certificate, system: CertifiedSystem, written: str | None = None
) -> CertificateProof:
    """Check all claims of a certificate, and return the result of each condition.

    Args:
        certificate: from `design_certificate` or from a file.
        system: the system that the certificate names, built again from code.
        written: digest stored in the certificate file; None if the certificate is not from a file.
    """
    lines = [*compare_with_system(certificate, system), *feedback_lines(certificate)]
    if certificate.observer is not None:
        lines += observer_lines(certificate, certificate.observer)
        lines += system.loop_lines(certificate)
    lines += number_lines(certificate, system)
    if written is not None:
        lines.append(version_line(certificate.version))
        lines.append(("file unchanged since it was written", lambda: _digest_condition(certificate, written)))
    return evaluate_lines(lines)


def feedback_lines(c: Certificate) -> Iterator[Line]:
    """Yield the conditions on the gain and its Lyapunov matrix."""
    inputs = c.inputs
    yield "Q_e > 0", lambda: definite_condition(c.Qe, c.states)
    yield "R_e > 0", lambda: definite_condition(c.Re, inputs)
    yield "P > 0", lambda: definite_condition(c.P, c.states)
    yield "(14)", lambda: _inequality_condition(c)
    yield "A + B K Hurwitz", lambda: _hurwitz_condition(c)
    yield "poles of A + B K, as recorded", lambda: _poles_condition(_closed_poles(c), c.poles)
    if c.Q is None:
        return
    yield "K = -R_e^-1 B'P", lambda: _gain_condition(c)
    yield "left side of (14) = Q_e - Q", lambda: _riccati_condition(c)


def observer_lines(c: Certificate, o: ObserverPart) -> Iterator[Line]:
    """Yield the conditions on the filter, and on gain and filter together."""
    rows, names = [str(i) for i in range(len(o.R))], (*c.states, *(f"w.{n}" for n in o.estimated))
    yield "R > 0", lambda: definite_condition(o.R, rows)
    yield "P_eta > 0", lambda: definite_condition(o.P, o.estimated)
    yield "A_eta - L C Hurwitz", lambda: _observer_hurwitz_condition(c, o)
    yield "poles of A_eta - L C, as recorded", lambda: _poles_condition(sorted_poles(o.A - o.L @ o.C), o.poles)
    yield "(A_eta, C) observable", lambda: _observability_condition(o)
    yield "L = P_eta C'R^-1", lambda: _steady_gain_condition(c, o, rows)
    yield "Riccati equation of P_eta", lambda: _steady_condition(c, o)
    yield "least weight lambda*, as recorded", lambda: _weight_condition(c, o)
    yield f"(15) z({o.weight:.6g}) > 0", lambda: _weighted_condition(c, o, names)
    for gain, robust in ROBUST.items():
        yield f"V falls, gain {gain}", partial(_decrease_condition, c, o, Fraction(robust), names)


def _inequality_condition(c: Certificate) -> ProofCondition:
    f = rational_feedback(c)
    return definite_condition(composite.inequality_matrix(f), c.states, f.Qe, "Q_e")


def _hurwitz_condition(c: Certificate) -> ProofCondition:
    A, B, K, P, Qe = (exact.as_fractions(M) for M in (c.A, c.B, c.K, c.P, c.Qe))
    f = composite.Feedback(A, B, K, P, Qe, None)
    stable = _also_positive(definite_condition(composite.lyapunov_matrix(f), c.states, Qe, "Q_e"), P)
    return stable._replace(why=stable.why or f"rightmost pole {format_pole(_closed_poles(c)[0])}")


def _also_positive(condition: ProofCondition, P: Any) -> ProofCondition:
    """Return the condition, marked as failed if P is not positive definite, because it then proves nothing."""
    if condition.holds and not exact.prove_definite(P).holds:
        return condition._replace(holds=False, why="the Lyapunov matrix itself is not positive definite")
    return condition


def _gain_condition(c: Certificate) -> ProofCondition:
    f, d, weight = rational_feedback(c), c.scale, np.sqrt(np.diag(c.Re))
    K, optimal = (np.array(M, float) * d * weight[:, None] for M in (f.K, -(f.Re_inverse @ f.B.T @ f.P)))
    return identity_condition(K - optimal, optimal, (c.inputs, c.states))


def _riccati_condition(c: Certificate) -> ProofCondition:
    f, size = rational_feedback(c), np.outer(c.scale, c.scale)
    apart = composite.inequality_matrix(f) + f.Qe - exact.as_fractions(c.Q)
    return identity_condition(np.array(apart, float) * size, c.Q * size, (c.states, c.states))


def _observer_hurwitz_condition(c: Certificate, o: ObserverPart) -> ProofCondition:
    A, C, Q, P, L = (exact.as_fractions(M) for M in (o.A, o.C, o.Q, o.P, o.L))
    r = composite.Observer(A, C, Q, P, L, None, c.estimated_indices())
    stable = _also_positive(definite_condition(composite.observer_lyapunov_matrix(r), o.estimated), P)
    return stable._replace(why=stable.why or f"rightmost pole {format_pole(sorted_poles(o.A - o.L @ o.C)[0])}")


def _observability_condition(o: ObserverPart) -> ProofCondition:
    A, blocks = exact.as_fractions(o.A), [exact.as_fractions(o.C)]
    for _ in range(len(o.A) - 1):
        blocks.append(blocks[-1] @ A)
    rank, k = exact.exact_rank(np.vstack(blocks)), len(o.A)
    ratio = constant_rank(o.A, o.C).ratio
    return ProofCondition("", rank == k, ratio, "ratio of singular values", "exact rank", f"rank {rank} of {k}")


def _steady_gain_condition(c: Certificate, o: ObserverPart, rows: list[str]) -> ProofCondition:
    r, size = rational_observer(c, o), np.sqrt(np.diag(o.P))
    L, steady = (np.array(M, float) / size[:, None] for M in (r.L, r.P @ r.C.T @ r.R_inverse))
    return identity_condition(L - steady, steady, (o.estimated, rows))


def _steady_condition(c: Certificate, o: ObserverPart) -> ProofCondition:
    r, size = rational_observer(c, o), np.sqrt(np.diag(o.P))
    apart = composite.observer_lyapunov_matrix(r) - composite.dissipation_matrix(r)
    apart, term = (np.array(M, float) / np.outer(size, size) for M in (apart, r.A @ r.P))
    return identity_condition(apart, term, (o.estimated, o.estimated))


def _weighted_condition(c: Certificate, o: ObserverPart, names: tuple[str, ...]) -> ProofCondition:
    M = composite.weighted_matrix(rational_feedback(c), rational_observer(c, o), Fraction(o.weight))
    return definite_condition(M, names)


def _decrease_condition(c: Certificate, o: ObserverPart, robust: Fraction, names: tuple[str, ...]) -> ProofCondition:
    M = composite.decrease_matrix(rational_feedback(c), rational_observer(c, o), Fraction(o.weight), robust)
    return definite_condition(M, names)


def _weight_condition(c: Certificate, o: ObserverPart) -> ProofCondition:
    least = composite.least_weight(c.feedback_matrices(), c.observer_matrices(o))
    off = abs(least - o.least_weight) / max(abs(least), np.finfo(float).tiny)
    why = "" if off <= SAME else f"computed {least!r}, recorded {o.least_weight!r}"
    return ProofCondition("", bool(off <= SAME), off, "relative deviation", FLOATS, why)


def _digest_condition(c: Certificate, written: str) -> ProofCondition:
    same = written == certificate_digest(c)
    why = "" if same else "the file was changed after it was written; the other conditions show the effect"
    return ProofCondition("", same, float(not same), "differences", "SHA-256", why)


def _closed_poles(c: Certificate) -> Any:
    return sorted_poles((c.A + c.B @ c.K) * c.scale / c.scale[:, None])


def rational_feedback(c: Certificate) -> composite.Feedback:
    """Return the feedback's matrices as fractions. R_e is inverted exactly."""
    A, B, K, P, Qe, Re = (exact.as_fractions(M) for M in (c.A, c.B, c.K, c.P, c.Qe, c.Re))
    return composite.Feedback(A, B, K, P, Qe, exact.exact_inverse(Re))


def rational_observer(c: Certificate, o: ObserverPart) -> composite.Observer:
    """Return the observer's matrices as fractions."""
    A, C, Q, P, L, R = (exact.as_fractions(M) for M in (o.A, o.C, o.Q, o.P, o.L, o.R))
    return composite.Observer(A, C, Q, P, L, exact.exact_inverse(R), c.estimated_indices())


def _poles_condition(now: Any, then: Any) -> ProofCondition:
    """Pair each computed pole with a recorded pole, and compare the poles of each pair.

    Each deviation is relative to the pole's own size, so that errors of slow poles are not hidden by fast poles.
    """
    if now.shape != then.shape:
        raise ValueError(f"{len(then)} poles are recorded, but {len(now)} are computed")
    apart = np.abs(now[:, None] - then[None, :])
    rows, columns = linear_sum_assignment(apart)
    paired = apart[rows, columns]
    own = np.abs(now[rows]) + SLOW * np.abs(now).max()
    ratio = paired / np.where(own > 0, own, 1.0)
    worst, off = int(ratio.argmax()), float(ratio.max())
    why = f"computed {format_pole(now[rows[worst]])}, recorded {format_pole(then[columns[worst]])}"
    return ProofCondition("", off <= SAME, off, "relative deviation", FLOATS, "" if off <= SAME else why)
