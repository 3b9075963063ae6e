"""The hovercraft's exported autopilot on emulated boards: what was simulated, within the stated tolerance."""

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


@pytest.mark.timeout(300)
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", sorted(TARGETS))
def test_autopilot_with_its_aided_ins_flies_on_the_board(target, tmp_path):
    """The dual-filter INS with its history of delayed fixes, law and allocation, as one exported step."""
    where = Path(__file__).with_name("inertial_flight.py")
    found = importlib.util.spec_from_file_location("inertial_flight", where)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
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
