"""Flights of a vehicle under an external autopilot: one log per flight, with the messages to the user."""

import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import Quantity
from trimtab.core.time import ms
from trimtab.flight.stacks.physics_log import MOST_TOLD, PhysicsFlights
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.logs.mcap import read_mcap
from trimtab.scenarios.build import build

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
SIGNALS = {"other.count": ("i8", Quantity("1", "Rows so far.", kind="count"))}


@pytest.fixture(scope="module")
def boat():
    scenario = build("examples/my_boat.py:scenario", in_virtual_time=False)
    return scenario, PulsedVehicle(scenario, seed=0, channels=(), release=None)


@pytest.fixture
def flights(boat, tmp_path):
    scenario, vehicle = boat
    vehicle.reset()
    said = []
    made = PhysicsFlights(
        scenario, vehicle, SIGNALS, seed=0, file=tmp_path / "vehicle.mcap", period=ms(2), tell=said.append
    )
    made.said = said
    return made


def fly(flights, steps):
    """Advance by `steps` milliseconds, with the step number as a signal."""
    for k in range(steps):
        flights.vehicle.advance(k * ms(1), lambda t, k=k: flights.write_row(t, (k,)))


@pytest.mark.thorough
def test_each_flight_restarts_with_its_own_log(flights, tmp_path):
    flights.begin("somebody came")
    fly(flights, 20)
    flights.begin("somebody came again")
    assert flights.vehicle.body.t == 0
    fly(flights, 40)
    flights.close()
    first, second = (read_mcap(tmp_path / name) for name in ("vehicle.mcap", "vehicle-2.mcap"))
    assert (len(first["other.count"]), len(second["other.count"])) == (10, 20)
    assert set(first.ticks[1:] - first.ticks[:-1]) == {ms(2)}
    assert [text for text in flights.said if "flight" in text] == [
        "flight 1: somebody came",
        "flight 2: somebody came again",
    ]
    summary = flights.summarise(None)
    assert (summary.flights, summary.file, summary.problems) == (2, tmp_path / "vehicle-2.mcap", ())


def test_reports_are_limited_and_problems_are_kept(flights):
    flights.begin("somebody came")
    for _ in range(3):
        flights.report_once("the same")
    assert flights.said.count("the same") == 1
    for k in range(2 * MOST_TOLD):
        flights.report_once(f"line {k}")
    assert len(flights.said) == 1 + MOST_TOLD
    flights.add_problem("its motion is lost")
    flights.close(lost_lines=3)
    assert flights.said[-1] == "its motion is lost"
    assert flights.summarise(None).problems == ("its motion is lost",)
    events = [event["text"] for event in read_mcap(flights.file).metadata["events"]]
    assert events[-1].startswith("3 lines for the user were lost")
