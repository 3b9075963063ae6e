"""Lags: an actuator that follows its command as a filter of first or second order does, within its speed and its stops.

Stages of an ActuatorBank. Source: [1] Stevens, Lewis, Johnson, "Aircraft control and simulation", 3rd ed., 3.5 and 4.4
for lags with limits; the solutions in closed form are those of linear equations.
"""

from typing import Any

import jax
import jax.numpy as jnp

from trimtab.core.errors import InputError
from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.time import format_time, to_seconds

NO_LIMIT = 1e12
"""A limit that nothing reaches."""
FASTEST = 0.5
"""Of frequency times period (rad): a step in which a limit of the speed isn't left and met again."""
NEWTON_STEPS, TINY = 4, 1e-300


@record
class FirstOrderLag:
    """Follows its command by a first-order lag, no faster than a rate, between two stops.

        x' = (command - x)/time_constant    |x'| <= rate_limit    low <= x <= high

    Solved in closed form over each period: first at the limit of the rate, then exponentially. With a time constant of
    zero it is a rate limiter.

    Frames:  its field's.    Not modelled: a load that drives the actuator.
    Source:  [1], the lag of an F-16's surfaces with both limits: 20.2 1/s, 60°/s, ±25° of the elevator.
    """

    time_constant: Scalar = quantity("s", "Of the lag; 0: none.", default=0.05, low=0, off={"actuator-lag": 0.0})
    rate_limit: Scalar = quantity(
        "1", "Top speed, in the field's unit a second.", default=NO_LIMIT, above=0, off={"rate-limit": NO_LIMIT}
    )
    low: Scalar = quantity("1", "Stop, in the field's unit.", default=-NO_LIMIT, off={"saturation": -NO_LIMIT})
    high: Scalar = quantity("1", "The other stop.", default=NO_LIMIT, off={"saturation": NO_LIMIT})

    def check(self) -> None:
        """Refuse stops that leave no way between them."""
        _check_stops(self.low, self.high)

    def init(self, rest: Any) -> Any:
        """Where it stands."""
        return jnp.asarray(rest, float)

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """Where it stands dt (s) later, its command held."""
        error = value - state
        size = abs(error)
        sliding = jnp.clip(size / self.rate_limit - self.time_constant, 0.0, dt)
        rest = size - self.rate_limit * sliding
        left = rest * jnp.exp(-(dt - sliding) / jnp.maximum(self.time_constant, TINY))
        free = value - jnp.where(error < 0, -left, left)
        x = jnp.clip(free, self.low, self.high)
        slides = (sliding > 1e-6 * dt) & (rest > 1e-9 * size)  # beyond rounding
        return x, StageOutput(value=x, limited=jnp.any(slides | (x != free)))


@record
class SecondOrderLagState:
    """Where the actuator stands and how fast it goes. Frames: the field's. Source: this module."""

    x: Any = quantity("1", "Position, in the field's unit.")
    rate: Any = quantity("1", "Its derivative.")


@record
class SecondOrderLag:
    """Follows its command as a damped spring does, no faster than a rate, between two stops.

        x'' = frequency^2 (command - x) - 2 damping frequency x'    |x'| <= rate_limit    low <= x <= high

    Solved in closed form over each period, with the instants at which it meets and leaves the limit of its rate; at a
    stop it stands still. A limit that is met and left again within one period counts at its end.

    Frames:  its field's.    Not modelled: a load that drives the actuator, bouncing at a stop.
    Source:  [1]; the second-order actuator of block diagrams.
    """

    frequency: Scalar = quantity("rad/s", "Undamped; 0: no lag.", default=60.0, low=0, off={"actuator-lag": 0.0})
    damping: Scalar = quantity("1", "Share of the critical one.", default=0.7, above=0)
    rate_limit: Scalar = quantity(
        "1", "Top speed, in the field's unit a second.", default=NO_LIMIT, above=0, off={"rate-limit": NO_LIMIT}
    )
    low: Scalar = quantity("1", "Stop, in the field's unit.", default=-NO_LIMIT, off={"saturation": -NO_LIMIT})
    high: Scalar = quantity("1", "The other stop.", default=NO_LIMIT, off={"saturation": NO_LIMIT})

    def check(self) -> None:
        """Refuse stops that leave no way between them."""
        _check_stops(self.low, self.high)

    def check_period(self, period: int) -> None:
        """Refuse a period in which it swings."""
        turned = float(self.frequency) * to_seconds(period)
        if turned > FASTEST:
            problem = f"{float(self.frequency):g} rad/s turns by {turned:.2g} rad in a period of {format_time(period)}"
            fix = f"a period of at most {1e3 * FASTEST / float(self.frequency):.2g} ms, or frequency 0: no lag"
            raise InputError("frequency", problem, fix=fix)

    def init(self, rest: Any) -> SecondOrderLagState:
        """Standing still."""
        x = jnp.asarray(rest, float)
        return SecondOrderLagState(x=x, rate=jnp.zeros_like(x))

    def step(self, state: SecondOrderLagState, value: Any, dt: Any) -> tuple[SecondOrderLagState, StageOutput]:
        """Where it stands dt (s) later, its command held."""
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
        """The state dt (s) later between the stops, and whether it went at its top speed meanwhile."""
        top, w, e = self.rate_limit, self.frequency, s.x - value
        later = self._propagate(e, s.rate, dt)[1]
        already = (abs(s.rate) >= top * (1 - 1e-12)) & (self._acceleration(e, s.rate) * s.rate > 0)
        meets = ~already & (abs(later) > top)
        sign = jnp.where(jnp.where(already, s.rate, later) < 0, -1.0, 1.0)
        at = jnp.where(already, 0.0, jnp.where(meets, self._time_of_rate(e, s.rate, sign * top, later, dt), dt))
        e, rate = self._propagate(e, s.rate, at)
        rate = jnp.where(already | meets, sign * top, rate)
        # it leaves the limit where its own acceleration turns against it
        leaves = -sign * 2 * self.damping * top / jnp.maximum(w, TINY)
        slides = jnp.where(already | meets, jnp.clip(sign * (leaves - e) / top, 0.0, dt - at), 0.0)
        e, rate = self._propagate(e + sign * top * slides, rate, dt - at - slides)
        return SecondOrderLagState(x=value + e, rate=rate), already | meets

    def _time_of_rate(self, e: Any, rate: Any, wanted: Any, later: Any, dt: Any) -> Any:
        """When the rate, `rate` at 0 and `later` at dt (s), is `wanted`: by Newton's steps."""

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
        """Error and rate after a time t (s) without limits.

        With a = damping frequency and d = frequency^2 - a^2: exp(-a t) times cos(sqrt(d) t) and sin(sqrt(d) t)/sqrt(d),
        cosh and sinh where d is negative, their series where d t^2 is small.
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
        raise InputError("low", f"{float(low):g} is not below high, {float(high):g}", fix="set low below high")
