"""Flights in batches, for tests of the adaptive filter: any frequencies, elevator moves, a disturbance.

The order of an instant is that of `flexible_flights`. Where the vehicle is shaken, a rigid feedback of angle of attack
and pitch rate keeps it at its trim, which is unstable (1.7 1/s); it is no scenario, and leaves every mode damped.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from estimators.flexible_flights import DT, NAMES, trim

from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key, normals
from trimtab.core.signals import Frame, new_sample
from trimtab.core.time import ms
from trimtab.sensors.angular_accelerometer import AngularAccelerometer
from trimtab.sensors.flight_state import FlightStateSensor
from trimtab.vehicles.hypersonic import Disturbance, HypersonicInput

CASES = ((1, 1), (0.9, 0.9), (1.1, 1.1), (0.9, 1), (1.1, 1), (1, 0.9), (1, 1.1), (0.9, 1.1), (1.1, 0.9))
"""Factors of w1 and w2 of the plant."""
KNOCK = Disturbance(moment=0.4 * 5e5, start=5.0, duration=0.05)
"""0.4 rad/s^2 for 50 ms, unknown to the filters."""


def rest(s):
    return 0.0 * s


def steps(s):
    """An elevator that steps by 2 degrees, up or down each second."""
    return 0.0175 * jnp.where(jnp.sin(jnp.pi * s) > 0, 1.0, -1.0)


def weave(s):
    """A slow sine of the elevator, 1.1 degrees at 2 rad/s, which shakes no mode."""
    return 0.02 * jnp.sin(2 * s)


def buzz(s):
    """Two sines of the elevator near the modes."""
    return 0.02 * jnp.sin(16 * s) + 0.01 * jnp.sin(21 * s)


class Flown(NamedTuple):
    """Of each flight and instant: errors of the modal state, truth of it, estimate, filter's state, what was felt."""

    error: np.ndarray
    truth: np.ndarray
    estimate: object
    state: object
    imu_reading: np.ndarray
    x: object
    u: object


def plants(factors, disturbance=None, off=None):
    """Vehicles and states at their trims, stacked; factors (n, 2) of frequencies, off (n, 4): of the modal state."""
    craft, x, _ = trim()
    f = np.asarray(factors, float)
    off = np.zeros((len(f), 4)) if off is None else off
    made = [
        (
            replace(craft, disturbance=disturbance, modes=replace(craft.modes, w1=16.5 * a, w2=20.0 * b)),
            replace(x, eta1=x.eta1 / a**2 + o[0], eta1_rate=o[1], eta2=x.eta2 / b**2 + o[2], eta2_rate=o[3]),
        )
        for (a, b), o in zip(f, off, strict=True)
    ]
    return tuple(
        jax.tree.map(lambda *a: np.stack([np.asarray(v, float) for v in a]), *part) for part in zip(*made, strict=True)
    )


def fly_many(factors, one, seeds, move=rest, seconds=10, noise=0.01, qacc=0.0, disturbance=None, off=None, size=1.0):
    """Every plant with its seed: a `Flown` of leading axes (n, time).

    At rest without feedback, or with it, moved by `size` times a function of time, or knocked.
    """
    craft, x = plants(factors, disturbance, off)
    seeds, n = np.asarray(seeds, np.uint32), round(seconds / DT)
    held = 0.0 if (move is rest or not size) and disturbance is None else 1.0
    out = _fly(craft, x, trim()[2], to_arrays(one), seeds, float(noise), float(qacc), held, float(size), move, n)
    return jax.tree.map(np.asarray, Flown(*out))


@functools.partial(jax.jit, static_argnames=("move", "n"))
def _fly(craft, x, u, one, seeds, noise, qacc, held, size, move, n):
    flight, imu_reading, alpha = FlightStateSensor(), AngularAccelerometer(noise=noise), trim()[1].alpha

    def single(craft, x, seed):
        root = replace(key(0).at("flight"), run=seed)
        first = jax.tree.map(jnp.asarray, one.init(root.at("filter")))

        def instant(carry, k):
            x, state, before = carry
            t = k * ms(5)
            motion = craft.motion(t, x, before)
            chi = flight.step(t, root.at("flight"), motion)[1]
            z = imu_reading.step(t, root.at("angular-accelerometer"), motion)[1]
            frame = Frame(t, {"flight": chi, "angular-accelerometer": z, "actuators": new_sample(t, before)})
            state, estimate = one.step(t, state, frame)
            truth = jnp.stack([getattr(x, name) for name in NAMES])
            error = jnp.stack([getattr(estimate.state, name) for name in NAMES]) - truth
            elevator = u.delta_e + size * move(k * DT) + held * (3 * (x.alpha - alpha) + 0.5 * x.q)
            now = HypersonicInput(u.Phi, elevator)
            after = rk4(lambda s, y: craft.dynamics(s, y, now), k * DT, x, DT)
            w = normals(root.at("process"), k, 2) * jnp.sqrt(qacc * DT)
            after = replace(after, eta1_rate=after.eta1_rate + w[0], eta2_rate=after.eta2_rate + w[1])
            kept = {name: getattr(state, name) for name in ("P", "spread", "p", "mean") if hasattr(state, name)}
            return (after, state, now), (error, truth, estimate.state, kept, z.value.pitch_acceleration, x, before)

        return jax.lax.scan(instant, (x, first, u), jnp.arange(n, dtype=np.int64))[1]

    return jax.vmap(single)(craft, x, seeds)


def rms_of(errors, start, stop):
    """Of errors (runs, n, 4), over runs and instants from start to stop (s)."""
    return np.sqrt((errors[:, round(start / DT) : round(stop / DT)] ** 2).mean((0, 1)))
