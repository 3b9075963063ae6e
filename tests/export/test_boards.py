"""The hovercraft's exported autopilot on emulated boards: what was simulated, within the stated tolerance."""

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
    import json

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
