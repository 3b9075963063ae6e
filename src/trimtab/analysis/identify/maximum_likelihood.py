"""Maximum-likelihood estimates of model parameters from flights, by a Kalman filter and its derivatives.

    x_{k+1} = f(x_k, u_k(p), h_k; p) + w_k,   w ~ N(0, diag(q(p)) h_k)
    y_k = x_k[measured] + v_k,                v ~ N(0, diag(r(p)))
    log L(p) = -1/2 sum( e²/s + log(2 pi s) )      e, s: innovation, variance

The filter predicts the state with the model's integration step, and the covariance with the derivatives of this step.
e and s are differentiated with respect to all parameters, including the noise variances. The search uses Fisher
scoring:

    I_ij = sum( e_i' e_j'/s + s_i' s_j'/(2 s²) )      g_i = sum( -e e_i'/s + (e²/s - 1) s_i'/(2 s) )

At the start of a flight, and after a long gap, the filter starts with a nearly unknown state.

Source: Åström, "Maximum likelihood and prediction error methods", Automatica 16 (1980); Kristensen, Madsen, Jørgensen,
"Parameter estimation in stochastic grey-box models", Automatica 40 (2004), for scoring with a filter's innovations;
Raue et al., Bioinformatics 25 (2009), for intervals and non-identifiable parameters, by the profile likelihood.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.special import chdtrc

jax.config.update("jax_enable_x64", True)

ITERATIONS = 40
TOLERANCE = 0.02
"""Change of the log likelihood in a scoring step below which the search ends."""
HALF_CHI = 1.9207294103470585
"""Fall of the log likelihood from the maximum to the ends of a 95 % interval: half of chi², 1 degree of freedom."""
COLLINEAR = 1e-4
"""Eigenvalue of the normalised information matrix below which the data do not determine the eigenvector's direction."""
SHARE = 0.3
"""Smallest component of such an eigenvector for which the component's parameter is reported as not determined."""
REACHES = np.array([-1.4, -0.8, 0.8, 1.4])
"""Distances from the estimate at which the profile likelihood is computed, in half-widths of the interval that follows
from the information matrix."""
CORRECTIONS = 1
"""Number of scoring steps for the other parameters at each point of the profile likelihood."""


class Timeline(NamedTuple):
    """One or more flights, joined end to end, with n instants. A segment is a flight, or a part of it after a long gap.

    h: time (s) since the previous instant (n,), 0 where a segment begins.  begins: (n,) bool, True at the first instant
    of a segment.
    y: measurements (n, k).  seen: (n, k) bool, True where y was measured.  first: initial state
    (n, d), used only where a segment begins.  drive: data from which the model computes the inputs.  owner: number of
    the flight (n,), from 0.
    """

    h: Any
    begins: Any
    y: Any
    seen: Any
    first: Any
    drive: Any = ()
    owner: Any = ()

    def segments(self) -> list[tuple[Any, Any]]:
        """Return `h` and `begins` of each segment."""
        starts = np.flatnonzero(self.begins)
        ends = [*starts[1:], len(self.h)]
        return [(self.h[a:b], self.begins[a:b]) for a, b in zip(starts, ends, strict=True)]


class Model(NamedTuple):
    """Model to fit. All functions depend on the parameters p (m,), which may have any unit.

    step(p, x, u, h): state (d,) after a time h (s), from state x (d,) and input u.
    inputs(p, drive): inputs of all steps, arrays (n, …).
    process(p): process noise q (d,), variance per second.  noise(p): measurement noise variances r (k,).
    measured: indices of the measured states (k,).  wraps: (k,) bool, True for angles.
    spread: variances (d,) of the initial state of a segment.
    """

    step: Callable[[Any, Any, Any, Any], Any]
    inputs: Callable[[Any, Any], Any]
    process: Callable[[Any], Any]
    noise: Callable[[Any], Any]
    measured: tuple[int, ...]
    wraps: tuple[bool, ...]
    spread: Any


class Innovations(NamedTuple):
    """Innovations of a filter over a timeline.

    e, s: innovations and innovation variances (n, k); 0 and 1 where nothing was measured.  x: states after the updates
    (n, d).
    """

    e: Any
    s: Any
    x: Any


class CompiledLikelihood(NamedTuple):
    """Likelihood and its derivatives, compiled once for all timelines of the same shape.

    score(timeline, p): log likelihood, gradient (m,), information matrix (m, m).  value(timeline, p): log likelihood.
    slopes(timeline, p (n, m), along (j, m)): log likelihoods (n,) at n points, and derivatives (n, j) along j
    directions.
    innovations(timeline, p): `Innovations`.
    """

    score: Callable[[Any, Any], Any]
    value: Callable[[Any, Any], Any]
    slopes: Callable[[Any, Any, Any], Any]
    innovations: Callable[[Any, Any], Innovations]


class LikelihoodEstimate(NamedTuple):
    """Maximum-likelihood estimate. p: parameters (m,).  information: Fisher information matrix (m, m).

    log_likelihood: log likelihood at p.  converged: True if the search ended at a maximum.  iterations: number of
    steps.
    """

    p: Any
    information: Any
    log_likelihood: float
    converged: bool
    iterations: int


def filter_innovations(model: Model, timeline: Timeline, p: Any) -> Innovations:
    """Compute the filter's innovations over the whole timeline for parameters p (m,)."""
    q, r, u = model.process(p), model.noise(p), model.inputs(p, timeline.drive)
    spread = jnp.asarray(model.spread)

    def advance(carry: Any, at: Any) -> Any:
        x, P = carry
        h, begins, y, seen, first, u = at

        def ahead(x: Any) -> Any:
            return model.step(p, x, u, h)

        F = jax.jacfwd(ahead)(x)
        x = jnp.where(begins, first, ahead(x))
        P = jnp.where(begins, jnp.diag(spread), F @ P @ F.T + jnp.diag(q * h))
        errors, variances = [], []
        for j, (i, wraps) in enumerate(zip(model.measured, model.wraps, strict=True)):
            e = y[j] - x[i]
            e = (e + jnp.pi) % (2 * jnp.pi) - jnp.pi if wraps else e
            s = P[i, i] + r[j]
            K = jnp.where(seen[j], P[:, i] / s, 0.0)
            errors.append(jnp.where(seen[j], e, 0.0))
            variances.append(jnp.where(seen[j], s, 1.0))
            x, P = x + K * errors[-1], P - jnp.outer(K, P[i])
        return (x, (P + P.T) / 2), (jnp.stack(errors), jnp.stack(variances), x)

    start = jnp.asarray(timeline.first[0]), jnp.diag(spread)
    rows = tuple(jnp.asarray(v) for v in timeline[:5])
    _, (e, s, x) = lax.scan(advance, start, (*rows, u))
    return Innovations(e, s, x)


def log_likelihood(model: Model, timeline: Timeline, p: Any) -> Any:
    """Compute the log likelihood of the measurements for parameters p (m,)."""
    e, s, _ = filter_innovations(model, timeline, p)
    return -0.5 * jnp.sum(jnp.where(jnp.asarray(timeline.seen), e * e / s + jnp.log(2 * jnp.pi * s), 0.0))


def maximise_likelihood(
    likelihood: CompiledLikelihood,
    timeline: Timeline,
    p: Any,
    low: Any,
    high: Any,
    *,
    free: Any = None,
    tell: Callable[[int, float], None] = lambda iteration, value: None,
) -> LikelihoodEstimate:
    """Maximise the likelihood by Fisher scoring. Each step is shortened until the likelihood grows.

    Args:
        likelihood: compiled likelihood of the model.  timeline: the flights.
        p: parameters at the start of the search (m,).
        low, high: bounds of the parameters (m,).
        free: (m,) bool, True for parameters that may change. None: all may change.
        tell: function that is called with iteration and log likelihood, to show the progress.
    """
    score, value = (functools.partial(f, timeline) for f in (likelihood.score, likelihood.value))
    p, low, high = (np.asarray(v, np.float64) for v in (p, low, high))
    free = np.ones(len(p), bool) if free is None else np.asarray(free)
    best, g, information = (np.asarray(v) for v in score(p))
    damping, converged, iteration = 1e-3, False, 0
    for iteration in range(1, ITERATIONS + 1):
        tell(iteration, float(best))
        inside = free & ~((p <= low) & (g < 0)) & ~((p >= high) & (g > 0))
        step, new, gained = np.zeros_like(p), p, False
        for _ in range(8):
            step[:] = 0.0
            step[inside] = _damped_solve(information[np.ix_(inside, inside)], g[inside], damping)
            new = np.clip(p + step, low, high)
            after = float(value(new))
            if np.isfinite(after) and after > best - 1e-9:
                gained = True
                break
            damping = max(10 * damping, 1e-3)
        if not gained:
            converged = float(g @ step) < TOLERANCE
            break
        promised, p, damping = float(g @ step) / 2, new, damping / 10 if damping > 1e-9 else damping
        best, g, information = (np.asarray(v) for v in score(p))
        if promised < TOLERANCE:
            converged = True
            break
    return LikelihoodEstimate(p, information, float(best), converged, iteration)


def compile_likelihood(model: Model) -> CompiledLikelihood:
    """Compile the likelihood of a model and its derivatives."""

    def score(timeline: Timeline, p: Any) -> Any:
        def errors(p: Any) -> Any:
            e, s, _ = filter_innovations(model, timeline, p)
            return e.ravel(), s.ravel()

        def along(d: Any) -> Any:
            return jax.jvp(errors, (p,), (d,))

        (e, s), (de, ds) = jax.vmap(along, out_axes=((None, None), (0, 0)))(jnp.eye(len(p)))
        seen = jnp.asarray(timeline.seen).ravel()
        total = -0.5 * jnp.sum(jnp.where(seen, e * e / s + jnp.log(2 * jnp.pi * s), 0.0))
        g = -de @ (e / s) + ds @ jnp.where(seen, (e * e / s - 1) / (2 * s), 0.0)
        a, b = de / jnp.sqrt(s), ds / (jnp.sqrt(2.0) * s)
        return total, g, a @ a.T + b @ b.T

    def slopes(timeline: Timeline, p: Any, along: Any) -> Any:
        at = functools.partial(log_likelihood, model, timeline)
        return jax.vmap(lambda p: jax.vmap(lambda d: jax.jvp(at, (p,), (d,)), out_axes=(None, 0))(along))(p)

    of = functools.partial
    return CompiledLikelihood(
        jax.jit(score), jax.jit(of(log_likelihood, model)), jax.jit(slopes), jax.jit(of(filter_innovations, model))
    )


def profile_intervals(
    likelihood: CompiledLikelihood, timeline: Timeline, estimate: LikelihoodEstimate, of: Any, free: Any
) -> Any:
    """Return 95 % intervals (len(of), 2) of the parameters `of`, by the profile likelihood.

    Several values of a parameter are tried. For each, the other parameters are optimised again: first with the
    information matrix of the estimate, then by scoring steps with the gradient at the new values. An end of an interval
    is infinite if the likelihood has not fallen enough at the last value tried, and hardly falls further there.

    Args:
        of: indices of the parameters.
        free: (m,) bool, True for parameters that are optimised again; False for noise parameters.
    """
    index, p = np.flatnonzero(free), np.asarray(estimate.p)
    I = estimate.information[np.ix_(index, index)]
    points, followers = [], []
    for i in of:
        k = int(np.flatnonzero(index == i)[0])
        others = [j for j in range(len(index)) if j != k]
        inverse = np.zeros((len(p), len(p)))
        solved = np.zeros((len(others), len(others)))
        for k_other, row in enumerate(np.eye(len(others))):
            solved[k_other] = _damped_solve(I[np.ix_(others, others)], row, 1e-9)
        inverse[np.ix_(index[others], index[others])] = solved
        follow = -solved @ I[others, k]
        half = np.sqrt(2 * HALF_CHI / max(I[k, k] + float(I[k, others] @ follow), 1e-300))
        for reach in REACHES * half:
            new = p.copy()
            new[i] += reach
            new[index[others]] += follow * reach
            points.append(new)
            followers.append(inverse)
    place, inverses = np.array(points), np.array(followers)
    along = np.eye(len(p))[index]
    best, best_place = np.full(len(place), -np.inf), place.copy()
    for _ in range(CORRECTIONS + 1):
        value, g = (np.asarray(v) for v in likelihood.slopes(timeline, place, along))
        g = g @ along
        better = np.isfinite(value) & (value > best)
        best, best_place = np.where(better, value, best), np.where(better[:, None], place, best_place)
        step = np.einsum("nij,nj->ni", inverses, np.where(better[:, None], g, 0.0))
        place = np.where(better[:, None], place + step, (place + best_place) / 2)
    fall = (estimate.log_likelihood - best).reshape(len(of), -1)
    moved = best_place.reshape(len(of), len(REACHES), -1)
    ends = np.empty((len(of), 2))
    for row, i in enumerate(of):
        reach = moved[row, :, i] - p[i]
        ends[row] = p[i] + _end_of_interval(reach, fall[row], -1), p[i] + _end_of_interval(reach, fall[row], 1)
    return ends


def compare_flights(likelihood: CompiledLikelihood, timeline: Timeline, p: Any, kept: Any) -> list[float]:
    """Return for each flight the p-value of the test that its parameters are those of all flights.

    The gradient of the flight's log likelihood is compared with its covariance, the information matrix (score test).
    The other unknowns, e.g. the variances of the noise, may differ from flight to flight.

    Args:
        likelihood: compiled likelihood of the model.  timeline: the flights.
        p: estimate from all flights (m,).
        kept: (m,) bool, True for the parameters that must be equal.
    """
    chances = [1.0]
    for flight in range(int(timeline.owner[-1]) + 1) if timeline.owner[-1] and kept.any() else ():
        only = timeline._replace(seen=timeline.seen & (timeline.owner == flight)[:, None])
        _, g, information = (np.asarray(v) for v in likelihood.score(only, p))
        A, B, C = (information[np.ix_(a, b)] for a, b in ((kept, kept), (kept, ~kept), (~kept, ~kept)))
        gain = B @ np.linalg.pinv(C, hermitian=True)
        g, A = g[kept] - gain @ g[~kept], A - gain @ B.T
        chances.append(float(chdtrc(len(g), max(g @ np.linalg.pinv(A, hermitian=True) @ g, 0.0))))
    return chances[1:] or chances


def name_collinear(information: Any, names: list[str]) -> list[tuple[str, ...]]:
    """Return groups of parameters that the data cannot distinguish. A single one has no effect on the data."""
    size = np.sqrt(np.diagonal(information))
    silent = size <= 1e-9 * max(float(size.max()), 1e-300)
    groups = [(names[i],) for i in np.flatnonzero(silent)]
    rest = np.flatnonzero(~silent)
    if len(rest) > 1:
        C = information[np.ix_(rest, rest)] / np.outer(size[rest], size[rest])
        values, vectors = np.linalg.eigh(C)
        for value, vector in zip(values, vectors.T, strict=True):
            if value < COLLINEAR:
                groups.append(tuple(names[rest[i]] for i in np.flatnonzero(np.abs(vector) > SHARE)))
    return groups


def _damped_solve(A: Any, b: Any, damping: float) -> Any:
    """Solve (A + damping diag(A)) x = b. x is set to zero in directions that A does not determine."""
    size = np.sqrt(np.maximum(np.diagonal(A), 1e-300))
    C = A / np.outer(size, size)
    values, vectors = np.linalg.eigh((C + C.T) / 2)
    inverse = np.where(values > 1e-10, 1 / (np.maximum(values, 1e-10) + damping), 0.0)
    return vectors @ (inverse * (vectors.T @ (b / size))) / size


def _end_of_interval(reach: Any, fall: Any, sign: int) -> float:
    """Return one end of an interval, by interpolation: the point where the log likelihood has fallen by HALF_CHI."""
    side = np.sign(reach) == sign
    x, y = np.abs(reach[side]), np.sqrt(np.maximum(fall[side], 0.0))
    order = np.argsort(x)
    x, y = np.concatenate([[0.0], x[order]]), np.concatenate([[0.0], y[order]])
    wanted = np.sqrt(HALF_CHI)
    beyond = np.flatnonzero((y >= wanted) | ~np.isfinite(y))
    if not len(beyond):  # extrapolate from the last two points if the curve still rises there
        slope = (y[-1] - y[-2]) / (x[-1] - x[-2])
        return sign * float(x[-1] + (wanted - y[-1]) / slope) if slope > 0.2 * wanted / x[-1] else sign * np.inf
    k = int(beyond[0])
    top = y[k] if np.isfinite(y[k]) else 10 * wanted
    return sign * float(x[k - 1] + (x[k] - x[k - 1]) * (wanted - y[k - 1]) / (top - y[k - 1]))
