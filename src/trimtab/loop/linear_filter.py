"""Design of a Kalman filter for the linear model of any vehicle, with a check of the vehicle's observability.

Source: docs page, Linear model filter.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.linalg import matrix_balance

from trimtab.core.discretisation import discretise
from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.suggestions import closest
from trimtab.core.time import to_seconds
from trimtab.design.coordinates import attitude_fields
from trimtab.design.linearise import LinearModel, linearise
from trimtab.design.model import entry_names, find_indices, model_of_vehicle, record_vector
from trimtab.estimators.linear_model import LinearModelFilter

LIGHT = 0.2
"""Damping ratio below which a mode counts as lightly damped. A lightly damped mode must be observable."""
UNSEEN = 3e-5
"""Observability threshold in the Hautus test: a mode counts as unobservable if the smallest singular value of the test
matrix is less than this fraction of the largest."""


class UnseenMode(NamedTuple):
    """Unobservable mode of a linear model.

    pole: pole of the mode (1/s).  states: names of the states with a large component in the mode, largest first.
    """

    pole: complex
    states: tuple[str, ...]

    @property
    def stays(self) -> bool:
        """Return True if the mode is unstable, neutral or lightly damped."""
        decay = -self.pole.real
        return decay <= 0 or decay < LIGHT * abs(self.pole)


def measure_channels(vehicle: Any, x: Any, u: Any, sensors: Mapping[str, Any]) -> dict[str, Callable[[Any, Any], Any]]:
    """Return each number that the sensors measure, as a function of the vehicle's state and input, by name.

    The name consists of the sensor and the measured quantity, e.g. ``encoder.position``.

    Args:
        vehicle: the vehicle with the sensors.
        x: example of a state record.
        u: example of an input record.
        sensors: sensors by name. Sensors that measure the vehicle's input are skipped, because their measurements don't
            depend on the state.
    """
    functions: dict[str, Callable[[Any, Any], Any]] = {}
    for name, sensor in sensors.items():
        feels = optional_member(sensor, "FEELS")
        if feels == "input":
            continue

        def measure(x: Any, u: Any, sensor: Any = sensor, feels: str = feels) -> Any:
            return sensor.measure(x if feels == "state" else vehicle.motion(np.int64(0), x, u))

        for i, entry in enumerate(entry_names(measure(x, u))):
            functions[f"{name}.{entry}"] = lambda x, u, i=i, measure=measure: record_vector(measure(x, u))[i]
    return functions


def unseen_modes(linear: LinearModel) -> tuple[UnseenMode, ...]:
    """Return the unobservable modes of a linear model, in the order of decreasing real parts of their poles.

    Source: M. L. J. Hautus, "Controllability and observability conditions of linear autonomous systems", Proc. Kon.
    Ned. Akad. Wetensch. A 72 (1969): [A - p I; C] v = 0.
    """
    balance: Any = matrix_balance(linear.A, permute=False, separate=True)
    d = np.asarray(balance[1][0], float)
    A, C = linear.A * d / d[:, None], linear.C * d
    length = np.linalg.norm(C, axis=1, keepdims=True)
    C = C / np.where(length > 0, length, 1.0) * max(float(np.abs(A).max(initial=0.0)), 1e-3)
    modes: list[UnseenMode] = []
    for pole in sorted(np.linalg.eigvals(A).tolist(), key=lambda p: -complex(p).real):
        pole = complex(pole)
        _, singular, right = np.linalg.svd(np.vstack([A - pole * np.eye(len(A)), C]))
        if pole.imag < 0 or singular[-1] > UNSEEN * singular[0]:
            continue
        part = np.abs(right[-1])
        order = np.argsort(-part, kind="stable")
        names = tuple(linear.states[i] for i in order if part[i] > 0.1 * part.max())
        if not any(abs(m.pole - pole) < 1e-6 * (1 + abs(pole)) for m in modes):
            modes.append(UnseenMode(pole, names))
    return tuple(modes)


def design_filter(
    vehicle: Any,
    x: Any,
    u: Any,
    sensors: Mapping[str, Any],
    noise: Mapping[str, float],
    first: Mapping[str, float],
    disturbance: Mapping[str, float] | None = None,
    *,
    period: int,
    actuators: str = "actuators",
) -> LinearModelFilter:
    """Return a Kalman filter for all states of a vehicle near a trim point (x, u).

    Args:
        vehicle: model of the vehicle.
        x: state record at the trim point.
        u: input record at the trim point.
        sensors: sensors of the world, by name.
        noise: measured number that the filter uses, e.g. ``encoder.position`` -> standard deviation of the measurement
            noise, in the unit of the number.
        first: name of a state -> standard deviation of the state's initial estimate. Required for every state.
        disturbance: name of a state -> square root of the spectral density of the white noise that is added to the
            state's derivative (unit of the derivative times s^0.5).
        period: control period of the autopilot (100 ns).
        actuators: name of the sensor that measures the vehicle's input (`sensors.flight_state.ActingInput`).

    Raises: InputError if a lightly damped, neutral or unstable mode is unobservable, or if the vehicle's attitude is a
        quaternion. Such a vehicle needs a filter for inertial navigation (docs, Gnss and inertial).
    """
    if attitude_fields(x):
        fix = "use an estimator for inertial navigation (docs, Gnss and inertial)"
        raise InputError(
            "design_filter", "the vehicle's state contains a quaternion, which a linear filter cannot estimate", fix=fix
        )
    channels = measure_channels(vehicle, x, u, sensors)
    for name in noise:
        if name not in channels:
            near = closest(name, channels, 1) or [*channels, "SENSOR.NUMBER"]
            raise InputError(
                "design_filter.noise", f"no sensor measures {name!r}", choices=channels, fix=f"{near[0]!r}: …"
            )
    linear = linearise(model_of_vehicle(vehicle, x, u, outputs={n: channels[n] for n in noise}))
    lacking = [n for n in linear.states if n not in first]
    if lacking:
        problem = f"the initial standard deviation of {', '.join(lacking)} is missing"
        raise InputError("design_filter.first", problem, fix=f"first={{{lacking[0]!r}: …}}, a standard deviation")
    _refuse_unseen(linear, [n for n in channels if n not in noise])
    find_indices("design_filter.first", first, linear.states)
    rows = find_indices("design_filter.disturbance", disturbance or {}, linear.states)
    density = np.zeros(len(linear.states))
    density[rows] = np.square(list((disturbance or {}).values()))
    model = discretise(jnp.asarray(linear.A), jnp.diag(jnp.asarray(density)), to_seconds(period))
    return LinearModelFilter(
        x0=x,
        u0=np.asarray(record_vector(u)),
        channels=tuple(noise),
        input_channels=tuple(f"{actuators}.{name}" for name in entry_names(u)),
        Ad=np.asarray(model.Ad),
        Bd=np.asarray(model.Bd) @ linear.B,
        Qd=np.asarray(model.Qd),
        C=linear.C,
        D=linear.D,
        y0=linear.y0,
        R=np.square(list(noise.values())),
        P0=np.diag(np.square([first[n] for n in linear.states])),
        period=period,
    )


def _refuse_unseen(linear: LinearModel, others: list[str]) -> None:
    for mode in unseen_modes(linear):
        if mode.stays:
            pole = f"{mode.pole.real:+.3g}" + (f" ± {mode.pole.imag:.3g}i" if mode.pole.imag else "")
            problem = (
                f"{', '.join(linear.outputs)} cannot observe the mode with pole {pole} 1/s, which appears in "
                f"{', '.join(mode.states)}"
            )
            fix = (
                f"use another measurement, e.g. noise={{{others[0]!r}: …}}"
                if others
                else "add a sensor that observes this mode"
            )
            raise InputError("design_filter", problem, choices=others, fix=fix)
