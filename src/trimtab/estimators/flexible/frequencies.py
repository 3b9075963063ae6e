"""What the adaptive filter of the bending modes remembers and tells.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from typing import Any

import numpy as np

from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.estimators.flexible.model import (
    FlexibleFlight,
    ModalFrequencies,
    RigidFlight,
    Unmeasured,
    flexible_flight,
)
from trimtab.vehicles.hypersonic import HypersonicInput

CORNERS = np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
M = len(CORNERS)
"""Hypotheses: each mode lower, as told, higher."""


@record
class AdaptiveModeState:
    """What the filter remembers. Source: docs page, Adaptive flexible modes."""

    x: Any = quantity("1", "Of each hypothesis s1, s1', s2, s2', ln w1/w1_0, ln w2/w2_0.", shape=(M, 6))
    P: Any = quantity("1", "Their covariances.", shape=(M, 6, 6))
    p: Any = quantity("1", "Their probabilities.", shape=(M,))
    Qd: Any = quantity("1", "Covariance of the noise of one period (4, 4), nominal frequencies.", shape=(4, 4))
    mean: Any = quantity("1", "eta1, eta1', eta2, eta2' and ln w1/w1_0, ln w2/w2_0 of all together.", shape=(6,))
    spread: Any = quantity("1", "Its covariance.", shape=(6, 6))
    w: Any = quantity("rad/s", "Frequencies of all together.", shape=(2,))
    bare: Unmeasured = part("The modes by the model alone.")
    chi: RigidFlight = part("Rigid flight at the last instant.")
    u: HypersonicInput = part("Input that acted last.")
    t: Scalar = quantity("100 ns", "The last instant.", kind="time")
    seen: Scalar = quantity("100 ns", "When the last acceleration used was measured.", kind="time")
    flight_t: Scalar = quantity("100 ns", "When chi was measured.", kind="time")
    started: Scalar = quantity("1", "Whether flight and input have been known once.", kind="flag")
    innovation: Scalar = quantity("rad/s^2", "Of the last instant.")
    S: Scalar = quantity("rad^2/s^4", "Its variance.")
    nis: Scalar = quantity("1", "Innovation squared over S.")
    updated: Scalar = quantity("1", "Whether a measurement was used then.", kind="flag")
    learned: Scalar = quantity("1", "Whether it told something about the frequencies.", kind="flag")
    bounded: Scalar = quantity("1", "Whether a frequency was held at its bound then.", kind="flag")


def adapted(state: AdaptiveModeState) -> FlexibleFlight:
    """The flight as the filter's state tells it: the mean of the hypotheses, with what they differ by in the sigmas."""
    sigma = jnp.sqrt(jnp.maximum(jnp.stack([state.spread[i, i] for i in range(6)]), 0.0))
    frequencies = ModalFrequencies(
        w1=state.w[0],
        w2=state.w[1],
        w1_sigma=state.w[0] * sigma[4],
        w2_sigma=state.w[1] * sigma[5],
        learned=state.learned,
        bounded=state.bounded,
    )
    return replace(flexible_flight(state, state.mean[:4], sigma[:4] ** 2), frequencies=frequencies)
