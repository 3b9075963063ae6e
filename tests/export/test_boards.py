"""Exported autopilots on emulated boards: what was simulated, within the stated tolerance."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from trimtab.export.microcontroller import TARGETS, emulate
from trimtab.export.verify import compare
from trimtab.run.export_c import export_c
from trimtab.scenarios import catalogue


@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", sorted(TARGETS))
@pytest.mark.parametrize("name", ["hovercraft/zero-velocity", "hovercraft/heading-proportional"])
def test_autopilot_flies_on_the_board(name, target, tmp_path):
    scenario, _ = catalogue.load(name)
    export_c(scenario, tmp_path, real=TARGETS[target].real, steps=500)
    flown = emulate(tmp_path, target)
    about = json.loads((tmp_path / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    _, first = compare(flown.outputs, flown.expected, about["outputs"], tolerance)
    assert first is None
    least, median, most = flown.instructions_per_step
    print(f"{name} on {target}: {least} … {most} instructions, {flown.flash_bytes} B flash, {flown.ram_bytes} B RAM")
    assert 100 < least <= median <= most < 5000
    assert flown.stack_bytes < 2048


def flight(name):
    """A module beside this one."""
    found = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@pytest.mark.timeout(300)
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", ["cortex-m7", pytest.param("cortex-m4", marks=pytest.mark.slow)])
def test_autopilot_with_its_aided_ins_flies_on_the_board(target, tmp_path):
    """The dual-filter INS with its history of delayed fixes, law and allocation, as one exported step."""
    module = flight("inertial_flight")
    export_c(module.scenario(), tmp_path, real=TARGETS[target].real, steps=1000)
    flown = emulate(tmp_path, target, steps=1000)
    about = json.loads((tmp_path / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    _, first = compare(flown.outputs, flown.expected, about["outputs"], tolerance)
    assert first is None
    least, median, most = flown.instructions_per_step
    print(f"INS on {target}: {least} … {most} instructions, median {median}, stack {flown.stack_bytes} B")
    assert median < 1500  # nothing came
    assert np.percentile(flown.instructions, 95) < 10_000  # IMU and heading
    assert most < 20_000  # a position as well
    assert flown.stack_bytes < 8192


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", sorted(TARGETS))
def test_autopilot_on_raw_ranges_flies_on_the_board(target, tmp_path):
    """The tightly coupled filter: its start, then late pings of two units, as one exported step."""
    export_c(flight("ranging_flight").scenario(), tmp_path, real=TARGETS[target].real, steps=1000)
    flown = emulate(tmp_path, target, steps=1000)
    about = json.loads((tmp_path / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    _, first = compare(flown.outputs, flown.expected, about["outputs"], tolerance)
    assert first is None
    tracking = flown.expected[:, flown.names.index("out.estimate.state.position_fix.tracking")]
    assert tracking[0] == 0
    assert tracking[-300:].all()
    least, median, most = flown.instructions_per_step
    print(f"ranging on {target}: {least} … {most} instructions, median {median}, RAM {flown.ram_bytes} B")
    assert median < 2000  # nothing came
    assert most < 300_000  # a ping, 0.1 s late
    assert flown.ram_bytes < 80_000
    assert flown.stack_bytes < 32_768


HEAVY = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize(
    ("settings", "instructions", "stack", "ram"),
    [
        ({"internal": "noncausal"}, 5_000, 12_288, 204_800),
        pytest.param({"internal": "quasi-static"}, 8_000, 12_288, 8_192, marks=HEAVY),
        pytest.param({"internal": "preview"}, 250_000, 65_536, 8_192, marks=HEAVY),
        pytest.param({"filter": "adaptive"}, 150_000, 49_152, 204_800, marks=HEAVY),
    ],
)
def test_filter_of_the_modes_and_stable_inversion_fly_on_the_board(settings, instructions, stack, ram, tmp_path):
    """The hypersonic vehicle's whole autopilot in double on a Cortex-M7, 200 steps a second: well inside 5 ms."""
    scenario, _ = catalogue.load("hypersonic/noise", settings)
    export_c(scenario, tmp_path, real="double", steps=500)
    flown = emulate(tmp_path, "cortex-m7")
    about = json.loads((tmp_path / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    _, first = compare(flown.outputs, flown.expected, about["outputs"], tolerance)
    assert first is None
    least, median, most = flown.instructions_per_step
    print(f"{settings}: {least} … {most} instructions, median {median}, {1e-6 * 200 * median:.2f} million a second")
    print(f"flash {flown.flash_bytes} B, RAM {flown.ram_bytes} B, stack {flown.stack_bytes} B")
    assert most < instructions
    assert flown.stack_bytes < stack
    assert flown.ram_bytes < ram
