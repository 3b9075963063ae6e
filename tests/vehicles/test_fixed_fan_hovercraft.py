"""The hovercraft with fixed fans: forces against analytical values, damping, and identification from a flight."""

import jax
import numpy as np
import pytest
from jax import lax

from trimtab.actuators.allocation import DirectActuation
from trimtab.analysis.identify.flight_data import FlightData
from trimtab.analysis.identify.identification import identify
from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import ms
from trimtab.links.wire import Wire
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.vehicles.fixed_fan_hovercraft import FanThrottles, FixedFanHovercraft
from trimtab.vehicles.hovercraft import HovercraftState

CRAFT = FixedFanHovercraft()


def test_two_fans_give_thrust_and_yaw_moment() -> None:
    X, Y, N = CRAFT.wrench(FanThrottles(throttle=np.array([1.0, 0.5])))
    np.testing.assert_allclose([X, Y, N], [0.8 + 0.25, 0.0, 0.1 * 0.8 - 0.1 * 0.25], rtol=1e-12)


def test_transverse_fan_gives_side_force_and_yaw_moment() -> None:
    fan = replace(CRAFT, fan_direction=np.array([np.pi / 2, 0.0]))
    X, Y, N = fan.wrench(FanThrottles(throttle=np.array([1.0, 0.0])))
    np.testing.assert_allclose([X, Y, N], [0.0, 0.8, -0.2 * 0.8], atol=1e-12)


def test_throttles_are_clipped_to_their_range() -> None:
    beyond, ends = (CRAFT.wrench(FanThrottles(throttle=np.array(c))) for c in ([2.0, -1.0], [1.0, 0.0]))
    np.testing.assert_array_equal(beyond, ends)


def test_damping_dissipates_energy() -> None:
    rest = FanThrottles(throttle=np.zeros(2))
    for seed in range(20):
        s, w, r = np.random.default_rng(seed).uniform(-2, 2, 3)
        x = to_arrays(HovercraftState(surge_velocity=s, sway_velocity=w, yaw_rate=r))
        d = CRAFT.dynamics(0.0, x, rest)
        power = CRAFT.mass * (s * d.surge_velocity + w * d.sway_velocity) + CRAFT.inertia * r * d.yaw_rate
        assert power < 0


def test_rejects_thrust_curves_of_wrong_length() -> None:
    with pytest.raises(InputError, match="thrust_linear"):
        replace(CRAFT, thrust_linear=np.ones(3)).check()


@pytest.mark.thorough
def test_identification_recovers_the_vehicle_parameters() -> None:
    """Thrust of either fan, damping and inertia, from half a minute of pose at 50 Hz under changing throttles."""
    true = replace(CRAFT, inertia=0.05, thrust_quadratic=np.array([0.6, 0.45]), yaw_damping=0.03)
    g, n = np.random.default_rng(0), 1500
    throttles = np.repeat(g.uniform(0, 1, (n // 25, 2)), 25, axis=0)

    def advance(x: HovercraftState, c: np.ndarray) -> tuple[HovercraftState, HovercraftState]:
        for _ in range(4):
            x = rk4(lambda t, x: true.dynamics(t, x, FanThrottles(throttle=c)), 0.0, x, 0.005)
        return x, x

    _, path = jax.jit(lambda x: lax.scan(advance, x, throttles))(to_arrays(HovercraftState()))
    ticks, y = ms(20) * np.arange(1, n + 1), np.full((n, 6), np.nan)
    for k, (name, sigma) in enumerate((("north", 0.002), ("east", 0.002), ("heading", 0.005)), 3):
        y[:, k] = np.asarray(getattr(path, name)) + sigma * g.standard_normal(n)
    flight = FlightData("flight", FanThrottles(throttle=throttles), ms(20) * np.arange(n), ticks, y)
    neutral = FanThrottles(throttle=np.zeros(2))
    actuation = DirectActuation(neutral_input=neutral, period=ms(20))
    world = World(vehicle=CRAFT, sensors={}, actuators=actuation, downlink=Wire(), uplink=Wire())
    scenario = Scenario(world=world, autopilot=(), initial=HovercraftState())  # pyright: ignore[reportArgumentType]
    paths = ("inertia", "thrust_quadratic[0]", "thrust_quadratic[1]", "yaw_damping")
    found = identify(scenario, [flight], [f"world.vehicle.{p}" for p in paths])
    for value, error, wanted in zip(found.values, found.standard_errors, (0.05, 0.6, 0.45, 0.03), strict=True):
        assert abs(value - wanted) < 4 * error + 1e-3 * wanted
    assert found.estimate.converged
