"""Exported autopilots on emulated boards reproduce the simulation within the stated tolerance."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from trimtab.export.export_c import export_c
from trimtab.export.verify import compare_samples
from trimtab.flight.boards.microcontrollers import TARGETS, emulate
from trimtab.scenarios import catalogue


def on_the_board(scenario, target, folder, steps=500):
    """Export in the board's precision, run on the board, and compare each step with the simulation."""
    export_c(scenario, folder, real=TARGETS[target].real, steps=steps)
    flown = emulate(folder, target, steps=steps)
    about = json.loads((folder / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    _, first = compare_samples(flown.outputs, flown.expected_outputs, about["outputs"], tolerance)
    assert first is None
    return flown


@pytest.mark.thorough
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", sorted(TARGETS))
@pytest.mark.parametrize("name", ["hovercraft/zero-velocity", "hovercraft/heading-proportional"])
def test_autopilot_flies_on_the_board(name, target, tmp_path):
    scenario, _ = catalogue.load_scenario(name)
    flown = on_the_board(scenario, target, tmp_path)
    least, median, most = flown.instructions_per_step
    print(f"{name} on {target}: {least} … {most} instructions, {flown.flash_bytes} B flash, {flown.ram_bytes} B RAM")
    assert 100 < least <= median <= most < 5000
    assert flown.stack_bytes < 2048


def flight(name):
    """Import a module from this folder."""
    found = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@pytest.mark.thorough
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", ["cortex-m7", "cortex-m4"])
def test_autopilot_with_its_aided_ins_flies_on_the_board(target, tmp_path):
    """The dual-filter INS with its history of delayed fixes, law and allocation, as one exported step.

    Bounds are 2 % above what gcc 12.2 gives.
    """
    flown = on_the_board(flight("inertial_flight").scenario(), target, tmp_path, steps=1000)
    least, median, most = flown.instructions_per_step
    print(f"INS on {target}: {least} … {most} instructions, median {median}, stack {flown.stack_bytes} B")
    print(f"95 %: {np.percentile(flown.instructions, 95):.0f}")
    assert median < 1500  # nothing came
    assert np.percentile(flown.instructions, 95) < 12_760  # IMU and heading
    assert most < 17_850  # a position as well
    assert flown.stack_bytes < 8_740


@pytest.mark.thorough
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize("target", sorted(TARGETS))
def test_autopilot_on_raw_ranges_flies_on_the_board(target, tmp_path):
    """The tightly coupled filter: its start, then late pings of two units, as one exported step."""
    flown = on_the_board(flight("ranging_flight").scenario(), target, tmp_path, steps=1000)
    tracking = flown.expected_outputs[:, flown.names.index("out.estimate.state.position_fix.tracking")]
    assert tracking[0] == 0
    assert tracking[-300:].all()
    least, median, most = flown.instructions_per_step
    print(f"ranging on {target}: {least} … {most} instructions, median {median}, RAM {flown.ram_bytes} B")
    assert median < 2000  # nothing came
    assert most < 300_000  # a ping, 0.1 s late
    assert flown.ram_bytes < 98_300  # of which 30 144 are the workspace, in double
    assert flown.stack_bytes < 32_768


@pytest.mark.thorough
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize(("gnss", "mean", "most"), [("fixes", 8_250, 99_960), ("ranges", 11_190, 249_900)])
def test_autopilot_with_gnss_and_inertial_flies_on_the_board(gnss, mean, most, tmp_path):
    """Mean and maximum cost of a filter with 15 or 17 error states at 1 kHz that fuses 6 or 16 measurements.

    Bounds are 2 % above what gcc 12.2 gives.
    """
    scenario, _ = catalogue.load_scenario("navigation/aerial", {"gnss": gnss})
    flown = on_the_board(scenario, "cortex-m7", tmp_path, steps=1200)
    n = flown.instructions[200:]  # when the filter has begun to take what is 150 ms old
    print(f"{gnss}: mean {n.mean():.0f}, median {np.median(n):.0f}, largest {n.max()} instructions")
    print(f"flash {flown.flash_bytes} B, RAM {flown.ram_bytes} B, stack {flown.stack_bytes} B")
    assert n.mean() < mean
    assert n.max() < most
    assert flown.ram_bytes < 65_536


HEAVY = [pytest.mark.thorough, pytest.mark.timeout(600)]


@pytest.mark.usefixtures("board_tools")
@pytest.mark.parametrize(
    ("settings", "instructions", "stack", "ram"),
    [
        pytest.param({"internal": "noncausal"}, 4_290, 11_264, 196_608, marks=HEAVY),
        pytest.param({"internal": "quasi-static"}, 6_280, 11_264, 3_584, marks=HEAVY),
        pytest.param({"internal": "preview"}, 455_000, 121_800, 23_200, marks=HEAVY),
        pytest.param({"filter": "adaptive"}, 108_500, 43_008, 199_680, marks=HEAVY),
    ],
)
def test_modal_filter_and_stable_inversion_fly_on_the_board(settings, instructions, stack, ram, tmp_path):
    """The hypersonic vehicle's whole autopilot in double on a Cortex-M7, 200 steps a second: well inside 5 ms.

    Bounds are 2 % above what gcc 12.2 gives: 4204, 6153, 446 477 and 101 325 instructions at most.
    The preview needed 196 206 instructions and 49 kB of stack while its axes of 41 points were written out.
    """
    scenario, _ = catalogue.load_scenario("hypersonic/noise", settings)
    flown = on_the_board(scenario, "cortex-m7", tmp_path)
    least, median, most = flown.instructions_per_step
    print(f"{settings}: {least} … {most} instructions, median {median}, {1e-6 * 200 * median:.2f} million a second")
    print(f"flash {flown.flash_bytes} B, RAM {flown.ram_bytes} B, stack {flown.stack_bytes} B")
    assert most < instructions
    assert flown.stack_bytes < stack
    assert flown.ram_bytes < ram
