"""Scenarios built from settings: link recordings, files, and errors with suggestions."""

import importlib
import re
import subprocess
import sys

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms, to_seconds
from trimtab.links.latency_trace import LatencyTrace, Trace, write_trace
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

NAME = "hovercraft/zero-velocity"
LATENCY = np.array([0.030, 0.012, 0.047, 0.0, 0.021])
LOST = np.array([False, False, False, True, False])


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "uplink.csv"
    write_trace(path, Trace(np.arange(5) * 0.02, LATENCY, LOST))
    return str(path)


@pytest.mark.thorough
def test_packets_take_the_recorded_latencies_in_turn(file):
    scenario = build(NAME, {"uplink": file, "duration": "2"}, without=["navigation-error"])
    log = simulate(scenario, log_period=ms(1))
    fresh = log["uplink.fresh"].astype(bool)
    sent = np.round((log.t[fresh] - log["uplink.age"][fresh]) / 0.02).astype(int)
    first = int(sent[0])
    ages = np.round(log["uplink.age"][fresh], 6)
    wanted, last = [], 0.0
    for k in range(first, first + len(ages) * 2):
        if not LOST[(k - first) % 5]:
            last = max(last, k * 0.02 + LATENCY[(k - first) % 5])
            wanted.append(round(last - k * 0.02, 6))
    np.testing.assert_allclose(ages, wanted[: len(ages)], atol=1e-9)
    assert len(ages) > 70


def test_uplink_recording_leaves_the_rest_of_the_scenario_unchanged(file):
    own, changed = build(NAME), build(NAME, {"uplink": file, "world.vehicle.mass": "3"})
    assert isinstance(changed.world.uplink, LatencyTrace)
    assert changed.world.uplink.send_period == own.world.uplink.period
    assert to_seconds(changed.world.uplink.period) == 0.001
    assert (type(changed.world.downlink), changed.world.downlink.steps) == (type(own.world.downlink), 6)
    assert (own.world.vehicle.mass, changed.world.vehicle.mass) == (2.6, 3.0)


def test_link_buffer_capacity_covers_the_longest_latency(tmp_path):
    path = tmp_path / "slow.csv"
    write_trace(path, Trace(np.arange(2) * 0.02, np.array([0.1, 4.0]), np.zeros(2, bool)))
    assert build(NAME, {"downlink": str(path)}).world.downlink.capacity > 4.0 / 0.006


@pytest.mark.parametrize(
    ("text", "said"), [("3", "is not a recording(.|\\n)*link-test"), ("nothing.csv", "file not found")]
)
def test_rejects_invalid_link_recordings(text, said):
    with pytest.raises(InputError, match=said):
        build(NAME, {"uplink": text})


def test_mistyped_uplink_setting_suggests_uplink():
    with pytest.raises(InputError, match=r"unknown setting of scenario(.|\n)*Fix: settings=\{\"uplink\": "):
        build(NAME, {"uplnk": "up.csv"})


@pytest.mark.parametrize(("typed", "path"), [("mass", "world.vehicle.mass"), ("k1", "autopilot.law.k1")])
def test_setting_without_its_path_suggests_the_full_path(typed, path):
    with pytest.raises(InputError, match=f"unknown setting of scenario(.|\n)*Fix: .*{re.escape(path)}"):
        build(NAME, {typed: "3"})


def test_mistyped_function_of_a_file_suggests_the_nearest(tmp_path):
    (tmp_path / "mine.py").write_text("def scenario():\n    return None\n")
    with pytest.raises(InputError, match=r"no function 'scenari'(.|\n)*Fix: .*mine\.py:scenario$"):
        build(f"{tmp_path}/mine.py:scenari")


def test_missing_file_error_names_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"no file 'mine\.py' in (.|\n)*trimtab new vehicle mine$") as refused:
        build("mine.py:scenario")
    assert str(tmp_path) in refused.value.problem


@pytest.mark.parametrize("name", ["random", "json", "numpy", "colorsys"])
def test_scenario_file_does_not_replace_a_module_of_its_name(tmp_path, name):
    text = "from trimtab.scenarios.hovercraft.forward import scenario\n\n\ndef mine():\n    return scenario()\n"
    (tmp_path / f"{name}.py").write_text(text)
    before = importlib.import_module(name)
    sys.modules.pop("colorsys", None)  # a module that nobody has imported yet
    assert build(f"{tmp_path}/{name}.py:mine").name == build("hovercraft/forward").name
    assert importlib.import_module(name).__spec__.origin == before.__spec__.origin


def test_accepts_a_single_fault_as_text():
    scenario = build(NAME, faults="uplink off @ 1 s", without="navigation-error")
    assert scenario.choices["faults"] == ["uplink off @ 1 s"]
    assert scenario.choices["without"] == ["navigation-error"]


def test_build_does_not_import_scipy_optimisers():
    code = (
        "import sys, trimtab.run.simulate; print([n for n in ('scipy.optimize', 'scipy.linalg') if n in sys.modules])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "[]\n"


OWN = """from trimtab import build, replace
def scenario():
    base = build("hovercraft/forward")
    return replace(base, autopilot=replace(base.autopilot, allocation=None), name="scenario")
def whole():
    return replace(build("hovercraft/forward"), name="scenario")
"""


def test_missing_part_of_a_file_is_reported_with_the_line_to_write(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    with pytest.raises(InputError, match=r"own.py:scenario': autopilot.allocation is None") as refused:
        build(f"{tmp_path}/own.py:scenario")
    assert refused.value.fix == "write allocation=DirectAllocation() in Autopilot(…)"


def test_scenario_of_a_file_has_the_name_of_file_and_function(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    assert build(f"{tmp_path}/own.py:whole").name == "own.py:whole"


def test_missing_initial_state_is_written_in_the_scenario_itself(tmp_path):
    (tmp_path / "own.py").write_text(OWN.replace("autopilot=replace(base.autopilot, allocation=None)", "initial=None"))
    with pytest.raises(InputError, match=r"own\.py:scenario': initial is None") as refused:
        build(f"{tmp_path}/own.py:scenario")
    assert refused.value.fix == "write initial=MyState() in Scenario(…)"
