"""Count the instructions of a step of an autopilot with an aided INS, on an emulated Cortex-M7.

    python benchmarks/board.py                   minutes, mostly for the export; also: --target cortex-m4

The flight is that of the tests (tests/export/inertial_flight.py): a feed-forward dual filter, inertial unit and heading
every 6.5536 ms, position every 100 ms, steps of 1 ms. Whole exported steps are counted: checks of the samples, their
ordering by measurement time in a history of 64, filters, estimate, law and allocation. QEMU counts instructions, not
the processor's cycles (docs/export/boards.md).

Exits with 1 if the board computes other numbers, with 2 if its tools are missing.
"""

import argparse
import importlib.util
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from paired import row

from trimtab.export.export_c import export_c
from trimtab.export.verify import compare_samples
from trimtab.flight.boards.microcontrollers import TARGETS, emulate, missing_tools, read_vectors

COMMAND = "python benchmarks/board.py"
FLIGHT = Path(__file__).parents[1] / "tests" / "export" / "inertial_flight.py"


def scenario():
    """Return the scenario of the flight."""
    found = importlib.util.spec_from_file_location("inertial_flight", FLIGHT)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module.scenario()


def kinds(vectors, inputs):
    """Return kind of step -> flags (n,). Steps are classified by the sensors that have a new sample."""
    new = {}
    for sensor in ("imu", "position"):
        t = vectors.inputs[:, next(i for i, n in enumerate(inputs) if n.endswith(f"samples.{sensor}.t"))]
        new[sensor] = np.diff(t, prepend=-1) != 0
    return {
        "no new sample": ~new["imu"] & ~new["position"],
        "new inertial sample and heading": new["imu"] & ~new["position"],
        "new position": new["position"],
    }


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--target", choices=sorted(TARGETS), default="cortex-m7")
    p.add_argument("--steps", type=int, default=1000, help="number of steps (%(default)s)")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    if missing := missing_tools():
        print(f"not installed: {', '.join(missing)}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        export_c(scenario(), Path(folder), real=TARGETS[a.target].real, steps=a.steps)
        flown = emulate(Path(folder), a.target, steps=a.steps)
        vectors = read_vectors(Path(folder), a.steps)
        about = json.loads((Path(folder) / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    first = compare_samples(flown.outputs, flown.expected_outputs, about["outputs"], tolerance)[1]
    verdict = "agree" if first is None else f"WRONG from {first}"
    print(f"{a.steps} steps on {a.target}, {TARGETS[a.target].real}: {verdict}")
    print(f"flash {flown.flash_bytes} B, RAM {flown.ram_bytes} B, stack {flown.stack_bytes} B")
    command = COMMAND if a.target == "cortex-m7" else f"{COMMAND} --target {a.target}"
    lines = []
    counted = f"instructions of an autopilot step with aided INS on {a.target}"
    for what, which in kinds(vectors, about["inputs"]).items():
        n = flown.instructions[which]
        figure = f"{np.median(n):.0f} ({n.min()}..{n.max()})" if len(n) else "none"
        print(f"{what:34} {len(n):5} steps  {figure} instructions")
        lines.append(row(f"{counted}: {what}", figure, "", command))
    if a.markdown:
        print("\n" + "\n".join(lines))
    return int(first is not None)


if __name__ == "__main__":
    sys.exit(main())
