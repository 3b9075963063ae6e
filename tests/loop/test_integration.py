"""Integration between two instants: stiff contact against scipy's Radau, events, jumps, and reported errors."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from loop.falling import Ball, G, HeightState, NormalisedTop, StiffFloor, Top, TopState, Touching, fall
from scipy.integrate import solve_ivp

from trimtab import simulate
from trimtab.commands.flight_summary import summarise_run
from trimtab.core.errors import InputError
from trimtab.core.record import record, replace
from trimtab.core.time import ms, to_seconds
from trimtab.loop.integration import PLAIN_STEP, Integration, integrate_truth
from trimtab.loop.settings import with_settings
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios import catalogue

FLOOR, START = StiffFloor(), HeightState()


@cache
def radau(end):
    """Return height and speed after a fall on the stiff floor, by scipy."""

    return solve_ivp(numpy_rates, (0, end), [1.0, 0.0], method="Radau", rtol=1e-11, atol=1e-13, max_step=0.01).y[:, -1]


def numpy_rates(t, y):
    push = max(-FLOOR.k * y[0] - FLOOR.c * y[1], 0.0) if y[0] < 0 else 0.0
    return [y[1], -G + push / FLOOR.mass]


@pytest.mark.thorough
@pytest.mark.parametrize("backend", ["c", "jax"])
@pytest.mark.parametrize("vehicle", [StiffFloor(), Touching()], ids=["plain", "with events"])
@pytest.mark.parametrize("method", ["rk45", "rosenbrock"])
def test_stiff_contact_matches_scipy_radau(method, vehicle, backend):
    fine = Integration(method=method, relative=1e-9, absolute=1e-9)
    log = simulate(fall(vehicle, START, fine), backend=backend)
    end = [log.final["truth.z"], log.final["truth.w"]]
    assert end == pytest.approx(radau(1.0), abs=1e-6)
    assert log["world.integration_error"].max() <= 1
    assert log["world.steps"].max() > 20  # in the 10 ms of the contact
    assert log["world.events"][-1] == (
        8 if isinstance(vehicle, Touching) else 0
    )  # two contacts, two events at each end


@pytest.mark.thorough
def test_fixed_rk4_fails_in_stiff_contact_and_reports_the_error():
    log = simulate(fall(FLOOR, START, PLAIN_STEP))
    assert abs(log.final["truth.z"] - radau(1.0)[0]) > 100
    said = summarise_run(log, [])["integration"]
    assert said["worst"] > 1000
    assert said["first_s"] == pytest.approx(0.46)
    good = simulate(fall(FLOOR, START, replace(PLAIN_STEP, method="rosenbrock")))
    assert summarise_run(good, [])["integration"]["first_s"] is None
    assert summarise_run(simulate(fall(FLOOR, START), duration=ms(100)), [])["integration"] is None


def test_reports_an_integration_error_in_the_last_step():
    log = simulate(fall(FLOOR, START, PLAIN_STEP), duration=ms(460))
    assert log["world.integration_error"].max() < 1
    assert summarise_run(log, [])["integration"]["first_s"] == pytest.approx(0.46)


@pytest.mark.thorough
def test_error_estimation_leaves_the_run_bit_for_bit_unchanged():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    plain = simulate(scenario, duration=ms(500))
    said = replace(scenario, world=replace(scenario.world, integration=PLAIN_STEP))
    estimated = simulate(said, duration=ms(500))
    assert all(np.array_equal(plain[p], estimated[p]) for p in plain.paths)
    assert set(estimated.paths) - set(plain.paths) == {
        f"world.{name}" for name in ("integration_error", "steps", "step", "events", "crowded")
    }


def test_step_limit_accepts_a_large_error_and_reports_it():
    bounded = simulate(fall(FLOOR, START, Integration(method="rk45", most_steps=5)))
    assert bounded["world.steps"].max() == 5
    assert bounded["world.integration_error"].max() > 1


def bounces(kept, end):
    """Return height, speed and number of bounces of a ball dropped from one metre, in closed form."""
    t, w, n = np.sqrt(2 / G), kept * np.sqrt(2 * G), 1
    while t + 2 * w / G <= end:
        t, w, n = t + 2 * w / G, kept * w, n + 1
    since = end - t
    return w * since - G / 2 * since**2, w - G * since, n


@pytest.mark.thorough("rk45")
@pytest.mark.parametrize("method", ["rk4", "rk45", "rosenbrock"])
def test_bounces_are_located_to_rounding_error(method):
    log = simulate(fall(Ball(), START, Integration(method=method), s=2))
    z, w, n = bounces(0.8, 2.0)
    assert log.final["truth.z"] == pytest.approx(z, abs=1e-12)
    assert log.final["truth.w"] == pytest.approx(w, abs=1e-12)
    assert log["world.events"][-1] == n == 3
    assert log["truth.z"].min() >= -1e-12


@pytest.mark.thorough
def test_events_are_located_without_an_integration_setting():
    log = simulate(fall(Ball(), START, s=2), backend="jax")
    assert log.final["truth.z"] == pytest.approx(bounces(0.8, 2.0)[0], abs=1e-12)
    same = simulate(fall(Ball(), START, PLAIN_STEP, s=2), backend="jax")
    np.testing.assert_array_equal(log["world.integration_error"], same["world.integration_error"])


def test_several_events_in_one_step_are_located_and_overflow_reported():
    low = HeightState(z=5e-6, w=0.0)  # falls for a millisecond; each bounce takes a quarter of the time of the last
    log = simulate(fall(Ball(kept=0.25), low, Integration(), s=0.02))
    assert log["world.events"][-1] == 8
    assert log["world.crowded"].tolist() == [False, True]
    calm = simulate(fall(Ball(kept=0.9), low, Integration(), s=0.02))
    assert calm["world.events"][-1] == bounces_from(5e-6, 0.9, 0.01)
    assert not calm["world.crowded"].any()


@record
class TwoFloors(Ball):
    """The ball of this test, with its events as an array. Source: this test."""

    def events(self, t, x):
        return jnp.stack([x.z + 1.0, x.z])

    def jump(self, t, x, crossed):
        return HeightState(0.0, jnp.where(crossed[1], -self.kept * x.w, x.w))


def test_events_may_be_an_array():
    low, first = HeightState(z=5e-6, w=0.0), PLAIN_STEP.first_report(2e-3)
    ends = [integrate_truth(PLAIN_STEP, ball, None, 0.0, low, 2e-3, first) for ball in (Ball(), TwoFloors())]
    assert [int(report.events) for _, report in ends] == [1, 1]
    assert (float(ends[0][0].z), float(ends[0][0].w)) == (float(ends[1][0].z), float(ends[1][0].w))


def bounces_from(z, kept, end):
    t, w, n = np.sqrt(2 * z / G), kept * np.sqrt(2 * G * z), 0
    while t <= end:
        t, w, n = t + 2 * w / G, kept * w, n + 1
    return n


def test_state_is_normalised_after_each_step():
    wrong, right = (simulate(fall(vehicle, TopState(), s=2)) for vehicle in (Top(), NormalisedTop()))
    assert abs(np.linalg.norm(wrong.final["truth.q"]) - 1) > 1e-4
    assert np.linalg.norm(right.final["truth.q"]) == pytest.approx(1.0, abs=1e-15)
    angle = np.linalg.norm([40.0, -30.0, 20.0])  # rad/s
    assert right.final["truth.q"][0] == pytest.approx(np.cos(angle), abs=0.01)


@record
class NamedTop(Top):
    """The same, with a declared quaternion. Source: this test."""

    QUATERNIONS = ("q",)


@pytest.mark.thorough
@pytest.mark.parametrize("backend", ["c", "jax"])
def test_group_integration_is_exact_and_keeps_unit_quaternions(backend):
    method = Integration(attitude="group")
    log = simulate(fall(NamedTop(), TopState(), method, s=2), backend=backend)
    angle = np.linalg.norm([40.0, -30.0, 20.0])  # rad/s, for 2 s, half of it in q
    axis = np.array([40.0, -30.0, 20.0]) / angle
    assert log.final["truth.q"] == pytest.approx([np.cos(angle), *(np.sin(angle) * axis)], abs=1e-11)
    assert np.linalg.norm(log["truth.q"], axis=1) == pytest.approx(1.0, abs=1e-13)
    assert log["world.integration_error"].max() < 1e-3


def test_rejects_group_integration_without_a_quaternion():
    scenario = fall(Top(), TopState(), Integration(attitude="group"))
    with pytest.raises(InputError, match="needs a vehicle with QUATERNIONS") as refused:
        scenario.check()
    assert "QUATERNIONS" in refused.value.fix
    fall(NamedTop(), TopState(), Integration(attitude="group")).check()


@pytest.mark.thorough
def test_step_doubling_estimates_the_error_of_rk4():
    """The error is zero in free fall and large in the contact; the step equals RK4 bit for bit."""
    doubled = simulate(fall(FLOOR, START, replace(PLAIN_STEP, method="rk4-doubling")), duration=ms(500))
    plain = simulate(fall(FLOOR, START), duration=ms(500))
    assert np.array_equal(doubled["truth.z"], plain["truth.z"])
    error = doubled["world.integration_error"]
    assert error[doubled.t < 0.44].max() < 1e-6
    assert error.max() > 100
    assert summarise_run(doubled, [])["integration"]["first_s"] == pytest.approx(0.46)


@pytest.mark.thorough("contact")
@pytest.mark.parametrize("vehicle", [Ball(), Touching()], ids=["ball", "contact"])
def test_lanes_and_threads_match_single_runs(vehicle):
    scenario = fall(vehicle, START, Integration(method="rosenbrock"), s=0.6)
    heights = np.linspace(0.5, 1.5, 64)
    batch = simulate_batch(scenario, seeds=[0] * 64, spread={"initial.z": heights}, threads=2)
    single = [simulate(replace(scenario, initial=HeightState(z=z))) for z in heights[::21]]
    assert batch.backend == "c lanes"
    for name in ("truth.z", "truth.w"):
        assert batch.final[name][::21].tolist() == [log.final[name] for log in single]


def test_settings_add_a_missing_integration():
    scenario = fall(FLOOR, START)
    assert scenario.world.integration is None
    put = with_settings(scenario, {"world.integration.method": "rosenbrock", "world.integration.relative": "1e-7"})
    assert (put.world.integration.method, put.world.integration.relative) == ("rosenbrock", 1e-7)


@pytest.mark.thorough
def test_rosenbrock_handles_time_dependent_dynamics():
    """The dynamics are evaluated at the time of each stage: a forced oscillator against scipy's Radau."""

    @record
    class Forced(StiffFloor):
        def dynamics(self, t, x, u):
            return HeightState(x.w, 1e4 * (jnp.cos(t) - x.z) - 200 * x.w)

    log = simulate(fall(Forced(), HeightState(z=1.0), Integration(method="rosenbrock"), s=1), backend="jax")
    y = solve_ivp(lambda t, y: [y[1], 1e4 * (np.cos(t) - y[0]) - 200 * y[1]], (0, 1), [1, 0], "Radau", rtol=1e-11)
    assert log.final["truth.z"] == pytest.approx(y.y[0, -1], abs=1e-6)
    assert to_seconds(log.ticks[-1]) == pytest.approx(0.99)
