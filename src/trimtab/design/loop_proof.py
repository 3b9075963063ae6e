"""Exact stability proofs of a closed loop: for sampled control, for all plants in a box, and within the inputs' limits.

The Lyapunov matrices are found in floats, with LAPACK only. The proof does not depend on this search: it checks each
matrix with every entry taken as the exact fraction of its float.

    sampled:  rho^2 P - F'P F > 0                       rho < 1: z decays by rho in each period
    box:      P (A + r I) + (A + r I)'P < 0 at every vertex, with the same P. This proves all plants in the box,
              also while the plant changes within the box. P comes from the S-procedure: each uncertain parameter is
              taken as a bounded feedback, multipliers minimise the gain of the loop around these feedbacks, and a
              Riccati equation yields P.

    level:    |g z| < room wherever V(z) <= c, for each input g z, whose distance from the nearer limit is room. No
              input saturates in this set, and motions that start in it never leave it, because V falls.

Source: [1] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, "Linear matrix inequalities in system and control theory",
SIAM 1994, sections 5.1, 5.2, 6.1; proofs as in `exact`.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_are, solve_discrete_lyapunov
from scipy.optimize import minimize

from trimtab.design import exact
from trimtab.design.certificate import Certificate, ObserverPart
from trimtab.design.proof import ProofCondition

SHARE = 0.9
"""Decay rate proved for a sampled loop, as a fraction of the decay rate of its slowest pole."""
LOOP_SIZE_MAX = 0.97
"""Largest gain, of the loop around the uncertain parameters, that the search for multipliers accepts without trying to
reduce it."""
FREQUENCIES = np.concatenate([np.linspace(0.0, 40.0, 320), np.geomspace(40.0, 4000.0, 40)])
"""Frequencies (rad/s) at which the search for multipliers evaluates the loop around the uncertain parameters. The proof
does not depend on these frequencies."""
MEANING = "decay, 1/s"


def prove_sampled(F: Any, size: Any, period: float, names: Sequence[str]) -> ProofCondition:
    """Return the condition that z(k+1) = F z(k) is stable, with the proved decay rate (1/s).

    Args:
        F: (n, n).
        size: sizes of the states (n,), in which the Lyapunov matrix is found.
        period: time of one step of the loop (s).
        names: names of the states.
    """
    scaled = F * size / size[:, None]
    slowest = -np.log(np.abs(np.linalg.eigvals(F)).max()) / period
    how = f"exact, {len(F)} states at {1 / period:g} Hz"
    if not slowest > 0:
        return ProofCondition("", False, float(slowest), MEANING, how, "the loop is not stable")
    rho = float(np.exp(-SHARE * slowest * period))
    P: Any = solve_discrete_lyapunov(scaled.T / rho, np.eye(len(F)))
    P = (P + P.T) / np.outer(size, size)
    exact_P, exact_F = exact.as_fractions(P), exact.as_fractions(F)
    inside = _multiply(exact_F.T, _multiply(exact_P, exact_F))
    for M in (exact_P, Fraction(rho) ** 2 * exact_P - inside):
        proof = exact.prove_definite(M)
        if proof.pivot is not None:
            why = f"pivot at {names[proof.pivot]} is {proof.value:.6g}"
            return ProofCondition("", False, float(slowest), MEANING, how, why)
    return ProofCondition("", True, float(-np.log(rho) / period), MEANING, how)


def prove_boxes(boxes: Sequence[Any], size: Any, rate: float, names: Sequence[str]) -> ProofCondition:
    """Return the condition that the loop is stable for all plants in the given boxes, with one Lyapunov matrix per box.

    Args:
        boxes: for each box, the loop's matrices at the box's vertices (2^k, n, n), the last parameter changing fastest;
            between the vertices they are affine in each parameter.
        size: sizes of the states (n,), in which the Lyapunov matrices are found.
        rate: decay rate to be proved (1/s).
        names: names of the states.
    """
    how = f"exact, {sum(len(vertices) for vertices in boxes)} vertices of {len(boxes)} boxes"
    multipliers = None
    for number, vertices in enumerate(boxes):
        scaled = vertices * size / size[:, None]
        P, multipliers = _common_lyapunov(scaled, rate, multipliers)
        broken = None if P is None else _first_broken(vertices, P / np.outer(size, size), rate, names)
        if P is None or broken is not None:
            slowest = -float(np.linalg.eigvals(vertices).real.max())
            why = f"box {number + 1}: {broken or 'no Lyapunov matrix was found that holds at all vertices'}"
            return ProofCondition("", False, slowest, MEANING, how, why)
    return ProofCondition("", True, rate, MEANING, how)


def prove_level(c: Certificate, o: ObserverPart, slope: Any, room: Any) -> ProofCondition:
    """Return the condition that no input saturates in a level set of V = e'P e/2 + weight e_eta'P_eta^-1 e_eta.

    Args:
        c: certificate; its P defines the first term of V.
        o: the certificate's observer; its P_eta and weight define the second term of V.
        slope: derivatives of the inputs by (e, e_eta) (m, n + k). The inputs are linear in (e, e_eta).
        room: distance of each input at rest from its nearer limit (m,).
    """
    n, meaning, how = len(c.A), "level of V", f"exact, {len(room)} inputs"
    if not (np.asarray(room) > 0).all():
        return ProofCondition("", False, 0.0, meaning, how, "an input is at or beyond its limit at rest")
    P, P_eta, weight = exact.as_fractions(c.P), exact.as_fractions(o.P), Fraction(o.weight)
    S = np.full((n + len(o.P),) * 2, Fraction(0))
    S[:n, :n], S[n:, n:] = P / Fraction(2), weight * P_eta  # in coordinates w with e_eta = P_eta w
    positive = exact.prove_definite(S)
    if positive.pivot is not None:
        return ProofCondition("", False, 0.0, meaning, how, f"V is not positive: pivot {positive.value:.6g}")
    g = exact.as_fractions(slope)
    g = np.hstack([g[:, :n], g[:, n:] @ P_eta])
    size = 1 / np.sqrt(np.diag(np.array(S, float)))
    scaled, rows = np.array(S, float) * np.outer(size, size), np.array(g, float) * size
    reach = np.einsum("ij,ji->i", rows, np.linalg.solve(scaled, rows.T))
    level = float(0.99 * np.min(np.asarray(room) ** 2 / reach))
    for row, limit in zip(g, room, strict=True):
        edge = np.array([[Fraction(float(limit)) ** 2 / Fraction(level)]], object)
        proof = exact.prove_definite(np.block([[edge, row[None]], [row[:, None], S]]))
        if proof.pivot is not None:
            return ProofCondition("", False, level, meaning, how, f"pivot {proof.value:.6g} in row {proof.pivot}")
    widest = np.sqrt(2 * level / np.diag(c.P))
    why = "largest single errors within the level: " + ", ".join(
        f"{s} {w:.3g}" for s, w in zip(c.states, widest, strict=True)
    )
    return ProofCondition("", True, level, meaning, how, why)


def _first_broken(vertices: Any, P: Any, rate: float, names: Sequence[str]) -> str | None:
    exact_P = exact.as_fractions(P)
    proof = exact.prove_definite(exact_P)
    if proof.pivot is not None:
        return f"P has a pivot {proof.value:.6g} at {names[proof.pivot]}"
    for i, A in enumerate(vertices):
        work = _multiply(exact_P, exact.as_fractions(A) + Fraction(rate) * exact.as_fractions(np.eye(len(A))))
        proof = exact.prove_definite(-(work + work.T))
        if proof.pivot is not None:
            return f"vertex {i + 1}: pivot {proof.value:.6g} at {names[proof.pivot]}"
    return None


def _common_lyapunov(vertices: Any, rate: float, multipliers: Any) -> tuple[Any, Any]:
    """Return a Lyapunov matrix P for a whole box, or None if the search fails, and the multipliers for the next search.

    Source: [1] section 5.1.
    """
    n, count = vertices.shape[-1], len(vertices).bit_length() - 1
    centre = vertices.mean(axis=0) + rate * np.eye(n)
    cube = vertices.reshape(*(2,) * count, n, n)
    H, E = [], []
    for k in range(count):
        low, high = (np.take(cube, side, axis=k).reshape(-1, n, n).mean(axis=0) for side in (0, 1))
        u, s, v = np.linalg.svd((high - low) / 2)
        rank = int((s > 1e-9 * s[0]).sum()) if s[0] > 0 else 0
        H += [u[:, j] * np.sqrt(s[j]) for j in range(rank)]
        E += [v[j] * np.sqrt(s[j]) for j in range(rank)]
    H, E = np.array(H).reshape(-1, n).T, np.array(E).reshape(-1, n)
    multipliers = _search_multipliers(centre, H, E, multipliers)
    if len(E):
        H, E = H / multipliers, E * multipliers[:, None]
    else:
        H = np.zeros((n, 1))
    try:
        P: Any = solve_continuous_are(centre, H, E.T @ E + 1e-3 * np.eye(n), -np.eye(H.shape[1]))
    except np.linalg.LinAlgError:
        return None, multipliers
    return (P + P.T) / 2, multipliers


def _search_multipliers(A: Any, H: Any, E: Any, start: Any) -> Any:
    """Find multipliers for which the loop around the uncertain parameters has a gain below LOOP_SIZE_MAX, if possible.

    The gain is the largest singular value over FREQUENCIES. It is convex in the multipliers' logarithms.
    """
    k = len(E)
    if k < 2:
        return np.ones(k)
    G = np.array([E @ np.linalg.solve(1j * w * np.eye(len(A)) - A, H) for w in FREQUENCIES])

    def largest(logs: Any) -> float:
        t = np.exp(np.append(logs, 0.0))
        return float(np.linalg.norm(G * t[:, None] / t, 2, axis=(1, 2)).max())

    first = np.zeros(k - 1) if start is None or len(start) != k else np.log(start[:-1] / start[-1])
    if largest(first) >= LOOP_SIZE_MAX:
        options = {"maxiter": 300, "fatol": 1e-3}
        first = minimize(largest, first, method="Nelder-Mead", options=options, callback=_stop_early).x
    return np.exp(np.append(first, 0.0))


def _stop_early(intermediate_result: Any) -> None:
    """Stop the search for multipliers as soon as the loop's gain is small enough."""
    if intermediate_result.fun < 0.9 * LOOP_SIZE_MAX:
        raise StopIteration


def _multiply(M: Any, N: Any) -> Any:
    """Multiply, as integers, two matrices of fractions whose denominators are powers of two."""
    powers = [max(v.denominator for v in X.ravel()) for X in (M, N)]
    a, b = (exact.as_integers(X, power) for X, power in zip((M, N), powers, strict=True))
    product, whole = a @ b, powers[0] * powers[1]
    fractions = np.empty(product.shape, object)
    for i in np.ndindex(product.shape):
        fractions[i] = Fraction(product[i], whole)
    return fractions
