"""Prediction and update of the Kalman filter on small matrices, as pure, unrolled functions without LAPACK.

The caller computes the innovation y = z - h(x), so that the same update serves a linear filter, an extended filter
and an error-state filter. A measurement that is not finite or lies outside the gate is not used, and leaves state and
covariance unchanged bit for bit.

Source: [4] Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", Wiley 2001,
sections 5.2 (update in Joseph's form) and 5.4 (consistency). [5] Schmidt, "Application of state-space methods to
navigation problems", Advances in control systems 3 (1966): consider states.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.linalg import cholesky, solve_lower, solve_spd, symmetric
from trimtab.core.record import Scalar, quantity, record

NO_GATE = float("inf")
"""NIS gate that accepts every finite measurement."""


class Update(NamedTuple):
    """Result of a Kalman filter's update.

    x: state (n,).  P: covariance (n, n).  innovation: (m,), 0 where the measurement was not finite.
    S: covariance of the innovation (m, m).  nis: y' S^-1 y, chi-square with m degrees of freedom if the filter is
    consistent.  accepted: True if the measurement was used.  finite: True if the measurement was finite.
    """

    x: Any
    P: Any
    innovation: Any
    S: Any
    nis: Any
    accepted: Any
    finite: Any


@record
class CovarianceHealth:
    """Results of the checks of a covariance matrix. Source: docs page, Kalman filter."""

    positive: Scalar = quantity("1", "True if the covariance is finite and positive definite.", kind="flag")
    asymmetry: Scalar = quantity("1", "Largest asymmetry of the covariance P, relative to its largest variance.")
    least_pivot: Scalar = quantity(
        "1",
        "Smallest fraction, over all states, of a state's variance that remains if all states with lower "
        "indices are known.",
    )
    eigenvalue_bound: Scalar = quantity(
        "1", "Lower bound of the correlation matrix's eigenvalues; 0 if the covariance is invalid."
    )
    trace: Scalar = quantity("1", "Sum of the variances of all states, each in its state's unit squared.")


def predict(x: Any, P: Any, F: Any, Q: Any) -> tuple[Any, Any]:
    """Return the state F x (n,) and covariance F P F' + Q (n, n), made symmetric. Source: [4] section 5.2."""
    return F @ x, predict_covariance(P, F, Q)


def predict_covariance(P: Any, F: Any, Q: Any) -> Any:
    """Return the covariance F P F' + Q (n, n), made symmetric, for filters whose state is propagated separately."""
    return symmetric(F @ P @ F.T + Q)


def update(x: Any, P: Any, y: Any, H: Any, R: Any, *, gate: Any = NO_GATE, consider: Any = None) -> Update:
    """Return the update in Joseph's form: x + K y and (I - K H) P (I - K H)' + K R K', K = P H' S^-1, S = H P H' + R.

    Args:
        x: state (n,).
        P: covariance of the state (n, n).
        y: innovation z - h(x), (m,); for an error-state filter, the measured error minus H x.
        H: derivative of h (m, n).
        R: covariance of the measurement's noise (m, m).
        gate: largest NIS that is accepted, e.g. the 0.9999 quantile of chi-square with m degrees of freedom.
        consider: mask of the states (n,): 0 for a consider state ([5]), 1 for any other. A consider state keeps its
            estimate, but its uncertainty is taken into account. Its row of the gain is zero. Due to Joseph's form, P is
            the true covariance of this suboptimal filter.

    Source: [4] eq. 5.2.3-18; [5].
    """
    finite = jnp.all(jnp.isfinite(y))
    y = jnp.where(jnp.isfinite(y), y, 0.0)
    PHt = P @ H.T
    S = symmetric(H @ PHt + R)
    both = solve_spd(S, jnp.concatenate([PHt.T, y[:, None]], axis=1))
    K = both[:, :-1].T
    nis = y @ both[:, -1]
    if consider is not None:
        K = K * consider[:, None]
    A = jnp.eye(x.shape[0]) - K @ H
    accepted = finite & (nis <= gate)  # False if nis is NaN
    new_x = jnp.where(accepted, x + K @ y, x)
    new_P = jnp.where(accepted, symmetric(A @ P @ A.T + K @ R @ K.T), P)
    return Update(new_x, new_P, y, S, nis, accepted, finite)


def inflate_covariance(P: Any, y: Any, H: Any, R: Any) -> Any:
    """Return P (n, n), multiplied by NIS/m if this is above 1, so that the innovation y becomes plausible.

    This is for a filter whose measurements agree with each other but not with the estimate.
    """
    y = jnp.where(jnp.isfinite(y), y, 0.0)
    nis = y @ solve_spd(symmetric(H @ P @ H.T + R), y)
    return P * jnp.maximum(jnp.where(jnp.isfinite(nis), nis, 1.0) / y.shape[0], 1.0)


def update_sequentially(x: Any, P: Any, y: Any, H: Any, variances: Any, *, gate: Any = NO_GATE) -> Update:
    """Return the update for measurements with independent noise of given variances (m,), one scalar at a time.

    No matrix is factored. The gate applies to each scalar separately, so that an outlier does not affect the other
    measurements. nis is the sum over all finite scalars; if no scalar is rejected, this sum equals the nis of `update`.
    S is diagonal: the variance of each innovation after the updates with all scalars before it. accepted and finite
    have shape (m,).

    Source: [4] section 5.2, applied to one component after another.
    """
    start, corrections = x, []
    for i in range(y.shape[0]):
        one = update(x, P, (y[i] - H[i] @ (x - start))[None], H[i][None], variances[i][None, None], gate=gate)
        x, P = one.x, one.P
        corrections.append(one)
    nis = sum(jnp.where(one.finite, one.nis, 0.0) for one in corrections)
    S = jnp.diag(jnp.stack([one.S[0, 0] for one in corrections]))
    accepted = jnp.stack([one.accepted for one in corrections])
    finite = jnp.stack([one.finite for one in corrections])
    return Update(x, P, jnp.concatenate([one.innovation for one in corrections]), S, nis, accepted, finite)


def nees(error: Any, P: Any) -> Any:
    """Return NEES = e' P^-1 e, chi-square with n degrees of freedom if P is the covariance of e. NaN for invalid P."""
    half = solve_lower(cholesky(P), error)
    return half @ half


def covariance_health(P: Any) -> CovarianceHealth:
    """Return the checks of a covariance (n, n).

    The product of all d_j/P_jj, with the pivots d_j of P = L diag(d) L', is the determinant of the correlation matrix.
    The trace of the correlation matrix is n. The smallest eigenvalue of the correlation matrix is therefore at least
    determinant ((n-1)/n)^(n-1), by the inequality of the arithmetic and geometric means.
    """
    n = P.shape[0]
    variances = jnp.stack([P[j, j] for j in range(n)])
    i, k = np.triu_indices(n)
    flat = P.reshape(-1)
    upper, lower = flat[i * n + k], flat[k * n + i]
    apart = jnp.max(jnp.abs(upper - lower))  # not finite if an entry of P is not finite
    shares = _pivots((upper + lower) / 2, n) / variances
    positive = jnp.isfinite(apart) & jnp.all(shares > 0) & jnp.all(variances > 0)
    determinant = jnp.prod(shares)
    largest = jnp.max(jnp.abs(variances))
    return CovarianceHealth(
        positive=positive,
        asymmetry=jnp.where(positive, apart / jnp.where(largest > 0, largest, 1.0), 1.0),
        least_pivot=jnp.where(positive, jnp.min(shares), 0.0),
        eigenvalue_bound=jnp.where(positive, determinant * ((n - 1) / n) ** (n - 1), 0.0),
        trace=jnp.sum(jnp.where(jnp.isfinite(variances), variances, 0.0)),
    )


def _pivots(upper: Any, n: int) -> Any:
    """Return the pivots d (n,) of P = L diag(d) L' from the upper triangle of P (n (n + 1)/2,), row by row.

    d_j is the remaining variance of state j if all states before it are known. Source: Golub & Van Loan, "Matrix
    computations", section 4.1.
    """
    pivots = []
    for m in range(n, 0, -1):
        row, upper, d = upper[:m], upper[m:], upper[0]
        pivots.append(d)
        i, k = np.triu_indices(m - 1)
        upper = upper - row[1:][i] * (row / d)[1:][k]
    return jnp.stack(pivots)
