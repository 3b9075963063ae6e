"""Every example is short and runs; a vehicle outside the package flies."""

import json
import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from click.testing import CliRunner

from trimtab.cli import main

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
LONGEST = {"my_boat": 130}
"""Lines of an example that is more than one thing: vehicle, law and scenario."""


@pytest.fixture
def _no_traces():
    """Forget the modules that an example imports from its folder, and close its figures."""
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "").parent == ROOT / "examples":
            del sys.modules[name]
    plt.close("all")


@pytest.mark.usefixtures("_no_traces")
@pytest.mark.parametrize("file", EXAMPLES, ids=lambda f: f.stem)
def test_example_is_short_and_runs(file, tmp_path, monkeypatch):
    assert len(file.read_text(encoding="utf-8").splitlines()) < LONGEST.get(file.stem, 60)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(file.parent)
    monkeypatch.setattr(sys, "argv", [str(file)])
    runpy.run_path(str(file), run_name="__main__")


def test_vehicle_outside_the_package_flies(tmp_path, monkeypatch):
    (tmp_path / "my_boat.py").write_text((ROOT / "examples" / "my_boat.py").read_text(encoding="utf-8"), "utf-8")
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["run", "my_boat.py:scenario", "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["ideal"]["final"]["surge_velocity"] == pytest.approx(1.0, rel=1e-6)  # the drag is fed forward
    assert result["ideal"]["final"]["heading"] == pytest.approx(1.0, abs=1e-6)
    assert result["real"]["metrics"]["surge_velocity"]["tail_mean"] == pytest.approx(1.0, abs=0.1)
