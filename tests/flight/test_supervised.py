"""The supervisor of a compiled step: requests during a flight on frames set by the test."""

from types import SimpleNamespace

import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms
from trimtab.flight.supervised import CompiledSupervisor, explain_change
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.supervisor import MODES
from trimtab.run.blocks import compile_autopilot
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


@pytest.fixture(scope="module")
def scenario():
    return add_pilot_sensor(catalogue.load_scenario("hovercraft/forward", {"supervisor": "automatic"})[0])


@pytest.fixture(scope="module")
def compiled(scenario):
    return compile_autopilot(scenario)


class Flight:
    """A flight with valid samples each 6 ms and requests to the supervisor."""

    def __init__(self, scenario, step):
        step.reset()
        step.inputs[:] = 0
        self.step, self.supervised, self.k = step, CompiledSupervisor(scenario, step), 0

    def fly(self, n):
        """Fly n periods. Return the modes by name."""
        found = []
        for _ in range(n):
            t = self.k * ms(1)
            fresh = self.k % 6 == 0
            self.step.set_inputs({"t": t, "samples.navigation.fresh": fresh, "samples.navigation.valid": True})
            if fresh:
                self.step.set_inputs({"samples.navigation.t": t})
            self.supervised.set_inputs(t)
            self.step.step()
            found.append(MODES[self.supervised.mode])
            self.k += 1
        return found


@pytest.fixture
def flight(scenario, compiled):
    made = Flight(scenario, compiled)
    assert made.fly(20)[-1] == "flying"
    return made


def test_hold_resume_and_end_requests_act_in_next_step(flight):
    step, at = flight.step, flight.step.writes
    for request, mode in (("hold", "hold"), ("resume", "flying"), ("end", "ended")):
        flight.supervised.request(request)
        assert flight.fly(5) == [mode] * 5
        assert step.inputs[step.reads["samples.pilot.t"]] == (flight.k - 5) * ms(1)
        assert step.inputs[step.reads["samples.pilot.age"]] == pytest.approx(4e-3)
    assert step.outputs[at["supervisor.refusals"]] == 0
    assert step.outputs[at["command.valid"]] == 0


def test_repeated_requests_are_not_passed_on(flight):
    for _ in range(3):
        flight.supervised.request("hold")
        assert flight.fly(2) == ["hold", "hold"]
    flight.supervised.request("resume")
    flight.fly(1)
    flight.supervised.request("resume")
    assert flight.fly(2) == ["flying", "flying"]
    assert flight.step.outputs[flight.step.writes["supervisor.refusals"]] == 0


def test_mode_changes_are_reported_once(flight):
    assert flight.supervised.describe_changes() == "supervisor: flying: automatic"
    flight.supervised.request("hold")
    assert flight.supervised.describe_changes() == ""
    flight.fly(1)
    assert flight.supervised.describe_changes() == "supervisor: hold: hold request"
    assert flight.supervised.describe_changes() == ""


def test_requests_are_ignored_without_a_supervisor():
    scenario = add_pilot_sensor(catalogue.load_scenario("hovercraft/forward")[0])
    assert "pilot" not in scenario.world.sensors
    step = compile_autopilot(scenario)
    supervised = CompiledSupervisor(scenario, step)
    supervised.request("hold")
    before = step.inputs.copy()
    supervised.set_inputs(ms(5))
    assert (step.inputs == before).all()
    assert (supervised.mode, supervised.describe_changes()) == (None, "")


def vehicle(*, armed=True, is_in_failsafe=False):
    return SimpleNamespace(arming=SimpleNamespace(armed=armed, is_in_failsafe=is_in_failsafe))


def test_lost_link_report_mentions_data_still_received(flight):
    """Regression: a sensor with backward time stamps, or switched off, was reported as a lost link."""
    step, supervised = flight.step, flight.supervised
    for k in range(260):
        step.set_inputs({"t": (20 + k) * ms(1), "samples.navigation.fresh": False})
        supervised.set_inputs((20 + k) * ms(1))
        step.step()
    assert supervised.describe_changes().endswith("lost: link lost")
    assert explain_change(supervised, vehicle(), None, True) == ""
    heard = ", but the vehicle sends data: "
    assert explain_change(supervised, vehicle(), [], True) == heard + "no sensor gives a sample"
    assert explain_change(supervised, vehicle(), ["imu"], True) == heard + "time stamps of imu run backwards"


def test_recovered_link_report_mentions_failsafe_or_disarm(flight):
    supervised = flight.supervised
    assert explain_change(supervised, vehicle(armed=False), None, False) == ""  # it was never armed
    assert explain_change(supervised, vehicle(), None, True) == ""
    lost = vehicle(armed=False, is_in_failsafe=True)
    assert explain_change(supervised, lost, None, True) == ", but the vehicle is in failsafe: commands are ignored"
    assert (
        explain_change(supervised, vehicle(armed=False), [], True)
        == ", but the vehicle is not armed: commands are ignored"
    )
