"""Two models of the dynamic response of the hovercraft's gyros, for the field `response` of `GyroErrors`.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, period, quantity, record
from trimtab.core.second_order import Section, SectionState, filter_sample, steady_state
from trimtab.core.time import ms, to_seconds

TICK = ms("6.5536")
"""Time between samples of the hovercraft's inertial unit."""


@record
class IdentifiedGyro:
    """Gyro model identified in [1]: a difference equation with a sampling period of 6.5536 ms.

        y_k = b0 u_k - a1 y_{k-1} - a2 y_{k-2}        y/u = 0.3236 z²/(z² - 0.9805 z + 0.2898)     [1, eq. 6.2]

    u is the true rate and y the output of the gyro. The poles are 0.490 ± 0.222 i. The static gain is 1.046.
    `normalised` scales b0 to a static gain of 1.

    Valid:   below 20 Hz, sampled each 6.5536 ms.    Source: [1] eq. 6.2.
    """

    b0: Scalar = quantity(
        "1", "Coefficient b0 of the newest angular rate.", default=0.3236, above=0, source="[1] eq. 6.2"
    )
    a1: Scalar = quantity("1", "Coefficient a1 of the previous output.", default=-0.9805, source="[1] eq. 6.2")
    a2: Scalar = quantity("1", "Coefficient a2 of the output two samples ago.", default=0.2898, source="[1] eq. 6.2")
    normalised: bool = option("True: scale b0 so that the static gain is 1.", default=True, choices=(True, False))

    def section(self) -> Section:
        """Return the difference equation as a filter section."""
        return Section(b0=1 + self.a1 + self.a2 if self.normalised else self.b0, a1=self.a1, a2=self.a2)

    def start(self, u: Any) -> SectionState:
        """Return the steady filter state for a constant rate u."""
        return steady_state(self.section(), u)

    def respond(self, state: SectionState, u: Any) -> tuple[SectionState, Any]:
        """Return the next filter state, and the output for the newest rate u."""
        return filter_sample(self.section(), state, u)


@record
class DelayedGyroState:
    """State of the gyro model: true rates and outputs of the previous samples, newest first. Source: this module."""

    u: Any = quantity("rad/s", "True angular rates of the previous k samples (k, …), newest first.")
    y: Any = quantity("rad/s", "Outputs of the gyro model at the previous two samples (2, …), newest first.")


@record
class DelayedGyro:
    """Gyro model that explains the gains and phases measured in [1]: a delay of whole samples and a low-pass.

        Y/U = e^{-s D T} / (1 + √2 s/w + (s/w)²)

    D is the delay in samples of the period T, and w the bandwidth (rad/s). The model runs as a difference equation. Up
    to 50 Hz, the gain (and the phase in rad) of this equation is within 0.006 of the formula.

    Reconstructed: the gain is within 0.05 of [1, table 6.5] at all frequencies of this table. The phase agrees at 5 and
    15 Hz, but lags too much above 15 Hz (by 0.3 rad at 20 Hz). Use the model below 20 Hz only.

    Source:  [1] table 6.5 (fit reconstructed, see docs Errata).
    """

    samples: int = option("Delay D, in samples; at least 2.", default=2)
    bandwidth: float = option("Bandwidth (-3 dB) of the second-order Butterworth (Hz).", default=30.0)
    sampling: int = period("Time T between samples.", default=TICK)

    def coefficients(self) -> tuple[Any, Any]:
        """Return the weights of the rates, newest first (D + 3,), and of the previous outputs (2,)."""
        return _fit_weights(self.samples, self.bandwidth, to_seconds(self.sampling))

    def start(self, u: Any) -> DelayedGyroState:
        """Return the steady state for a constant rate u."""
        u = jnp.asarray(u)
        return DelayedGyroState(u=jnp.stack([u] * (self.samples + 2)), y=jnp.stack([u, u]))

    def respond(self, state: DelayedGyroState, u: Any) -> tuple[DelayedGyroState, Any]:
        """Return the next state, and the output for the newest rate u."""
        b, a = self.coefficients()
        rates = jnp.concatenate([jnp.asarray(u)[None], state.u])
        y = sum((b[k] * rates[k] for k in range(1, len(b))), b[0] * rates[0]) - a[0] * state.y[0] - a[1] * state.y[1]
        return DelayedGyroState(u=rates[:-1], y=jnp.stack([y, state.y[0]])), y


@functools.lru_cache(maxsize=16)
def _fit_weights(samples: int, bandwidth: float, T: float) -> tuple[Any, Any]:
    """Return the weights of the rates and of the previous outputs in the difference equation.

    The poles are mapped by z = e^{sT}. The weights of the rates are a least-squares fit.
    """
    pole = math.tau * bandwidth * complex(-math.sqrt(0.5), math.sqrt(0.5))
    z = np.exp(pole * T)
    a = np.array([-2 * z.real, abs(z) ** 2])
    f = np.linspace(0, 0.4 / T, 300)
    z1, s = np.exp(-2j * np.pi * f * T), 1j * f / bandwidth
    below = 1 + a[0] * z1 + a[1] * z1**2
    columns: Any = np.stack([z1**k / below for k in range(samples + 3)], 1)
    response: Any = z1**samples / (s * s + math.sqrt(2) * s + 1)
    A, y = (np.concatenate([c.real, c.imag]) for c in (columns, response))
    b = np.linalg.lstsq(A, y, None)[0]
    return b * (1 + a.sum()) / b.sum(), a


def frequency_response(b: Any, a: Any, frequency: Any, sampling_period: float) -> Any:
    """Return the complex gain of y_k = b0 u_k + b1 u_{k-1} + … - a1 y_{k-1} - … at frequencies (Hz)."""
    z1 = np.exp(-2j * np.pi * np.asarray(frequency) * sampling_period)
    above = sum(c * z1**k for k, c in enumerate(b))
    return above / (1 + sum(c * z1 ** (k + 1) for k, c in enumerate(a)))
