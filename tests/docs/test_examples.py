"""Every example is short and runs; a vehicle outside the package flies."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda f: f.stem)
def test_example_is_under_sixty_lines_and_runs(file, tmp_path):
    assert len(file.read_text(encoding="utf-8").splitlines()) < 60
    done = subprocess.run([sys.executable, str(file)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_vehicle_outside_the_package_flies(tmp_path):
    (tmp_path / "my_boat.py").write_text((ROOT / "examples" / "my_boat.py").read_text(encoding="utf-8"), "utf-8")
    command = [sys.executable, "-m", "trimtab", "run", "my_boat.py:scenario", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    k1, drag, reference = 4.0, 0.2, 1.5 / 2.6
    assert result["ideal"]["final"]["surge_velocity"] == pytest.approx(k1 * reference / (k1 + drag), rel=1e-3)
    assert abs(result["ideal"]["final"]["yaw_rate"]) < 1e-9
    assert result["real"]["metrics"]["surge_velocity"]["tail_mean"] == pytest.approx(0.55, abs=0.1)
