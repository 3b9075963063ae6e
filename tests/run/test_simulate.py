"""simulate: errors before the run, determinism, batches equal to single runs, contents of the log."""

import importlib
import pickle
from typing import Any

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record, replace
from trimtab.core.signals import Estimate
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.latency_trace import LatencyTrace, read_trace
from trimtab.links.wire import Wire
from trimtab.loop.world import World
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue
from trimtab.sensors.navigation_errors import NavigationErrors, PlanarNavigation

simulate_module = importlib.import_module("trimtab.run.simulate")
needs_c = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


@pytest.fixture(scope="module")
def short():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    return replace(scenario, duration=seconds(1))


def test_same_seed_repeats_exactly_and_other_seed_differs(short):
    a, b, c = simulate(short, seed=5), simulate(short, seed=5), simulate(short, seed=6)
    np.testing.assert_array_equal(a["truth.yaw_rate"], b["truth.yaw_rate"])
    assert (a["truth.yaw_rate"] != c["truth.yaw_rate"]).any()


def assert_equal_logs(a, b):
    assert a.paths == b.paths
    for path in a.paths:
        assert a[path].dtype == b[path].dtype
        np.testing.assert_array_equal(a[path], b[path], err_msg=path)
    np.testing.assert_array_equal(a.ticks, b.ticks)
    np.testing.assert_array_equal(a.t, b.t)
    assert dict(a.final) == dict(b.final)
    assert dict(a.declarations) == dict(b.declarations)
    assert dict(a.metadata) == dict(b.metadata)


@pytest.fixture
def compiled_count(monkeypatch):
    """Count how often simulate compiles a scenario or looks for a cached one."""
    count = []
    compile_scenario = simulate_module.compile_scenario

    def counted(*arguments, **options):
        count.append(1)
        return compile_scenario(*arguments, **options)

    monkeypatch.setattr(simulate_module, "compile_scenario", counted)
    return count


@pytest.mark.thorough
@needs_c
def test_scenario_is_compiled_once(short, compiled_count):
    scenario = replace(short, duration=seconds("0.2"))
    logs = [simulate(scenario, seed=seed, log_period=ms(period)) for seed, period in ((1, 1), (2, 10), (1, 1))]
    assert len(compiled_count) == 1
    assert_equal_logs(logs[0], logs[2])
    assert_equal_logs(logs[1], simulate(replace(scenario), seed=2, log_period=ms(10)))
    assert len(compiled_count) == 2
    assert simulate(scenario, duration=seconds("0.1")).ticks[-1] < seconds("0.1")
    assert simulate(scenario, signals=("truth",)).paths[0] == "truth.surge_velocity"
    assert len(simulate(scenario)) == 200
    assert len(compiled_count) == 4


@pytest.mark.thorough
@needs_c
def test_changes_to_a_scenario_take_effect(short, compiled_count):
    angles = np.array(short.world.actuators.rudder.angles)
    rudder = replace(short.world.actuators.rudder, angles=angles)
    sensors = dict(short.world.sensors)
    world = replace(short.world, actuators=replace(short.world.actuators, rudder=rudder), sensors=sensors)
    scenario = replace(short, world=world, duration=seconds(7))
    before = simulate(scenario)
    angles *= 1.01
    turned = simulate(scenario)
    fresh = replace(scenario, world=replace(world, actuators=replace(world.actuators, rudder=replace(rudder))))
    assert_equal_logs(turned, simulate(fresh))
    assert (turned["truth.heading"] != before["truth.heading"]).any()
    sensors["navigation"] = replace(sensors["navigation"], period=ms(8))
    slower = simulate(scenario)
    assert_equal_logs(slower, simulate(replace(scenario, world=replace(world, sensors=dict(sensors)))))
    assert slower.metadata["parameters"]["world.sensors.navigation.period"] == ms(8)
    assert len(compiled_count) == 5


@needs_c
def test_logs_share_no_mutable_data(short):
    first, second = (simulate(short, seed=1, duration=seconds("0.1")) for _ in range(2))
    first.metadata["parameters"]["world.actuators.rudder.angles"][0] = 99.0
    del first.metadata["parts"]["world"]
    assert second.metadata["parameters"]["world.actuators.rudder.angles"][0] != 99.0
    third = simulate(short, seed=1, duration=seconds("0.1"))
    assert_equal_logs(second, third)
    for array in (first.t, first.ticks, first["truth.heading"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    for array in (first.t, first.ticks):
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.setflags(write=True)


@needs_c
def test_simulate_many_equals_single_runs_bit_for_bit(short):
    many = simulate_many(short, seeds=[3, 9, 4], log_period=ms(1), duration=seconds("0.3"))
    for log, seed in zip(many, (3, 9, 4), strict=True):
        assert_equal_logs(log, simulate(short, seed=seed, duration=seconds("0.3")))
        copy = pickle.loads(pickle.dumps(log))
        assert_equal_logs(log, copy)


def test_simulate_many_matches_its_single_runs(short):
    batch = simulate_many(short, seeds=[3, 9], log_period=ms(1))
    for log, seed in zip(batch, (3, 9), strict=True):
        alone = simulate(short, seed=seed)
        np.testing.assert_allclose(log["truth.sway_velocity"], alone["truth.sway_velocity"], rtol=0, atol=1e-12)
        assert log.metadata["seed"] == seed


@pytest.mark.thorough
def test_disabling_one_imperfection_keeps_the_noise_of_others(short):
    """Random streams belong to the path of a part, so two runs differ only by the imperfection."""
    real, prompt = simulate(short), simulate(short.without("uplink-delay"))
    error = [log["sensors.navigation.value.yaw_rate"] - log["truth.yaw_rate"] for log in (real, prompt)]
    due = real.ticks % ms(6) == 0
    np.testing.assert_allclose(error[0][due], error[1][due], atol=1e-12)


def test_loop_delay_is_76_ms(short):
    """The age of what acts is 36 ms of downlink, 40 ms of uplink, and the waits for the next sample."""
    log = simulate(short)
    late = log.t > 0.2
    age_down, age_up = log["downlink.navigation.age"][late], log["uplink.age"][late]
    assert age_down.min() == pytest.approx(0.036)
    assert age_down.max() == pytest.approx(0.041)
    assert age_up.min() == pytest.approx(0.040)
    assert age_up.max() == pytest.approx(0.059)
    first_command = log.t[log["command.valid"].argmax()]
    first_action = log.t[log["uplink.valid"].argmax()]
    assert first_command == pytest.approx(0.036)
    assert first_action == pytest.approx(0.080)  # sampled at 40 ms, two periods of 20 ms


def test_selects_signals_and_rejects_unknown_ones(short):
    log = simulate(short, signals=("truth.yaw_rate", "law"))
    assert set(log.paths) == {"truth.yaw_rate", "law.demand.FX", "law.demand.FY", "law.lyapunov"}
    with pytest.raises(InputError, match=r"truth\.yaw_rate"):
        simulate(short, signals=("truth.yaw",))


def test_final_state_is_the_truth_after_the_last_step(short):
    log = simulate(short)
    step = log["truth.heading"][-1] - log["truth.heading"][-2]
    assert log.final["truth.heading"] == pytest.approx(log["truth.heading"][-1] + step, abs=1e-4)
    assert log.t[-1] == pytest.approx(0.999)


@pytest.mark.thorough
def test_incommensurate_periods_are_all_simulated(short):
    """1 ms control, 6.5536 ms sampling, 20 ms frames."""
    sensors = {"navigation": NavigationErrors(period=65536)}
    odd = replace(
        short, world=replace(short.world, sensors=sensors, downlink=replace(short.world.downlink, period=65536))
    )
    log = simulate(odd, log_period=1)
    assert (np.diff(log.ticks) > 0).all()
    assert set(range(0, seconds(1), 65536)) <= set(log.ticks.tolist())
    fresh = log.ticks[log["sensors.navigation.fresh"]]
    np.testing.assert_array_equal(fresh, np.arange(0, seconds(1), 65536))


@record
class Counted:
    """States for the law, and the number of fresh samples. Source: this test."""

    surge_velocity: Any = quantity("m/s", "Along x.")
    sway_velocity: Any = quantity("m/s", "Along y.")
    yaw_rate: Any = quantity("rad/s", "Rate of turn.")
    heading: Any = quantity("rad", "Heading.", kind="angle")
    fresh: Any = quantity("1", "Samples seen for the first time.", kind="count")


@record
class Counting:
    """An estimator that passes its sensor on and counts samples. Source: this test."""

    listens = ("navigation",)

    def init(self, key):
        return np.int32(0)

    def step(self, t, state, frame):
        sample = frame.samples["navigation"]
        state = state + sample.fresh.astype(np.int32)
        z = sample.value
        told = Counted(z.surge_velocity, z.sway_velocity, z.yaw_rate, z.heading, state)
        return state, Estimate(t=t, age=sample.age, fresh=sample.fresh, valid=sample.valid, state=told)


@pytest.mark.thorough
@pytest.mark.parametrize("backend", ["c", "jax"])
@pytest.mark.parametrize("wire", [ms(1), 65536, ms(3)])
def test_estimator_receives_each_sample_as_fresh_once(short, wire, backend):
    """With different periods of IMU, wire and autopilot, no sample is lost or counted twice."""
    world = replace(short.world, sensors={"navigation": NavigationErrors(period=65536)}, downlink=Wire(period=wire))
    counted = replace(short, world=world, autopilot=replace(short.autopilot, estimator=Counting()))
    log = simulate(counted, backend=backend)
    taken = np.arange(0, seconds(1), 65536)
    arrived = -(-taken // wire) * wire
    acted_on = -(-arrived // ms(1)) * ms(1)
    seen = [int(np.sum(acted_on <= t)) for t in log.ticks]
    np.testing.assert_array_equal(log["estimate.state.fresh"], seen)


@record
class Climb:
    """A law for aircraft. Source: this test."""

    reads = ("surge_velocity", "pitch")

    def init(self, key):
        return ()

    def step(self, t, state, estimate):
        raise AssertionError("refused before it is stepped")


def test_rejects_a_law_that_reads_a_missing_state(short):
    wrong = replace(short, autopilot=replace(short.autopilot, law=Climb()))
    with pytest.raises(
        InputError, match=r"Climb reads 'pitch', which the estimate of Passthrough does not contain(.|\n)*yaw_rate"
    ):
        simulate(wrong)


def test_rejects_an_estimator_that_reads_a_missing_sensor(short):
    wrong = replace(short, autopilot=replace(short.autopilot, estimator=Passthrough("compass")))
    with pytest.raises(InputError, match=r"reads sensor 'compass', but the world sends only \(navigation\)"):
        simulate(wrong)


def test_rejects_duplicate_sensor_names(short):
    pairs = [("navigation", NavigationErrors()), ("navigation", PlanarNavigation())]
    w = short.world
    with pytest.raises(InputError, match="two sensors are named 'navigation': NavigationErrors and PlanarNavigation"):
        World(w.vehicle, pairs, w.actuators, w.downlink, w.uplink)


def test_accepts_sensors_as_pairs(short):
    w = short.world
    world = World(w.vehicle, [("navigation", NavigationErrors())], w.actuators, w.downlink, w.uplink)
    assert simulate(replace(short, world=world)).final == simulate(short).final


def test_rejects_mismatched_initial_state(short):
    crooked = replace(short, initial=short.world.vehicle)
    with pytest.raises(InputError, match="does not fit"):
        simulate(crooked)


@pytest.mark.thorough
def test_recorded_latency_trace_is_replayed_from_its_file(short, tmp_path):
    file = tmp_path / "trace.csv"
    file.write_text("sent_s,latency_s\n0.0,0.010\n0.02,0.025\n0.04,0.015\n")
    link = LatencyTrace.of(read_trace(file))
    log = simulate(replace(short, world=replace(short.world, uplink=link)))
    ages = log["uplink.age"][log["uplink.fresh"]]
    assert set(np.round(ages, 6)) == {0.010, 0.025, 0.015}


@pytest.mark.parametrize(
    "rows", ["", "sent_s,latency_s\n", "sent_s,latency_s\n0,fast\n1,2\n", "sent_s,latency_s\n1,0.1\n0,0.1\n"]
)
def test_invalid_trace_file_error_names_the_file(rows, tmp_path):
    file = tmp_path / "trace.csv"
    file.write_text(rows)
    with pytest.raises(InputError, match=r"trace\.csv"):
        read_trace(file)


@pytest.mark.parametrize("value", [1.5, "1", True, -1, 2**32, np.float64(2)])
@pytest.mark.parametrize("name", ["seed", "run"])
def test_rejects_a_seed_or_run_that_is_not_a_valid_integer(short, name, value):
    with pytest.raises(InputError, match="must be a whole number") as refused:
        simulate(short, **{name: value})
    assert refused.value.part == name


@pytest.mark.parametrize("value", ["0 s", "-1 ms", 0, "2 s"])
def test_rejects_a_log_period_without_rows(short, value):
    with pytest.raises(InputError, match="must be above 0 s"):
        simulate(short, log_period=value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: replace(s, duration=10), "less than any period"),
        (lambda s: replace(s, autopilot=replace(s.autopilot, period=20)), "too short"),
        (lambda s: replace(s, world=replace(s.world, uplink=Wire(period=50))), "too short"),
    ],
)
def test_rejects_integers_meant_as_seconds(short, change, said):
    with pytest.raises(InputError, match=said):
        simulate(change(short))


def test_rejects_an_invalid_log_period_before_compiling(short, monkeypatch):
    monkeypatch.setattr(simulate_module, "compile_scenario", lambda *_, **__: pytest.fail("compiled"))
    for period in (0, "2 s"):
        with pytest.raises(InputError, match="log_period: must be above 0 s and at most the flight's 1 s"):
            simulate(short, log_period=period)
