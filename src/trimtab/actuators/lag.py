"""Lags: actuators that follow a command like a filter of first or second order, within a rate limit and stops.

Both lags are stages of an ActuatorBank. Source: [1] Stevens, Lewis, Johnson, "Aircraft control and simulation", 3rd
ed., 3.5 and 4.4 for lags with limits. The closed-form solutions are those of linear differential equations.
"""

from typing import Any

import jax
import jax.numpy as jnp

from trimtab.core.errors import InputError
from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.time import format_time, to_seconds

NO_LIMIT = 1e12
"""Value of a rate limit or of a stop that switches the limit off."""
FASTEST = 0.5
"""Largest accepted product of a lag's natural frequency and the period (rad). Up to this product, the rate can leave
its limit only once within a period."""
NEWTON_STEPS, TINY = 4, 1e-300


@record
class FirstOrderLag:
    """First-order lag of an actuator behind its command, with a rate limit and two stops.

        x' = (command - x)/time_constant    |x'| <= rate_limit    low <= x <= high

    x is the position of the actuator. The lag is solved in closed form over each period: first the motion at the rate
    limit, then the exponential. With a time constant of zero it is only a rate limiter.

    Frames:  those of the actuated value.    Not modelled: a load that drives the actuator.
    Source:  [1], the lag of an F-16's surfaces with both limits: 20.2 1/s, 60°/s, ±25° of the elevator.
    """

    time_constant: Scalar = quantity(
        "s", "Time constant of the lag; 0 switches the lag off.", default=0.05, low=0, off={"actuator-lag": 0.0}
    )
    rate_limit: Scalar = quantity(
        "1",
        "Maximum rate, in the unit of the actuated value per second.",
        default=NO_LIMIT,
        above=0,
        off={"rate-limit": NO_LIMIT},
    )
    low: Scalar = quantity(
        "1", "Lower stop, in the unit of the actuated value.", default=-NO_LIMIT, off={"saturation": -NO_LIMIT}
    )
    high: Scalar = quantity(
        "1", "Upper stop, in the unit of the actuated value.", default=NO_LIMIT, off={"saturation": NO_LIMIT}
    )

    def check(self) -> None:
        """Raise InputError unless the lower stop is below the upper stop."""
        _check_stops(self.low, self.high)

    def init(self, rest: Any) -> Any:
        """Return the initial state, with the actuator at the rest value."""
        return jnp.asarray(rest, float)

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """Return the new state and the output, after dt (s) with a constant command."""
        error = value - state
        size = abs(error)
        sliding = jnp.clip(size / self.rate_limit - self.time_constant, 0.0, dt)
        rest = size - self.rate_limit * sliding
        left = rest * jnp.exp(-(dt - sliding) / jnp.maximum(self.time_constant, TINY))
        free = value - jnp.where(error < 0, -left, left)
        x = jnp.clip(free, self.low, self.high)
        slides = (sliding > 1e-6 * dt) & (rest > 1e-9 * size)  # above rounding errors
        return x, StageOutput(value=x, limited=jnp.any(slides | (x != free)))


@record
class SecondOrderLagState:
    """State of a second-order lag: position and rate. Frames: those of the actuated value. Source: this module."""

    x: Any = quantity("1", "Position of the actuator, in the unit of the actuated value.")
    rate: Any = quantity("1", "Rate of the actuator's position.")


@record
class SecondOrderLag:
    """Second-order lag of an actuator behind its command, with a rate limit and two stops.

        x'' = frequency^2 (command - x) - 2 damping frequency x'    |x'| <= rate_limit    low <= x <= high

    x is the position of the actuator. The lag is solved in closed form over each period, including the instants at
    which the rate limit is reached and left. At a stop the rate is zero. If the rate limit is reached and left again
    within one period, only the rate at the end of the period is limited.

    Frames:  those of the actuated value.    Not modelled: a load that drives the actuator, bouncing at a stop.
    Source:  [1]; the common second-order actuator model.
    """

    frequency: Scalar = quantity(
        "rad/s",
        "Undamped natural frequency of the lag; 0 switches the lag off.",
        default=60.0,
        low=0,
        off={"actuator-lag": 0.0},
    )
    damping: Scalar = quantity("1", "Damping ratio of the lag.", default=0.7, above=0)
    rate_limit: Scalar = quantity(
        "1",
        "Maximum rate, in the unit of the actuated value per second.",
        default=NO_LIMIT,
        above=0,
        off={"rate-limit": NO_LIMIT},
    )
    low: Scalar = quantity(
        "1", "Lower stop, in the unit of the actuated value.", default=-NO_LIMIT, off={"saturation": -NO_LIMIT}
    )
    high: Scalar = quantity(
        "1", "Upper stop, in the unit of the actuated value.", default=NO_LIMIT, off={"saturation": NO_LIMIT}
    )

    def check(self) -> None:
        """Raise InputError unless the lower stop is below the upper stop."""
        _check_stops(self.low, self.high)

    def check_period(self, period: int) -> None:
        """Raise InputError for a period that is too long for the frequency."""
        turned = float(self.frequency) * to_seconds(period)
        if turned > FASTEST:
            problem = (
                f"a frequency of {float(self.frequency):g} rad/s is too high for a period of "
                f"{format_time(period)}: their "
                f"product is {turned:.2g} rad"
            )
            fix = (
                f"choose a period of at most {1e3 * FASTEST / float(self.frequency):.2g} ms, or frequency 0 for no lag"
            )
            raise InputError("frequency", problem, fix=fix)

    def init(self, rest: Any) -> SecondOrderLagState:
        """Return the initial state, at rest."""
        x = jnp.asarray(rest, float)
        return SecondOrderLagState(x=x, rate=jnp.zeros_like(x))

    def step(self, state: SecondOrderLagState, value: Any, dt: Any) -> tuple[SecondOrderLagState, StageOutput]:
        """Return the new state and the output, after dt (s) with a constant command."""
        swung, slid = self._swing(state, value, dt)
        slew = self.rate_limit * dt
        jumped = jnp.clip(value, state.x - slew, state.x + slew)
        lags = self.frequency > 0
        free, rate = jnp.where(lags, swung.x, jumped), jnp.where(lags, swung.rate, 0.0)
        x = jnp.clip(free, self.low, self.high)
        hits = ((x <= self.low) & (rate < 0)) | ((x >= self.high) & (rate > 0))
        limited = jnp.any(jnp.where(lags, slid, jumped != value) | (x != free))
        return SecondOrderLagState(x=x, rate=jnp.where(hits, 0.0, rate)), StageOutput(value=x, limited=limited)

    def _swing(self, s: SecondOrderLagState, value: Any, dt: Any) -> tuple[SecondOrderLagState, Any]:
        """Return the state after dt (s), ignoring the stops, and True if the rate limit was active."""
        top, w, e = self.rate_limit, self.frequency, s.x - value
        later = self._propagate(e, s.rate, dt)[1]
        already = (abs(s.rate) >= top * (1 - 1e-12)) & (self._acceleration(e, s.rate) * s.rate > 0)
        meets = ~already & (abs(later) > top)
        sign = jnp.where(jnp.where(already, s.rate, later) < 0, -1.0, 1.0)
        at = jnp.where(already, 0.0, jnp.where(meets, self._time_of_rate(e, s.rate, sign * top, later, dt), dt))
        e, rate = self._propagate(e, s.rate, at)
        rate = jnp.where(already | meets, sign * top, rate)
        # the rate leaves its limit where the unlimited acceleration changes sign
        leaves = -sign * 2 * self.damping * top / jnp.maximum(w, TINY)
        slides = jnp.where(already | meets, jnp.clip(sign * (leaves - e) / top, 0.0, dt - at), 0.0)
        e, rate = self._propagate(e + sign * top * slides, rate, dt - at - slides)
        return SecondOrderLagState(x=value + e, rate=rate), already | meets

    def _time_of_rate(self, e: Any, rate: Any, wanted: Any, later: Any, dt: Any) -> Any:
        """Return the time (s) at which the rate reaches the value `wanted`, found by Newton's method.

        rate: rate at time 0. later: rate at time dt (s).
        """

        def improve(_: Any, at: Any) -> Any:
            e1, rate1 = self._propagate(e, rate, at)
            slope = self._acceleration(e1, rate1)
            return jnp.clip(at + (wanted - rate1) / jnp.where(slope == 0, 1.0, slope), 0.0, dt)

        change = later - rate
        chord = jnp.clip(dt * (wanted - rate) / jnp.where(change == 0, 1.0, change), 0.0, dt)
        return jax.lax.fori_loop(0, NEWTON_STEPS, improve, chord)

    def _acceleration(self, e: Any, rate: Any) -> Any:
        return -self.frequency * (self.frequency * e + 2 * self.damping * rate)

    def _propagate(self, e: Any, rate: Any, t: Any) -> tuple[Any, Any]:
        """Return the position error and the rate of the lag after a time t (s), ignoring its limits.

        With a = damping frequency and d = frequency^2 - a^2, the solution consists of exp(-a t) cos(sqrt(d) t) and
        exp(-a t) sin(sqrt(d) t)/sqrt(d). If d is negative, cosh and sinh replace cos and sin. If d t^2 is small, their
        series are used.
        """
        w = self.frequency
        a, z = self.damping * w, (1 - self.damping**2) * (w * t) ** 2
        small = abs(z) < 1e-3
        angle = jnp.sqrt(jnp.where(small, 1.0, abs(z)))
        decay = jnp.exp(-a * t)
        rising, falling = jnp.exp(jnp.minimum(angle - a * t, 0.0)), jnp.exp(-angle - a * t)
        c = jnp.where(z > 0, decay * jnp.cos(angle), (rising + falling) / 2)
        s = jnp.where(z > 0, decay * jnp.sin(angle), (rising - falling) / 2) / angle
        c = jnp.where(small, decay * (1 - z / 2 * (1 - z / 12 * (1 - z / 30))), c)
        s = t * jnp.where(small, decay * (1 - z / 6 * (1 - z / 20 * (1 - z / 42))), s)
        return e * c + (rate + a * e) * s, rate * c - (w**2 * e + a * rate) * s


def _check_stops(low: Any, high: Any) -> None:
    if not float(low) < float(high):
        raise InputError(
            "low",
            f"the lower stop {float(low):g} must be below the upper stop {float(high):g}",
            fix="set low below high",
        )
