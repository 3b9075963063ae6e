"""The virtual bench, repeated two hundred times: its 95 % intervals have the stated coverage."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binom

from trimtab.analysis.identify.virtual_bench import draw_craft, run_bench, write_bench
from trimtab.cli import main
from trimtab.loop.calibration import read_calibration

PROCEDURES = (
    ("rudder", "servo.csv"),
    ("hull", "hull.csv"),
    ("thrust", "thrust.csv"),
    ("reverse", "reverse.csv"),
    ("inertia", "trials.csv"),
    ("friction", "coast.csv"),
    ("gyro", "sweep.csv"),
    ("link", "up.csv", "--way", "up"),
)
REPEATS = 200


def calibrate_all(folder: Path) -> Path:
    """Run every calibration procedure on the folder written by the bench."""
    out, runner = folder / "boat.toml", CliRunner()
    for name, file, *options in PROCEDURES:
        result = runner.invoke(main, ["calibrate", name, str(folder / file), *options, "--out", str(out), "--json"])
        assert result.exit_code == 0, result.output
    return out


@pytest.mark.thorough
def test_bench_intervals_have_the_stated_coverage(tmp_path: Path) -> None:
    inside: dict[str, int] = {}
    count: dict[str, int] = {}
    for seed in range(REPEATS):
        craft = draw_craft(seed)
        write_bench(tmp_path / str(seed), run_bench(craft, seed))
        entries = read_calibration(calibrate_all(tmp_path / str(seed))).entries
        for name, true in craft.true_calibration().entries.items():
            low, high = entries[name].interval()
            held = (np.asarray(true.value) >= low) & (np.asarray(true.value) <= high)
            inside[name] = inside.get(name, 0) + int(held.sum())
            count[name] = count.get(name, 0) + held.size
    shares = {name: inside[name] / count[name] for name in inside}
    print({name: round(share, 3) for name, share in shares.items()})
    low, high = (int(binom.ppf(q, REPEATS, 0.95)) / REPEATS for q in (0.0005, 0.9995))
    outside = {name: share for name, share in shares.items() if not low <= share <= high}
    assert not outside, f"not in {low:.3f} to {high:.3f}: {outside}"
