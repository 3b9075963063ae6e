"""Queue of received samples: one sample per step, each once, with limited delay. A fake step records its inputs."""

from types import SimpleNamespace

import numpy as np
import pytest
from flight.mavlink.line import every
from run.stand_ins import Step, dialect, ends
from scipy.spatial.transform import Rotation

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.signals import Command
from trimtab.flight.autopilot_end import AutopilotEnd, frame_log_path, scenario_dialect
from trimtab.flight.sample_queue import FEWEST_STEPS, LONGEST_BACKLOG, LONGEST_QUEUE, MOST_FALLS, OTHER_CLOCK
from trimtab.logs.frames import no_pose
from trimtab.run.blocks import compile_autopilot
from trimtab.scenarios.build import build

FRAME, DIALECT = dialect({"compass": every(), "inertial-unit": every()}, every())
MS = 10_000


class Line:
    """A vehicle that sends samples, and an autopilot end that receives them."""

    def __init__(self, any_order=(), period=MS, clock=None):
        self.step = Step(FRAME, Command(t=np.int64(0), valid=False, value=every()))
        estimator = SimpleNamespace(listens=any_order, ANY_ORDER=bool(any_order))
        scenario = SimpleNamespace(autopilot=SimpleNamespace(estimator=estimator, monitor=None, period=period))
        self.pilot, self.ends = AutopilotEnd(scenario, DIALECT, self.step, clock), ends(DIALECT)
        self._vector = np.zeros(len(self.step.inputs))

    def send(self, sensor, t, real):
        reads = self.step.reads
        path = f"samples.{sensor}"
        self._vector[reads[f"{path}.t"]], self._vector[reads[f"{path}.valid"]] = t, 1
        self._vector[reads[f"{path}.value.real"]] = real
        packets = self.pilot.sensors[sensor].pack(self.ends.there, self._vector)
        for message in (m for p in packets for m in self.ends.here.feed(p)):
            assert self.pilot.handle_message(message)

    def seen(self, sensor, *names):
        return [tuple(s[f"samples.{sensor}.{n}"] for n in names) for s in self.step.seen]


def test_burst_is_delivered_one_sample_per_step_in_order():
    line = Line()
    for k in range(3):
        line.send("compass", k * MS, float(k + 1))
    line.send("inertial-unit", 2 * MS, 9.0)
    for k in range(5):
        line.pilot.fly_period((10 + k) * MS)
    assert line.seen("compass", "value.real", "fresh") == [(1.0, 1), (2.0, 1), (3.0, 1), (3.0, 0), (3.0, 0)]
    assert line.seen("inertial-unit", "value.real", "fresh")[:2] == [(9.0, 1), (9.0, 0)]
    ages = [age for (age,) in line.seen("compass", "age")]
    assert ages == pytest.approx([0.010, 0.010, 0.010, 0.011, 0.012])
    assert [s["t"] for s in line.step.seen] == [(10 + k) * MS for k in range(5)]


def test_duplicate_sample_is_counted_once():
    line = Line()
    for _ in range(2):
        line.send("compass", 5 * MS, 1.0)
    assert (line.pilot.counts.received, line.pilot.queue_length) == (1, 1)


def test_overtaken_samples_reach_only_out_of_order_estimators():
    """A sample that is older by more than half a second is dropped."""
    line = Line(any_order=("inertial-unit",))
    for sensor in ("compass", "inertial-unit"):
        for k in (600, 602, 601, 603, 50, 604):
            line.send(sensor, k * MS, float(k))
    for k in range(6):
        line.pilot.fly_period((700 + k) * MS)
    new = {s: [v for v, fresh in line.seen(s, "value.real", "fresh") if fresh] for s in ("compass", "inertial-unit")}
    assert new == {"compass": [600, 602, 603, 604], "inertial-unit": [600, 602, 601, 603, 604]}
    assert line.pilot.counts.overtaken == 4


def test_only_consecutive_old_samples_indicate_another_clock():
    line = Line()
    for k in range(50):
        line.send("compass", (1000 + 6 * k) * MS, 0.0)
        line.send("compass", (500 - k) * MS, 1.0)
    assert (line.pilot.counts.received, line.pilot.counts.overtaken) == (50, 50)
    for k in range(OTHER_CLOCK + 4):
        line.send("compass", (10 + 6 * k) * MS, 2.0)
    assert (line.pilot.counts.received, line.pilot.counts.overtaken) == (56, 56)


def test_full_queue_drops_and_counts_oldest_samples():
    line = Line()
    for k in range(LONGEST_QUEUE + 3):
        line.send("compass", (k + 1) * MS, float(k))
    assert line.pilot.counts.dropped == 3
    line.pilot.fly_period(100 * MS)
    assert line.seen("compass", "value.real") == [(3.0,)]


def test_backlog_is_dropped_when_sample_rate_equals_step_rate():
    """A burst of five, then one sample per step. Without dropping, all samples would stay five steps late."""
    steps = LONGEST_BACKLOG // MS
    line = Line()
    for k in range(5):
        line.send("compass", k * MS, 0.0)
    for k in range(5, 2 * steps):
        line.send("compass", k * MS, 0.0)
        line.pilot.fly_period(k * MS)
    late = [round(age * 1e3) for (age,) in line.seen("compass", "age")]
    assert late[steps // 2] == 5
    assert set(late[-steps // 2 :]) == {0}
    assert line.pilot.counts.dropped == 5


def test_slow_loop_drops_its_backlog_within_few_steps():
    """At twenty steps a second the initial backlog would otherwise last for a quarter of a minute."""
    slow, line = 50 * MS, Line(period=50 * MS)
    for k in range(6):
        line.send("compass", k * slow, 0.0)
    for k in range(6, 40):
        line.send("compass", k * slow, 0.0)
        line.pilot.fly_period(k * slow)
    late = [round(age * 1e3) for (age,) in line.seen("compass", "age")]
    assert late[FEWEST_STEPS - 1] == 300
    assert set(late[FEWEST_STEPS + 1 :]) == {0}
    assert line.pilot.counts.dropped == 6


def test_sample_times_are_converted_while_clock_offset_changes():
    offset = 7_000_000
    clock = SimpleNamespace(accepts=lambda t: True, to_local=lambda t: t - offset)
    line = Line(clock=clock)
    line.send("compass", offset + 3 * MS, 1.0)
    line.pilot.fly_period(5 * MS)
    assert line.seen("compass", "t", "fresh") == [(3 * MS, 1)]
    line.send("compass", offset + 4 * MS, 2.0)
    clock.to_local = lambda t: t - offset - 100
    line.pilot.fly_period(6 * MS)
    assert line.seen("compass", "t")[-1] == (4 * MS - 100,)


@pytest.mark.parametrize("wrong", [-2 * MS, 490 * MS, 36_000_000_000, 2**62])
def test_implausible_sample_time_loses_only_that_sample(wrong):
    line = Line(clock=SimpleNamespace(accepts=lambda t: t in (3 * MS, 6 * MS), to_local=lambda t: t))
    line.send("compass", 3 * MS, 1.0)
    line.pilot.fly_period(4 * MS)
    line.send("compass", 4 * MS + wrong, 2.0)
    line.pilot.fly_period(5 * MS)
    line.send("compass", 6 * MS, 3.0)
    line.pilot.fly_period(7 * MS)
    assert line.seen("compass", "value.real", "fresh") == [(1.0, 1), (1.0, 0), (3.0, 1)]
    assert (line.pilot.counts.implausible, line.pilot.counts.overtaken) == (1, 0)


def test_samples_before_the_flight_are_dropped():
    line = Line()
    line.send("compass", MS, 1.0)
    line.pilot.drop_samples()
    line.pilot.fly_period(2 * MS)
    assert line.seen("compass", "fresh") == [(0,)]


def test_commands_carry_the_vehicles_time():
    line = Line()
    writes, outputs = line.step.writes, line.step.outputs
    outputs[writes["command.t"]], outputs[writes["command.value.real"]] = 5 * MS, 2.5
    assert not line.pilot.has_command
    outputs[writes["command.valid"]] = 1
    assert line.pilot.has_command
    (packet,) = line.pilot.command_packets(line.ends.here, shift=111)
    (message,) = line.ends.there.feed(packet)
    assert message.name == DIALECT.groups["command"][0]
    assert not line.pilot.handle_message(message)
    assert (message.get("t"), message.get("valid"), message.get("real")) == (5 * MS + 111, 1, 2.5)


def test_frame_paths_match_those_of_a_simulation_log():
    assert frame_log_path("samples.inertial-unit.t") == "downlink.inertial-unit.t"
    assert frame_log_path("t") is None


def test_sensor_with_backward_time_stamps_is_rejected_and_counted():
    """Regression: the samples were counted as overtaken, and one was accepted each half second."""
    line = Line()
    for k in range(200):
        line.send("compass", (1000 - 10 * k) * MS, 1.0)
    assert line.pilot.counts.received == 1
    assert (line.pilot.counts.overtaken, line.pilot.counts.backward) == (0, 199)
    assert line.pilot.backward_sensors == ["compass"]
    line.send("compass", 1010 * MS, 2.0)
    assert (line.pilot.backward_sensors, line.pilot.counts.received) == ([], 2)


def test_few_reordered_samples_are_not_a_backward_clock():
    line = Line()
    for t in (10, *range(10 - 1, 10 - MOST_FALLS, -1), 11):
        line.send("compass", t * MS, 1.0)
    assert (line.pilot.counts.overtaken, line.pilot.counts.backward) == (MOST_FALLS - 1, 0)
    assert line.pilot.backward_sensors == []


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_pose_of_3d_estimate_holds_position_and_euler_angles():
    scenario = build("quadrotor/track")
    end = AutopilotEnd(scenario, scenario_dialect(scenario), compile_autopilot(scenario))
    w, x, y, z = np.sin([0.3, 0.5, 0.7, 1.1])
    end.step.outputs[end.step.writes["estimate.state.attitude"]] = 2 * w, 2 * x, 2 * y, 2 * z  # of any length
    end.step.outputs[end.step.writes["estimate.state.position"]] = 1.0, 2.0, -3.0
    pose = no_pose()
    end.pose.fill(pose)
    assert pose[:3].tolist() == [1.0, 2.0, -3.0]
    assert pose[3:6] == pytest.approx(Rotation.from_quat([x, y, z, w]).as_euler("ZYX")[::-1])
    assert np.isnan(pose[6:]).all()
