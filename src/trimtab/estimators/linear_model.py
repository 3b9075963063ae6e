"""Kalman filter for the linear model of any vehicle. It estimates all states from the available sensors."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Frame, PlanarState, is_new
from trimtab.core.time import ms, to_seconds
from trimtab.estimators import kalman
from trimtab.estimators.inertial.sensor_watch import NEVER

TURNS = np.zeros((4, 4))
TURNS[3, 2] = 0.005
"""Off-diagonal part of the placeholder transition matrix: per step, the heading changes by 5 ms times the yaw rate."""


@record
class LinearModelFilterState:
    """State of the Kalman filter of a linear model. Source: docs page, Linear model filter."""

    e: Any = quantity("1", "Estimated deviation of each state from the trim (n,), in the state's unit.")
    P: Any = quantity("1", "Covariance of the estimated deviation (n, n).")
    t: Scalar = quantity("100 ns", "Time of the filter's last step.", kind="time")
    seen: Any = quantity("100 ns", "Time at which the last used sample of each sensor was measured.", kind="time")
    measured: Scalar = quantity("100 ns", "Time at which the newest used sample was measured.", kind="time")
    started: Scalar = quantity("1", "True once an input and a measurement have arrived.", kind="flag")


@record
class FilteredEstimate:
    """Estimate of a vehicle's complete state, with the filter's uncertainty.

    Source: docs page, Linear model filter.
    """

    t: Scalar = quantity("100 ns", "Time of the estimate, by the autopilot's clock.", kind="time")
    age: Scalar = quantity("s", "Age of the newest measurement used.")
    fresh: Scalar = quantity("1", "True if a measurement was used in this step.", kind="flag")
    valid: Scalar = quantity("1", "True if the estimated state is usable.", kind="flag")
    state: Any = part("Estimated state, as the vehicle's record of states.")
    P: Any = quantity("1", "Covariance of the state, row by row (n n,), in the order of the vehicle's record.")
    nis: Scalar = quantity("1", "Sum of NIS over this step's measurements: chi-square with `used` degrees of freedom.")
    used: Scalar = quantity("1", "Number of measured values used in this step.", kind="count")
    stick: Any = part("Pilot's stick; always None, because the filter reads no stick.", default=None)
    dt: Any = part("Time between two steps of the law (s); None except in the law's input.", default=None)


@record
class LinearModelFilter:
    """Sampled Kalman filter of x = x0 + e, e' = A e + B (u - u0) + w, designed by `loop.linear_filter.design_filter`.

        e = Ad e + Bd (u - u0)                  P = Ad P Ad' + Qd
        r = y - y0 - C e - D (u - u0)           then one scalar at a time in Joseph's form

    u is the input that has been acting since the last command, as measured by `input_channels`
    (`sensors.flight_state.ActingInput`). Each step uses the new samples that were measured less than one period before.
    Older or non-finite samples are not used.

    Frames:  those of the vehicle's states.
    Valid:   near the trim, for white noise. Not modelled: delay and biases of the sensors.
    Source:  Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", Wiley 2001,
             section 5.2.
    """

    x0: Any = part("State at the trim, as the vehicle's record of states.", default=PlanarState(0.0, 0.0, 0.0, 0.0))
    u0: Any = quantity("1", "Input at the trim (m,).", default=np.zeros(0))
    channels: tuple[str, ...] = option(
        "Sensor channels that the filter uses, each as SENSOR.FIELD, e.g. imu.force[2].",
        default=("navigation.heading",),
    )
    input_channels: tuple[str, ...] = option(
        "Sensor channels that report the inputs of the model, each as SENSOR.FIELD.", default=()
    )
    Ad: Any = quantity("1", "Transition matrix over one period (n, n).", default=np.eye(4) + TURNS)
    Bd: Any = quantity("1", "Input matrix over one period (n, m).", default=np.zeros((4, 0)))
    Qd: Any = quantity("1", "Covariance of the process noise over one period (n, n).", default=1e-4 * np.eye(4))
    C: Any = quantity("1", "Output matrix, from states to measured values (p, n).", default=np.eye(4)[3:])
    D: Any = quantity("1", "Feedthrough matrix, from inputs to measured values (p, m).", default=np.zeros((1, 0)))
    y0: Any = quantity("1", "Measured values at the trim (p,).", default=np.zeros(1))
    R: Any = quantity("1", "Variances of the measurement noise (p,).", default=np.array([1e-4]), above=0)
    P0: Any = quantity("1", "Initial covariance of the state (n, n).", default=np.eye(4))
    period: int = period("Time between predictions.", default=ms(5))

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors of the measured values and of the acting inputs."""
        return tuple(dict.fromkeys((*_sensors(self.channels), *_sensors(self.input_channels))))

    def check(self) -> None:
        """Raise InputError if the shapes of the matrices do not match."""
        n, m, p = len(self.Ad), len(self.input_channels), len(self.channels)
        shapes = {
            "u0": (m,),
            "Ad": (n, n),
            "Bd": (n, m),
            "Qd": (n, n),
            "C": (p, n),
            "D": (p, m),
            "y0": (p,),
            "R": (p,),
            "P0": (n, n),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                problem = f"the array must have shape {shape}, got {np.shape(getattr(self, name))}"
                raise InputError(
                    f"LinearModelFilter.{name}", problem, fix="create the filter with loop.linear_filter.design_filter"
                )

    def init(self, key: Key) -> LinearModelFilterState:
        """Return the filter's initial state, at the trim, before any measurement."""
        never = np.int64(NEVER)
        seen = np.full(len(_sensors(self.channels)), never)
        P = jnp.asarray(self.P0)
        return LinearModelFilterState(jnp.zeros(len(self.Ad)), P, np.int64(0), seen, never, jnp.asarray(False))

    def step(self, t: Any, s: LinearModelFilterState, frame: Frame) -> tuple[LinearModelFilterState, FilteredEstimate]:
        """Return the new state and the estimate at integer time t.

        Once per period, the filter predicts over the period and corrects with the new measurements. In between, the
        last estimate is held.
        """
        due = ~s.started | (t - s.t >= self.period)
        names = _sensors(self.channels)
        samples = [frame.samples[name] for name in names]
        new = [one.valid & is_new(one, s.seen[i]) & (t - one.t < self.period) for i, one in enumerate(samples)]
        du, acts = self._acting_change(frame)
        e, P = kalman.predict(s.e, s.P, jnp.asarray(self.Ad), jnp.asarray(self.Qd))
        e = jnp.where(s.started, e + jnp.asarray(self.Bd) @ du, s.e)
        P = jnp.where(s.started, P, s.P)
        y = jnp.stack([_number(frame, name) for name in self.channels])
        fresh = jnp.stack([new[names.index(name.partition(".")[0])] for name in self.channels])
        C = jnp.asarray(self.C)
        r = jnp.where(fresh, y - jnp.asarray(self.y0) - C @ e - jnp.asarray(self.D) @ du, jnp.nan)
        corrected = kalman.update_sequentially(e, P, r, C, jnp.asarray(self.R))
        used = jnp.where(due, jnp.sum(corrected.accepted), 0)
        some = used > 0
        newest = jnp.max(jnp.stack([jnp.where(n, one.t, s.measured) for n, one in zip(new, samples, strict=True)]))
        state = LinearModelFilterState(
            e=jnp.where(due, corrected.x, s.e),
            P=jnp.where(due, corrected.P, s.P),
            t=jnp.where(due, t, s.t),
            seen=jnp.stack(
                [jnp.where(due & n, x.t, s.seen[i]) for i, (n, x) in enumerate(zip(new, samples, strict=True))]
            ),
            measured=jnp.where(some, newest, s.measured),
            started=s.started | (some & acts),
        )
        estimate = FilteredEstimate(
            t=t,
            age=jnp.where(state.started, to_seconds(t - state.measured), 0.0),
            fresh=some,
            valid=state.started,
            state=_add(self.x0, state.e),
            P=state.P.reshape(-1),
            nis=jnp.where(due, corrected.nis, 0.0),
            used=used,
        )
        return state, estimate

    def _acting_change(self, frame: Frame) -> tuple[Any, Any]:
        """Return u - u0 (m,) and True, or zeros and False if a sample of the acting inputs is not valid."""
        numbers = [_number(frame, name) - self.u0[i] for i, name in enumerate(self.input_channels)]
        du = jnp.stack(numbers) if numbers else jnp.zeros(0)
        valid = [frame.samples[name].valid for name in _sensors(self.input_channels)]
        acts = jnp.all(jnp.stack(valid)) if valid else jnp.asarray(True)
        return jnp.where(acts & jnp.all(jnp.isfinite(du)), du, 0.0), acts


def _sensors(channels: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.partition(".")[0] for name in channels))


def _number(frame: Frame, channel: str) -> Any:
    """Return the value of a channel, e.g. ``encoder.position`` or ``imu.force[2]``, in its sensor's newest sample."""
    sensor, _, path = channel.partition(".")
    value = frame.samples[sensor].value
    for name in path.split("."):
        field, bracket, index = name.partition("[")
        value = value[field] if isinstance(value, dict) else getattr(value, field)
        value = value[int(index.rstrip("]"))] if bracket else value
    return jnp.asarray(value, jnp.float64)


def _add(record: Any, change: Any) -> Any:
    """Return the record with the elements of a vector added to the record's values, in the order of the fields."""
    leaves, tree = jax.tree.flatten(record)
    ends = np.cumsum([np.size(own) for own in leaves])
    parts = [change[int(end) - np.size(own) : int(end)] for own, end in zip(leaves, ends, strict=True)]
    new = [own + jnp.reshape(more, jnp.shape(own)) for own, more in zip(leaves, parts, strict=True)]
    return jax.tree.unflatten(tree, new)
