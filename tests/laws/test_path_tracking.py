"""Path tracking: the rate of V on random states and references, and ideal runs from random starts."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import solve_lyapunov

from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight, interpolate_path, pass_waypoints
from trimtab.core.rotation import planar
from trimtab.core.signals import Estimate
from trimtab.laws.path_feasibility import ThrustLimits
from trimtab.laws.path_tracking import PathTracking, decay
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

FREE = ThrustLimits(push=1e6, pull=1e6, turn_rate=1e6, angle=1.4)
LAW = PathTracking(limits=FREE, side=1e6)
A = float(Hovercraft().percussion_arm)


def random_path(seed):
    """Return a path through random places, a few seconds apart."""
    draw = np.random.default_rng(seed)
    return interpolate_path(np.cumsum(draw.uniform(3, 6, 9)), np.cumsum(draw.normal(0, 0.7, (9, 2)), axis=0))


def estimate(t, x):
    return Estimate(t=t, age=0.0, fresh=True, valid=True, state=x)


def percussion_state(x):
    """Return place and velocity of P in W."""
    body = planar(x.heading)
    place = jnp.stack([x.north, x.east]) + A * body[:, 0]
    return place, body @ jnp.stack([x.surge_velocity, x.sway_velocity + A * x.yaw_rate])


@functools.cache
def flow(law_structure):
    """Return a function of (law parameters, path time, state): V, V' along the loop, and the terms of the formula."""

    def V(law, time, x):
        state = replace(law.init(None), progress=time)
        return law.step(jnp.int64(0), state, estimate(0, x))[1]

    def both(numbers, time, x):
        law = jax.tree.unflatten(law_structure, numbers)
        out = V(law, time, x)
        rate = law.model.dynamics(0.0, x, out.demand)
        return out, jax.jvp(lambda time, x: V(law, time, x).lyapunov, (time, x), (1.0, rate))[1]

    return jax.jit(both)


def observe(law, time, x):
    numbers, structure = jax.tree.flatten(law)
    return flow(structure)(numbers, float(time), x)


def formula(law, time, x, out):
    """Return V' as in the docstring and its bound, in numpy, and the turn of the chosen end."""
    k1, k2, q, p, s0 = (float(v) for v in (law.k1, law.k2, law.q, law.p, law.s0))
    point = law.reference.at(float(time))
    place, velocity = (np.asarray(v) for v in percussion_state(x))
    e, v = place - point.place, velocity - point.velocity
    n, b = np.asarray(planar(x.heading)).T
    s = np.asarray(point.acceleration) - k1 * e - k2 * v
    w, y, size, end = n @ s, b @ s, np.hypot(*s), -1.0 if out.backing else 1.0
    slope = point.jerk - k1 * v - k2 * (-k1 * e - k2 * v - b * y)
    half = end * y / (size + end * w)
    M = (w * (b @ slope) - y * (n @ slope) + 2 * half * (s @ slope)) / size
    G, c = size**4 / (size**4 + s0**4), b @ (v + k2 / 2 * e)
    z = float(x.yaw_rate) - float(out.yaw_rate_reference)
    rate = -(k1 * k2 / 2) * e @ e - k2 / 2 * v @ v - q * float(law.kn) * G * y**2 - p * float(law.kr) * z**2
    rate += (1 - G) * y * (end * q * M - c)
    spare = q * float(law.kn) * s0**2 / 2 + 0.57 * s0 * (3 * q * np.hypot(*slope) + abs(c))
    return rate, -2 * decay(law) * float(out.lyapunov) + spare, np.arctan2(abs(y), end * w)


def random_state(draw, path, time):
    """Return a random state near the path: P within about a metre, any heading."""
    place = np.asarray(path.at(time).place) + draw.normal(0, 0.5, 2)
    return HovercraftState(*draw.normal(0, [0.4, 0.4, 0.6]), *place, draw.uniform(-np.pi, np.pi))


PATHS = {"circle": Circle(), "eight": FigureEight(), "way-points": pass_waypoints([[0, 0], [3, 0], [3, 3]], 0.5)}
PATHS |= {f"random {k}": random_path(k) for k in range(3)}


@pytest.mark.thorough
@pytest.mark.parametrize("name", PATHS)
def test_lyapunov_rate_matches_the_documented_identity_and_bound(name):
    path, draw = PATHS[name], np.random.default_rng(7)
    law = replace(LAW, reference=path)
    within = 0
    begin, end = (path.times[0], path.times[-1]) if hasattr(path, "times") else (0.0, 30.0)
    for _ in range(150):
        time = draw.uniform(begin, end)
        x = random_state(draw, path, time)
        out, rate = observe(law, time, x)
        wanted, bound, turn = formula(law, time, x, out)
        assert float(rate) == pytest.approx(float(wanted), rel=1e-5, abs=1e-6)
        if turn <= np.pi / 2:
            within += 1
            assert float(rate) <= bound + 1e-9
    assert within > 120


@pytest.mark.thorough
def test_leading_end_minimises_the_lyapunov_function():
    """Turning the craft by 180 degrees changes the leading end, not the motion of P."""
    law, draw = replace(LAW, reference=Circle()), np.random.default_rng(8)
    for _ in range(20):
        time = draw.uniform(10, 30)
        x = random_state(draw, law.reference, time)
        place, _ = percussion_state(x)
        turned = x.heading + np.pi
        n = np.array([np.cos(turned), np.sin(turned)])
        place = np.asarray(place) - A * n
        side = x.sway_velocity + A * x.yaw_rate
        y = HovercraftState(-x.surge_velocity, -side - A * x.yaw_rate, x.yaw_rate, *place, turned)
        (one, _), (other, _) = observe(law, time, x), observe(law, time, y)
        assert bool(one.backing) != bool(other.backing)
        assert float(one.lyapunov) == pytest.approx(float(other.lyapunov), rel=1e-9)


def test_decay_rate_matches_the_error_dynamics():
    """For the errors alone, e'' = -k1 e - k2 e', V falls in the slowest direction at the rate mu, by scipy."""
    law = LAW
    k1, k2 = float(law.k1), float(law.k2)
    loop = np.array([[0.0, 1.0], [-k1, -k2]])
    M = np.array([[k1 + k2**2 / 2, k2 / 2], [k2 / 2, 1.0]])
    np.testing.assert_allclose(solve_lyapunov(loop.T, -np.diag([k1 * k2, k2])), M, atol=1e-12)
    mu = decay(replace(law, kn=1e3, kr=1e3))
    draw = np.random.default_rng(1).normal(size=(2000, 2))
    V, rate = ((draw @ M) * draw).sum(1) / 2, (draw @ M * (draw @ loop.T)).sum(1)
    assert (rate <= -2 * mu * V + 1e-12).all()
    assert (rate / V).max() == pytest.approx(-2 * mu, rel=0.02)
    assert decay(replace(law, kn=0.1)) == pytest.approx(0.05)


def starts(n, seed, place, spread=1.0):
    draw = np.random.default_rng(seed)
    u, v, r = draw.uniform(-0.5, 0.5, (3, n))
    north, east = np.asarray(place)[:, None] + spread * draw.uniform(-1, 1, (2, n))
    return HovercraftState(u, v, r, north, east, draw.uniform(-np.pi, np.pi, n))


@pytest.mark.thorough
def test_lyapunov_function_decays_exponentially_to_a_neighbourhood(sampled):
    """On a circle, with constant thrust and without limits: V decays exponentially and stays small."""
    law = replace(LAW, reference=Circle(ease=0.0))
    _, out = sampled(law, starts(30, 3, (1.5, 0.0)), 60, 100)
    V = np.asarray(out.lyapunov)
    mu, last = decay(law), V[:, -100:].max()
    assert last < 2e-5
    t = np.arange(V.shape[1]) * 0.1
    spare = 3 * V[:, :1] * np.exp(-2 * mu * t) + last - V
    assert spare.min() >= 0
    assert np.asarray(out.position_error)[:, -100:].max() < 0.01


@functools.cache
def flown(structure, plant):
    """Return the law's outputs over 90 s of a 10 ms loop on JAX, for many starts."""

    def fly(numbers, x):
        law = jax.tree.unflatten(structure, numbers)

        def tick(carry, k):
            x, state = carry
            state, out = law.step(k * 100_000, state, estimate(0, x))
            return (rk4(lambda t, x: plant.dynamics(t, x, out.demand), 0.0, x, 0.01), state), out

        return jax.lax.scan(tick, (x, law.init(None)), jnp.arange(9000))[1]

    return jax.jit(jax.vmap(fly, in_axes=(None, 0)))


def fly(law, x, plant):
    numbers, structure = jax.tree.flatten(law)
    return flown(structure, plant)(numbers, jax.tree.map(jnp.asarray, x))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["circle", "eight", "way-points"])
def test_tracks_paths_within_actuator_limits(name):
    """From 1 m off, any heading, 0.5 m/s: with the forces that fan and rudder can give."""
    path = PATHS[name]
    out = fly(PathTracking(reference=path), starts(20, 4, path.at(0.0).place), Hovercraft())
    late = np.asarray(out.position_error)[:, 6000:]
    assert np.asarray(out.resting)[:, -1].all() == (name == "way-points")
    print(f"{name}: rms after 60 s {np.sqrt(np.mean(late**2)):.4f} m, most {late.max():.4f} m")
    assert late.max() < 0.05
    FX = np.asarray(out.demand.FX)
    assert FX.max() <= 1.3
    assert FX.min() >= -0.6
    if name == "eight":
        assert ((FX[:, 4000:] < -0.1).any(axis=1) & (FX[:, 4000:] > 0.1).any(axis=1)).all()  # it backs, and pushes


@pytest.mark.thorough
def test_friction_in_the_law_model_reduces_tracking_error():
    plant = Hovercraft(friction=Friction(force_viscous=0.4, torque_viscous=0.02, force_quadratic=0.2))
    x = HovercraftState(*(np.array([v]) for v in (0.0, 0.0, 0.0, 1.5, -A, np.pi / 2)))
    errors = [
        np.asarray(fly(replace(LAW, model=believed), x, plant).position_error)[0, 4000:].max()
        for believed in (plant, Hovercraft())
    ]
    assert errors[0] < 0.05  # what is left is the second derivative of the drag, which the law leaves out
    assert errors[1] > 4 * errors[0]


@pytest.mark.thorough
def test_path_progress_waits_for_a_craft_behind():
    """With progress along the path, the reference slows down for a craft that starts a metre behind."""
    behind = HovercraftState(*(np.array([v]) for v in (0.0, 0.0, 0.0, 1.5, -1.0, np.pi / 2)))
    x = jax.tree.map(lambda a: float(a[0]), behind)
    progress = {}
    for kind in ("time", "path"):
        law = replace(LAW, reference=Circle(ease=0.0), progress=kind)
        state = replace(law.init(None), began=np.asarray(True), progress=np.asarray(10.0))
        place = np.asarray(law.reference.at(10.0).place)
        back = np.asarray(law.reference.at(10.0).velocity)
        x = replace(x, north=float((place - back)[0]), east=float((place - back)[1]))
        now, _ = law.step(np.int64(1_000_000), state, estimate(0, x))
        progress[kind] = float(now.progress) - 10.0
    assert progress["time"] == pytest.approx(0.1)
    assert 0.0 <= progress["path"] < 0.08
