"""Lateral regulator of the F-16: output-feedback gains that minimise a quadratic cost.

The states are sideslip, roll, roll rate and yaw rate, two actuators and a washout of the yaw rate. The washed-out yaw
rate, roll rate, sideslip and roll are fed back, in degrees. The cost is an average over all initial states. Weights and
printed gains are from public transcriptions of [1]. Some of these have -0.11 for the aileron's sideslip gain; 0.11 has
the lower cost.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize

from studies.stevens_lewis.linear import A_ASIDE, ASIDE, linear_model
from trimtab.core.rotation import DEG
from trimtab.study import Row, at_most, within

SECTION = "example 5.3-1"
ACTUATOR, WASHOUT = 20.2, 1.0
"""Poles (1/s) of both actuators and of the washout."""
Q = np.diag([50.0, 100.0, 100.0, 50.0, 0.0, 0.0, 1.0])
R = 0.1 * np.eye(2)
"""Weight of both surface commands (deg)."""
SURFACES = ("aileron", "rudder")
MEASURED = ("washed_yaw_rate", "roll_rate", "beta", "roll")
PRINTED = np.array([[-0.56, -0.44, 0.11, -0.35], [-1.19, -0.21, -0.44, 0.26]])
COST_EXCESS_MAX = 1e-4
"""Relative excess of the cost at which a search may stop: that of the printed gains, to its first figure."""


class LateralLoop(NamedTuple):
    """Linear loop x' = A x + B u, y = C x, u = -K y.  A: (7, 7).  B: (7, 2).  C: (4, 7)."""

    A: Any
    B: Any
    C: Any

    def cost(self, K: Any) -> tuple[float, Any]:
        """Return half the trace of P, with A'P + P A + Q + C'K'R K C = 0 in closed loop, and its gradient in K."""
        closed = self.A - self.B @ K @ self.C
        if np.linalg.eigvals(closed).real.max() >= 0:
            return np.inf, np.zeros_like(K)
        P = solve_continuous_lyapunov(closed.T, -(Q + self.C.T @ K.T @ R @ K @ self.C))
        S = solve_continuous_lyapunov(closed, -np.eye(len(closed)))
        return 0.5 * np.trace(P), (R @ K @ self.C - self.B.T @ P) @ S @ self.C.T


@cache
def lateral_loop() -> LateralLoop:
    """Return the F-16's linear model with actuators and washout, and with the misprint of [1] used in the design."""
    own = linear_model().part(ASIDE, SURFACES, [])
    A, B, C = np.zeros((7, 7)), np.zeros((7, 2)), np.zeros((4, 7))
    A[:4, :4], A[:4, 4:6] = own.A, own.B
    A[1, 3] = A_ASIDE[1, 3]
    A[4, 4] = A[5, 5] = -ACTUATOR
    A[6, 3], A[6, 6] = WASHOUT / DEG, -WASHOUT
    B[4, 0] = B[5, 1] = ACTUATOR
    C[0, 3], C[0, 6], C[1, 2], C[2, 0], C[3, 1] = 1 / DEG, -1.0, 1 / DEG, 1 / DEG, 1 / DEG
    return LateralLoop(A, B, C)


def find_gains(loop: LateralLoop) -> tuple[Any, Any]:
    """Return the gains (2, 4) of least cost, found from the printed gains, and their tolerances at COST_EXCESS_MAX."""

    def flat_cost(k: Any) -> tuple[float, Any]:
        value, slope = loop.cost(k.reshape(PRINTED.shape))
        return value, slope.ravel()

    least = minimize(flat_cost, PRINTED.ravel(), jac=True, method="BFGS", options={"gtol": 1e-5})
    step = 1e-5
    bends = [(flat_cost(least.x + e)[1] - flat_cost(least.x - e)[1]) / (2 * step) for e in step * np.eye(PRINTED.size)]
    open_by = np.sqrt(2 * COST_EXCESS_MAX * least.fun * np.diag(np.linalg.inv(np.array(bends))))
    return least.x.reshape(PRINTED.shape), open_by.reshape(PRINTED.shape)


def rows() -> Iterator[Row]:
    """Yield each gain, and the excess cost of the printed gains."""
    loop = lateral_loop()
    gains, open_by = find_gains(loop)
    for i, j in np.ndindex(PRINTED.shape):
        name = MEASURED[j].replace("_", " ")
        what = f"{SURFACES[i]} per {name}"
        yield within(
            f"{SURFACES[i]}/{MEASURED[j]}",
            what,
            float(PRINTED[i, j]),
            gains[i, j],
            "[1] example 5.3-1",
            tolerance=0.005 + float(open_by[i, j]),
            unit="s" if "rate" in name else "1",
        )
    more = loop.cost(PRINTED)[0] / loop.cost(gains)[0] - 1
    what = "relative excess cost of the printed gains over the computed gains"
    yield at_most("cost", what, 0.0, more, "[1] example 5.3-1", high=COST_EXCESS_MAX, unit="1", basis="reference")
