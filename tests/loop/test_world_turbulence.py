"""Turbulence as a part of the world: effects, logging, repeatability, and switching off."""

from typing import Any, ClassVar

import numpy as np
import pytest

from trimtab import build, simulate
from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError
from trimtab.core.record import part, record, replace
from trimtab.core.signals import Gust
from trimtab.core.time import ms, seconds
from trimtab.environment.discrete_gust import DiscreteGust
from trimtab.environment.turbulence import Turbulence
from trimtab.environment.wind import Wind
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.loop.world import World
from trimtab.run.simulate import simulate_batch
from trimtab.sensors.navigation_errors import PlanarNavigation
from trimtab.vehicles.f16 import F16, F16Controls
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput
from trimtab.vehicles.rigid_body import NO_WRENCH, BluntBody, RigidBody, Wrench

BODY = RigidBody(
    mass=3.0,
    inertia=np.array([0.2, 0.5, 0.6]),
    aerodynamics=BluntBody(area=0.5, roll_damping=-1.0, pitch_damping=-0.5, yaw_damping=-0.7),
)
START = BODY.start(
    0.0, 0.0, 60.0, velocity=[40.0, 3.0, -2.0], angles=[0.1, 0.2, 0.3], rate=[0.1, 0, 0], over_ground=True
)
STILL = replace(START, rate=np.zeros(3))


@record
class NoWrench:
    """Empty demand. Source: this test."""

    demand: Wrench = part("None.")


@record
class Thrown:
    """A law without control. Source: this test."""

    reads: ClassVar[tuple[str, ...]] = ()

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        return state, NoWrench(NO_WRENCH)


TEN = Turbulence(period=ms(10))


def throw(turbulence: Turbulence | None = TEN) -> Scenario:
    tick = ms(10)
    world = World(
        BODY,
        {"navigation": PlanarNavigation(period=tick)},
        DirectActuation(neutral_input=NO_WRENCH, period=tick),
        Wire(period=tick),
        Wire(period=tick),
        max_step=tick,
        turbulence=turbulence,
    )
    return Scenario(
        world, Autopilot(Passthrough("navigation"), Thrown(), DirectAllocation(), period=tick), START, seconds(2)
    )


@pytest.mark.thorough
def test_gusts_are_logged_and_held_for_their_period():
    log = simulate(throw(Turbulence(period=ms(20))))
    gust = log["gust.velocity"]
    assert gust.shape == (200, 3)
    assert (np.diff(gust, axis=0)[::2] == 0).all()
    assert (np.diff(gust, axis=0)[1::2] != 0).all()
    assert 0.5 < gust.std() < 5
    assert log["gust.rate"].std() > 0.01


@pytest.mark.thorough
def test_turbulence_moves_the_vehicle_and_can_be_disabled():
    calm, rough = simulate(throw(None)), simulate(throw(TEN))
    assert not [p for p in calm.paths if p.startswith("gust")]
    off = simulate(throw(TEN).without("turbulence"))
    assert np.abs(rough["truth.velocity"] - calm["truth.velocity"]).max() > 0.1
    np.testing.assert_array_equal(off["truth.velocity"], calm["truth.velocity"])
    single = Turbulence(
        period=ms(10), intensity=0.0, discrete=DiscreteGust(velocity=(0, 0, -9.0), length=20.0, start=0.5)
    )
    one = simulate(throw(single))["gust.velocity"][:, 2]
    assert (one[:50] == 0).all()
    assert one.min() == pytest.approx(-9.0, rel=0.01)
    assert one[-1] == 0


@pytest.mark.thorough
def test_gusts_differ_per_seed_and_agree_across_backends():
    batch = simulate_batch(throw(), seeds=range(9), log=True)
    for seed in (0, 8):
        alone = simulate(throw(), seed=seed)
        np.testing.assert_array_equal(batch.log["gust.velocity"][seed], alone["gust.velocity"])
    assert np.abs(np.subtract(*batch.log["gust.velocity"][[0, 8]])).max() > 0.1
    on_jax = simulate(throw(), seed=8, backend="jax")
    np.testing.assert_allclose(on_jax["gust.velocity"], alone["gust.velocity"], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(on_jax["truth.velocity"], alone["truth.velocity"], rtol=1e-9, atol=1e-9)


@pytest.mark.thorough
def test_gusts_are_independent_of_sensor_periods():
    """A sensor with another period adds other instants but does not change the gusts."""
    scenario = throw()
    sensors = {"navigation": PlanarNavigation(period=ms(7))}
    other = replace(scenario, world=replace(scenario.world, sensors=sensors))
    a, b = simulate(scenario), simulate(other)
    at = np.isin(b.t, a.t)
    np.testing.assert_allclose(b["gust.velocity"][at][:100], a["gust.velocity"][:100], rtol=1e-3, atol=1e-3)


@pytest.mark.thorough
def test_turbulence_is_added_by_a_setting():
    scenario = with_settings(build("hypersonic/noise"), {"world.turbulence.exceedance": "1e-5"})
    assert scenario.world.turbulence.exceedance == 1e-5
    assert "turbulence" in scenario.imperfections()
    with pytest.raises(InputError, match="in_gust"):
        simulate(with_settings(build("hovercraft/forward"), {"world.turbulence.wind": "5"}), duration=ms(50))


@pytest.mark.thorough
def test_gust_gives_the_same_forces_as_wind():
    """The same air velocity gives the same forces as wind and as a gust."""
    air = np.array([4.0, -7.0, 0.0])
    x = STILL
    for vehicle, u, put in (
        (BODY, NO_WRENCH, lambda wind: replace(BODY, wind=wind)),
        (F16(), F16Controls(0.0, 0.1, 0.05, 0.3), lambda wind: F16(body=replace(F16().body, wind=wind))),
    ):
        blown = put(Wind(north=air[0], east=air[1]))
        flows = [getattr(v, "body", v).flight(0.0, x).flow for v in (vehicle, blown)]
        in_B = np.asarray(flows[0].velocity - flows[1].velocity)
        gust = vehicle.in_gust(Gust(in_B, np.zeros(3)))
        for a, b in zip(*(np.atleast_1d(v.dynamics(0.0, x, u).velocity) for v in (blown, gust)), strict=True):
            assert a == pytest.approx(b, rel=1e-12)
        np.testing.assert_allclose(blown.motion(0, x, u).air.velocity, gust.motion(0, x, u).air.velocity, rtol=1e-9)
        np.testing.assert_allclose(gust.motion(0, x, u).air.velocity, in_B, rtol=1e-9)


@pytest.mark.thorough
def test_rotating_gust_turns_a_body_only_with_aerodynamic_damping():
    x = STILL
    turning = BODY.in_gust(Gust(np.zeros(3), np.array([0.5, 0.0, 0.0])))
    a, b = (v.dynamics(0.0, x, NO_WRENCH).rate for v in (BODY, turning))
    assert float(b[0] - a[0]) > 0.01
    bare = replace(BODY, aerodynamics=None)
    in_vacuum = [v.dynamics(0.0, x, NO_WRENCH).rate for v in (replace(turning, aerodynamics=None), bare)]
    np.testing.assert_array_equal(*in_vacuum)
    np.testing.assert_allclose(turning.motion(0, x, NO_WRENCH).air.rate, [0.5, 0.0, 0.0], atol=1e-12)


@pytest.mark.thorough
def test_hypersonic_forces_in_a_gust_are_galilean_invariant():
    """Forces depend only on the velocity relative to the air; lift and drag act along its axes."""
    craft, u = Hypersonic(g=0.0), HypersonicInput(0.3, 0.2)
    x = craft.level_state(85e3, 7700.0, 0.028, 0.2)
    up = 30.0  # ft/s
    seen = craft.in_gust(Gust(np.array([0.0, 0.0, -up * 0.3048]), np.zeros(3)))
    V, alpha = seen.airflow(x)
    assert float(alpha - x.alpha) == pytest.approx(up / 7700, rel=1e-3)
    through = replace(x, V=V, alpha=alpha)
    inertial = seen.motion(0, x, u).a_WB_B
    np.testing.assert_allclose(inertial, craft.motion(0, through, u).a_WB_B, rtol=1e-9, atol=1e-9)
    bends = [v.coupled_accelerations(0, at, u) for v, at in ((seen, x), (craft, through))]
    np.testing.assert_allclose(*bends, rtol=1e-12)
    still = craft.in_gust(Gust(np.zeros(3), np.zeros(3)))
    np.testing.assert_allclose(still.motion(0, x, u).a_WB_B, craft.motion(0, x, u).a_WB_B, rtol=1e-12, atol=1e-9)
