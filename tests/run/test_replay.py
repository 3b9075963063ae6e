"""Recorded runs are replayed from their frames: exactly, or with the first difference named."""

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.estimators.passthrough import Passthrough
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.run.replay import describe_replay, first_bit_difference, replay
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue
from trimtab.scenarios.recorded import rebuild_scenario

compiled = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
NAVIGATION = ("errors", "ins", "ins-magnetometer", "ins-coupled")
RUNS = [
    *[(f"hovercraft/{n}", {"navigation": k}) for n in ("zero-velocity", "spin") for k in NAVIGATION],
    ("hovercraft/forward", {"links": "measured"}),
    ("hovercraft/reverse", {"navigation": "ins"}),
    ("hovercraft/heading-bang-bang", {"initial": "rest"}),
    ("hovercraft/heading-proportional", {"initial": "moving", "links": "measured"}),
    *[("navigation/platform-encoder", {"form": f}) for f in ("feedforward", "feedback", "direct", "coupled")],
    ("navigation/platform-magnetometer", {}),
    ("navigation/platform-ranging", {"beacons": "3"}),
    ("navigation/platform-cricket", {"stamped": "arrival"}),
    ("navigation/still", {}),
]


def recorded(folder, name, settings, seed=3, run=0, duration=10_000_000, backend="c") -> Log:
    """Return a run as read from its file."""
    scenario, _ = catalogue.load_scenario(name, settings)
    log = simulate(
        scenario, seed=seed, run=run, duration=duration, log_period=scenario.autopilot.period, backend=backend
    )
    return read_mcap(write_mcap(log, folder / "run.mcap"))


def with_signal(log: Log, path: str, values: np.ndarray) -> Log:
    signals = {**log.signals, path: values}
    return Log(log.t, log.ticks, signals, log.declarations, log.metadata, log.final)


def flipped(log: Log, path: str, row: int, bit: int) -> Log:
    """Return a log with one bit of one number flipped."""
    values = log[path].copy()
    values[row : row + 1].view(np.uint64)[0] ^= np.uint64(1 << bit)
    return with_signal(log, path, values)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    log = recorded(tmp_path_factory.mktemp("flight"), "hovercraft/zero-velocity", {"links": "measured"})
    return log, rebuild_scenario(log)


def check_exact(log):
    again = replay(log, rebuild_scenario(log), backend="c")
    assert again.strict
    assert again.exact, again.first
    assert again.equal
    assert len(again.recorded_log) == len(log)
    paths = {p for p in log.paths if p.startswith(("estimate.", "law.", "command."))}
    assert set(again.recorded_log.paths) == paths == set(again.replayed_log.paths)
    for path in paths:
        np.testing.assert_array_equal(again.replayed_log[path], log[path])


@compiled
def test_run_replays_bit_for_bit(flight):
    check_exact(flight[0])


@compiled
@pytest.mark.thorough
@pytest.mark.parametrize("k", range(len(RUNS)))
def test_twenty_runs_replay_bit_for_bit(tmp_path, k):
    assert len(RUNS) == 20
    check_exact(recorded(tmp_path, *RUNS[k], seed=k, run=k % 3))


@pytest.mark.thorough
@compiled
@pytest.mark.parametrize(
    ("path", "row", "bit"),
    [("estimate.state.yaw_rate", 700, 0), ("law.demand.FY", 123, 63), ("command.value.speed_rpm", 0, 51)],
)
def test_flipped_output_bit_is_located_and_named(flight, path, row, bit):
    log, scenario = flight
    wrong = flipped(log, path, row, bit)
    found = replay(wrong, scenario, backend="c")
    assert not found.exact
    assert not found.equal
    assert found.first is not None
    assert (found.first.t, found.first.path) == (log.t[row], path)
    assert (found.first.recorded, found.first.replayed) == (wrong[path][row], log[path][row])
    assert path in describe_replay(found)


@pytest.mark.thorough
@compiled
def test_flipped_input_bit_is_located_at_first_use(flight):
    log, scenario = flight
    path = "downlink.navigation.value.yaw_rate"
    row = int(np.flatnonzero(log["downlink.navigation.valid"])[40])
    found = replay(flipped(log, path, row, 0), scenario, backend="c")
    assert found.first is not None
    assert (found.first.t, found.first.path) == (log.t[row], "estimate.state.yaw_rate")
    assert found.first.replayed == flipped(log, path, row, 0)[path][row]


@compiled
def test_boolean_signals_are_compared(flight):
    log, scenario = flight
    wrong = log["estimate.valid"].copy()
    wrong[500] = ~wrong[500]
    found = replay(with_signal(log, "estimate.valid", wrong), scenario, backend="c")
    assert found.first is not None
    assert (found.first.t, found.first.path) == (log.t[500], "estimate.valid")


@compiled
def test_replay_on_another_backend_agrees_within_the_tolerance(flight):
    log, scenario = flight
    found = replay(log, scenario, backend="jax")
    assert found.equal
    assert not found.strict
    assert max(found.worst.values()) < 1e-12
    wrong = flipped(log, "law.demand.FX", 300, 30)  # 2**-22 of it
    found = replay(wrong, scenario, backend="jax")
    assert not found.equal
    assert found.first is not None
    assert (found.first.t, found.first.path) == (log.t[300], "law.demand.FX")


@pytest.mark.thorough
def test_jax_replays_its_own_run_exactly(tmp_path):
    log = recorded(tmp_path, "hovercraft/spin", {}, duration=ms(200), backend="jax")
    found = replay(log, rebuild_scenario(log), backend="jax")
    assert found.strict
    assert found.exact


@compiled
def test_log_of_another_machine_allows_rounding_differences(flight):
    log, scenario = flight
    elsewhere = Log(log.t, log.ticks, log.signals, log.declarations, {**log.metadata, "machine": "other"}, log.final)
    found = replay(flipped(elsewhere, "law.demand.FX", 300, 0), scenario, backend="c")
    assert (found.strict, found.exact, found.equal) == (False, False, True)


@compiled
def test_truncated_log_replays_up_to_the_cut(flight, tmp_path):
    log, _ = flight
    data = write_mcap(log, tmp_path / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    cut = read_mcap(tmp_path / "cut.mcap")
    assert 0 < len(cut) < len(log)
    found = replay(cut, rebuild_scenario(cut), backend="c")
    assert found.exact
    assert len(found.replayed_log) == len(cut)
    assert "cut off at" in found.end_reason


@compiled
def test_accepts_finer_log_rows_and_rejects_coarser_rows(flight):
    log, scenario = flight
    rows = np.repeat(np.arange(len(log)), 2)
    ticks = log.ticks[rows] + np.tile([0, 1234], len(log))
    fine = Log(ticks * 1e-7, ticks, {p: v[rows] for p, v in log.signals.items()}, log.declarations, log.metadata)
    found = replay(fine, scenario, backend="c")
    assert found.exact
    assert len(found.replayed_log) == len(log)
    coarse = {p: v[::2] for p, v in log.signals.items()}
    with pytest.raises(InputError, match='log_period="1 ms"'):
        replay(Log(log.t[::2], log.ticks[::2], coarse, log.declarations, log.metadata), scenario, backend="c")


@compiled
def test_flight_log_replays_up_to_its_first_gap(flight):
    """The rows of a flight are its steps; counters mark missing rows."""
    log, scenario = flight
    kept = np.delete(np.arange(len(log)), slice(400, 450))
    signals = {p: v[kept] for p, v in log.signals.items()}
    signals["log.dropped"] = np.where(np.arange(len(kept)) < 400, 0, 50)
    found = replay(Log(log.t[kept], log.ticks[kept], signals, log.declarations, log.metadata), scenario, backend="c")
    assert found.exact
    assert len(found.replayed_log) == 400
    assert "lacks steps after 0.399 s" in found.end_reason


def test_rejects_logs_that_cannot_be_replayed(flight):
    log, scenario = flight
    with pytest.raises(InputError, match=r"begins at 0\.5 s"):
        replay(log.between(0.5, 1.0), scenario)
    with pytest.raises(InputError, match="contains no control step"):
        replay(log.between(5.0, 6.0), scenario)
    few = {p: v for p, v in log.signals.items() if not p.endswith("yaw_rate")}
    with pytest.raises(InputError, match=r"lacks 'downlink\.navigation\.value\.yaw_rate'"):
        replay(Log(log.t, log.ticks, few, log.declarations, log.metadata), scenario)
    few = {p: v for p, v in log.signals.items() if p.startswith("downlink.")}
    for about, fix in (({}, "log all signals"), ({"side": "vehicle"}, r"flight\.mcap, written by trimtab fly")):
        with pytest.raises(InputError, match=rf"no outputs of an autopilot(.|\n)*Fix: .*{fix}"):
            replay(Log(log.t, log.ticks, few, log.declarations, log.metadata | about), scenario)


@compiled
def test_replays_recorded_frames_with_another_autopilot(flight):
    log, scenario = flight
    law = replace(scenario.autopilot.law, k1=2 * scenario.autopilot.law.k1)
    found = replay(log, scenario, autopilot=replace(scenario.autopilot, law=law), backend="c")
    assert (found.changed, found.first, found.equal) == (True, None, True)
    np.testing.assert_array_equal(found.replayed_log["estimate.state.heading"], log["estimate.state.heading"])
    assert not np.array_equal(found.replayed_log["law.demand.FX"], log["law.demand.FX"])
    with pytest.raises(InputError, match="reads sensor 'compass'"):
        replay(log, scenario, autopilot=replace(scenario.autopilot, estimator=Passthrough("compass")), backend="c")


def test_bit_comparison_distinguishes_negative_zero_but_not_nan():
    ticks = np.arange(4)
    one = Log(ticks * 1e-7, ticks, {"a.x": np.array([0.0, np.nan, 1.0, 2.0]), "a.n": np.array([1, 2, 3, 4])})
    assert first_bit_difference(one, one) is None
    zero = with_signal(one, "a.x", np.array([-0.0, np.nan, 1.0, 2.0]))
    found = first_bit_difference(one, zero)
    assert found is not None
    assert (found.t, found.path) == (0.0, "a.x")
    later = with_signal(with_signal(one, "a.x", np.array([0.0, np.nan, 1.0, 3.0])), "a.n", np.array([1, 2, 0, 4]))
    found = first_bit_difference(one, later)
    assert found is not None
    assert (found.t, found.path, found.recorded, found.replayed) == (2e-7, "a.n", 3.0, 0.0)


def test_boolean_difference_at_the_first_step_is_reported(flight):
    log, scenario = flight
    found = replay(with_signal(log, "command.valid", ~log["command.valid"]), scenario)
    assert not found.equal
    assert found.first is not None
    assert (found.first.t, found.first.path) == (0.0, "command.valid")
