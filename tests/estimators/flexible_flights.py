"""Flights of the hypersonic vehicle for tests of the filters of its modes: the order of the loop at each instant.

Truth, sensors (with the input that has acted), filter, then the new input, held while the plant moves by RK4.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import fsolve

from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key, normals
from trimtab.core.signals import Frame, new_sample
from trimtab.core.time import ms
from trimtab.sensors.angular_accelerometer import AngularAccelerometer
from trimtab.sensors.flight_state import FlightStateSensor
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput

DT = 5e-3
NAMES = ("eta1", "eta1_rate", "eta2", "eta2_rate")


@functools.cache
def trim(kmode="parker", detuned=1.0):
    """Vehicle, state and input of level flight at the reference point."""
    craft = Hypersonic()
    craft = replace(craft, modes=replace(craft.modes.detune(detuned), kmode=kmode))

    def residual(z):
        rate = craft.dynamics(0.0, craft.level_state(85000.0, 7702.0808, z[0], z[2]), HypersonicInput(z[1], z[2]))
        return [float(rate.V), float(rate.alpha) * 7702, float(rate.q)]

    alpha, Phi, delta_e = fsolve(residual, [0.03, 0.3, 0.2], xtol=1e-14)
    x = craft.level_state(85000.0, 7702.0808, alpha, delta_e)
    return to_arrays(craft), to_arrays(x), to_arrays(HypersonicInput(Phi, delta_e))


def steady(k, u):
    """The trim's input for ever."""
    return u


def wobble(k, u):
    """An elevator and a fuel ratio that shake all modes."""
    s = k * DT
    return HypersonicInput(u.Phi + 0.05 * jnp.sin(3 * s), u.delta_e + 0.02 * jnp.sin(16 * s) + 0.01 * jnp.sin(21 * s))


def fly(craft, x, u, one, seed=0, noise=0.01, inputs=steady, qacc=0.0, offset=0.0):
    """Ten seconds with the trim's input, or three that shake: errors estimate - truth (n, 4), estimates, covariances.

    qacc: density of white acceleration on the modes, applied each step with variance qacc/dt.
    """
    numbers = (float(v) for v in (noise, qacc, offset))
    return _fly(craft, x, u, to_arrays(one), np.uint32(seed), *numbers, inputs)


@functools.partial(jax.jit, static_argnames="inputs")
def _fly(craft, x, u, one, seed, noise, qacc, offset, inputs):
    n = 2000 if inputs is steady else 600
    flight, imu_reading = FlightStateSensor(), AngularAccelerometer(noise=noise, offset=offset)
    root = key(0).at("flight")
    root = replace(root, run=seed)
    sensor_keys = [root.at(name) for name in ("flight", "angular-accelerometer")]
    first = jax.tree.map(jnp.asarray, one.init(root.at("filter")))

    def instant(held, k):
        x, state, u_before = held
        t = k * ms(5)
        motion = craft.motion(t, x, u_before)
        chi = flight.step(t, sensor_keys[0], motion)[1]
        z = imu_reading.step(t, sensor_keys[1], motion)[1]
        frame = Frame(t, {"flight": chi, "angular-accelerometer": z, "actuators": new_sample(t, u_before)})
        state, estimate = one.step(t, state, frame)
        error = jnp.stack([getattr(estimate.state, n) - getattr(x, n) for n in NAMES])
        u_now = inputs(k, u)
        after = rk4(lambda s, y: craft.dynamics(s, y, u_now), k * DT, x, DT)
        w = normals(root.at("process"), k, 2) * jnp.sqrt(qacc / DT) * DT
        after = replace(after, eta1_rate=after.eta1_rate + w[0], eta2_rate=after.eta2_rate + w[1])
        return (after, state, u_now), (error, estimate, state.P)

    _, out = jax.lax.scan(instant, (x, first, u), jnp.arange(n, dtype=np.int64))
    return out


def rms(errors, start, stop):
    """Of errors (…, n, 4) over instants from start to stop (s), for each of the four."""
    part = np.asarray(errors)[..., round(start / DT) : round(stop / DT), :]
    return np.sqrt((part**2).mean(-2))
