"""Rebuilding a log's scenario from its recorded choices or, without them, from its parts."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import part_classes
from trimtab.core.record import leaves, replace
from trimtab.core.time import ms
from trimtab.links.latency_trace import Trace, write_trace
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.loop.fault_text import add_dormant_faults
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.run.program import describe_scenario
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario


def recorded(folder, scenario, /, **changes) -> Log:
    """Return a log of a scenario, read from its file, with changed metadata."""
    about = describe_scenario(scenario) | changes
    return read_mcap(
        write_mcap(Log(np.zeros(1), np.zeros(1, int), {"a.x": np.ones(1)}, {}, about), folder / "run.mcap")
    )


def check_alike(one, other):
    assert part_classes(one) == part_classes(other)
    here, there = (list(leaves(s)) for s in (one, other))
    assert [p for p, _, _ in here] == [p for p, _, _ in there]
    for (path, a, _), (_, b, _) in zip(here, there, strict=True):
        assert np.array_equal(np.asarray(a), np.asarray(b)), path
        assert isinstance(a, str | tuple | bool) == isinstance(b, str | tuple | bool), path


def test_vehicle_log_is_rebuilt_with_its_dormant_faults(tmp_path):
    flown = add_dormant_faults(build("hovercraft/forward", {"world.vehicle.mass": "3"}))
    again = rebuild_scenario(recorded(tmp_path, flown, side="vehicle"))
    check_alike(again, flown)
    assert part_classes(again)["world.sensors.navigation"] == "FaultySensor"


@pytest.fixture
def builds(monkeypatch) -> list:
    """List of the scenarios that the catalogue has built."""
    asked, load = [], catalogue.load_scenario
    monkeypatch.setattr(catalogue, "load_scenario", lambda *a: asked.append(a) or load(*a))
    return asked


def test_rebuild_uses_the_recorded_choices_once(tmp_path, builds):
    typed = {"navigation": "ins-magnetometer", "links": "measured", "world.vehicle.mass": "2.7", "duration": "4 s"}
    faults = ["sensor:imu off @ 3 s for 1 s"]
    scenario = build("hovercraft/spin", typed, without=["imu-noise"], faults=faults)
    log = recorded(tmp_path, scenario)
    assert log.metadata["choices"] == {
        "scenario": "hovercraft/spin",
        "arguments": {"navigation": "ins-magnetometer", "links": "measured"},
        "settings": {"world.vehicle.mass": "2.7", "duration": "4 s"},
        "without": ["imu-noise"],
        "faults": faults,
    }
    builds.clear()
    again = rebuild_scenario(log)
    check_alike(again, scenario)
    assert again.choices == scenario.choices
    assert len(builds) == 1


def test_live_scenario_and_ideal_twin_are_rebuilt(tmp_path):
    scenario = build("hovercraft/forward", {"supervisor": "automatic"})
    check_alike(rebuild_scenario(recorded(tmp_path, add_pilot_sensor(scenario))), add_pilot_sensor(scenario))
    check_alike(rebuild_scenario(recorded(tmp_path, scenario.ideal())), scenario.ideal())


def test_rebuild_works_without_the_link_recording_file(tmp_path):
    file = tmp_path / "uplink.csv"
    write_trace(file, Trace(np.arange(3) * 0.02, np.full(3, 0.01), np.zeros(3, bool)))
    scenario = build("hovercraft/forward", {"uplink": str(file)})
    log = recorded(tmp_path, scenario)
    file.unlink()
    check_alike(rebuild_scenario(log).autopilot, scenario.autopilot)


@pytest.mark.thorough
def test_log_without_choices_is_rebuilt_from_its_parts(tmp_path):
    """Logs of scenarios that were built in Python have no choices."""
    scenario, _ = catalogue.load_scenario("hovercraft/spin", {"navigation": "ins-magnetometer", "links": "measured"})
    vehicle = replace(scenario.world.vehicle, mass=np.nextafter(2.7, 3))
    scenario = replace(scenario, world=replace(scenario.world, vehicle=vehicle), duration=ms(10))
    log = recorded(tmp_path, scenario)
    assert "choices" not in log.metadata
    check_alike(rebuild_scenario(log), scenario)


def test_rebuild_never_imports_code_named_by_a_log(tmp_path):
    """A file, a module and a function that would end Python: each rejected, and a file is used if the user names it."""
    scenario, _ = catalogue.load_scenario("hovercraft/spin")
    own, mark = tmp_path / "own.py", tmp_path / "was run"
    own.write_text(
        f"""from pathlib import Path
from trimtab.scenarios.catalogue import load_scenario
Path({str(mark)!r}).touch()
def craft():
    return load_scenario("hovercraft/spin")[0]
"""
    )
    for name in (f"{own}:craft", "os:abort", "own:craft"):
        log = recorded(tmp_path, scenario, scenario=name, choices={})
        with pytest.raises(InputError, match="not in the catalogue; a file is not run only because"):
            rebuild_scenario(log)
        choices = {"scenario": name, "arguments": {}, "settings": {}, "without": [], "faults": []}
        with pytest.raises(InputError, match="not in the catalogue; a file is not run only because"):
            rebuild_scenario(recorded(tmp_path, scenario, scenario="hovercraft/spin", choices=choices))
    assert not mark.exists()
    check_alike(rebuild_scenario(recorded(tmp_path, scenario, scenario="os:abort"), f"{own}:craft"), scenario)
    assert mark.exists()


@pytest.mark.thorough
def test_rejects_a_scenario_whose_parts_differ_from_the_log(tmp_path):
    for scenario in (build("hovercraft/zero-velocity"), catalogue.load_scenario("hovercraft/zero-velocity")[0]):
        parts = part_classes(scenario) | {"autopilot.law": "AnotherLaw"}
        with pytest.raises(InputError, match=r"autopilot.law was AnotherLaw, but now is ZeroVelocity"):
            rebuild_scenario(recorded(tmp_path, scenario, parts=parts))
    gone = recorded(tmp_path, scenario, scenario="hovercraft/gone")
    with pytest.raises(InputError, match=r"scenario=.file\.py:function"):
        rebuild_scenario(gone)
    assert rebuild_scenario(gone, "hovercraft/zero-velocity").name == "hovercraft/zero-velocity"
    with pytest.raises(InputError, match="does not contain its scenario"):
        rebuild_scenario(Log(gone.t, gone.ticks, gone.signals))


CHANGED = {
    "arguments": {"navigation": "ins"},
    "settings": {},
    "without": [],
    "faults": [],
}


@pytest.mark.parametrize(
    ("metadata", "field"),
    [
        ({"choices": [1]}, "choices must be a table"),
        ({"choices": "x"}, "choices must be a table"),
        ({"parts": 3}, "parts must be a table of texts"),
        ({"parts": {"a": 3}}, "parts must be a table of texts"),
        ({"seed": "a"}, "seed must be a whole number"),
        ({"seed": True}, "seed must be a whole number"),
        ({"parameters": [1]}, "parameters must be a table"),
        ({"scenario": 7}, "scenario must be a text"),
        ({"choices": CHANGED | {"settings": [1, 2]}}, r"choices\.settings must be a table of texts"),
        ({"choices": CHANGED | {"settings": {"x": 1}}}, r"choices\.settings must be a table of texts"),
        ({"choices": CHANGED | {"arguments": None}}, r"choices\.arguments is missing"),
        ({"choices": CHANGED | {"faults": 7}}, r"choices\.faults must be a list of texts"),
        ({"choices": CHANGED | {"faults": [7]}}, r"choices\.faults must be a list of texts"),
        ({"choices": CHANGED | {"without": "imu-noise"}}, r"choices\.without must be a list of texts"),
        ({"choices": CHANGED | {"calibration": []}}, r"choices\.calibration must be a table"),
        ({"choices": CHANGED | {"gain": {"content": 3}}}, r"choices\.gain\.content must be a text"),
        ({"choices": CHANGED | {"arguments": {"uplink": "/dev/zero"}}}, r"choices\.arguments\.uplink is a file name"),
        ({"choices": CHANGED | {"arguments": {"gain": "x"}}}, r"choices\.arguments\.gain is a file name"),
    ],
)
def test_invalid_log_metadata_is_rejected_by_field(tmp_path, builds, metadata, field):
    log = recorded(tmp_path, build("hovercraft/spin", {}), **metadata)
    builds.clear()
    with pytest.raises(InputError, match=f"the log's field {field}"):
        rebuild_scenario(log)
    assert builds == []
