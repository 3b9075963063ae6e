"""Closed loop of the hypersonic vehicle as one matrix: stationary response to noise, and slowest decay.

The matrix describes one control period at level flight. It follows from automatic differentiation of the simulated
filter, law and plant, with the filter's gain at its steady value. Accelerometer noise enters like the innovation.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from trimtab.core.record import replace
from trimtab.core.time import to_seconds
from trimtab.estimators.flexible.discrete import EQUAL_Q, FlexibleModeFilter
from trimtab.laws.stable_inversion import K_FLOWN
from trimtab.scenarios.hypersonic._design import H, V
from trimtab.scenarios.hypersonic._flight import TICK
from trimtab.scenarios.hypersonic._internal import level_trim
from trimtab.scenarios.hypersonic._loop import sampled_loop
from trimtab.vehicles.hypersonic import Hypersonic

NOISE = 0.01
"""Standard deviation of the accelerometer's noise (rad/s^2 per sample)."""
DETUNED = tuple((a, b) for a in (0.9, 1.0, 1.1) for b in (0.9, 1.0, 1.1) if (a, b) != (1.0, 1.0))
"""Factors of both modal frequencies, 10 % off: in the same direction, in opposite directions, and one alone."""


class Quality(NamedTuple):
    """Performance of one setting.

    elevator: rms of the elevator from noise (rad).  h, V: rms of the errors from noise (ft, ft/s).
    growth: growth rate of the slowest motion with an exact model (1/s).  worst: largest growth
    rate over DETUNED.  at: frequency factors of this case.
    """

    elevator: float
    h: float
    V: float
    growth: float
    worst: float
    at: tuple[float, float]


def loop_quality(Q: Any = EQUAL_Q, R: float = 1e-4, K: Any = K_FLOWN) -> Quality:
    """Return the performance with the filter's Q (4,) and R, and the gain K (2, 9)."""
    F, N = loop_matrices(Q, R, K)
    sigma = np.sqrt(np.diag(solve_discrete_lyapunov(F, NOISE**2 * np.outer(N, N))))
    found = {at: growth_rate(Q, R, K, at) for at in DETUNED}
    worst = max(found, key=lambda at: found[at])
    return Quality(sigma[19], sigma[0], sigma[1], growth_rate(Q, R, K), found[worst], worst)


def growth_rate(Q: Any, R: float, K: Any = K_FLOWN, detuned: tuple[float, float] = (1.0, 1.0)) -> float:
    """Return the growth rate (1/s), unstable above 0, with the plant's modal frequencies times `detuned`."""
    F, _ = loop_matrices(Q, R, K, detuned)
    return float(np.log(np.abs(np.linalg.eigvals(F)).max()) / to_seconds(TICK))


def widest_error(Q: Any, R: float, K: Any = K_FLOWN, most: float = 0.4) -> float:
    """Return the largest relative error of the frequencies at which the loop is stable in all eight directions."""
    low, high = 0.0, most
    while high - low > 1e-3:
        x = (low + high) / 2
        stable = all(growth_rate(Q, R, K, (1 + 10 * x * (a - 1), 1 + 10 * x * (b - 1))) < 0 for a, b in DETUNED)
        low, high = (x, high) if stable else (low, x)
    return low


def loop_matrices(Q: Any, R: float, K: Any, detuned: tuple[float, float] = (1.0, 1.0)) -> tuple[Any, Any]:
    """Return F (20, 20) and N (20,) of z = F z + N w over one period. w: the accelerometer's noise."""
    assumed = Hypersonic()
    modes = assumed.modes
    plant = replace(assumed, modes=replace(modes, w1=modes.w1 * detuned[0], w2=modes.w2 * detuned[1]))
    kept = FlexibleModeFilter(craft=assumed, Q=tuple(map(float, Q)), R=float(R), period=TICK)
    return sampled_loop(plant, kept, K, level_trim(assumed, H, V))
