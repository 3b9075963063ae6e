"""verify detects changed exports and reports where."""

import json

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.export.export_c import export_c
from trimtab.export.verify import compare_samples, verify_folder
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


@pytest.fixture
def folder(tmp_path):
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    export_c(scenario, tmp_path, steps=200)
    return tmp_path


def edit(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.thorough
def test_detects_changed_gain_with_step_and_name(folder):
    edit(folder / "autopilot.c", "p->law.k2 = ", "p->law.k2 = 1.001 * ")
    verdict = verify_folder(folder)
    assert not verdict.good
    step, name, got, wanted = verdict.first
    assert name.startswith("law.")
    assert got != wanted
    assert 0 < step < 200


def test_detects_nan_where_a_number_is_expected():
    wanted = np.array([[1.0, np.nan], [2.0, np.nan]])
    assert compare_samples(wanted.copy(), wanted, ["a", "b"], np.array([0.1, 0.1]))[1] is None
    for got in (np.nan, np.inf, 2.2):
        bad = np.array([[1.0, np.nan], [got, np.nan]])
        assert compare_samples(bad, wanted, ["a", "b"], np.array([0.1, 0.1]))[1][:2] == (1, "a")
    assert compare_samples(np.ones((2, 2)), wanted, ["a", "b"], np.array([9.0, 9.0]))[1][:2] == (0, "b")


def test_flags_have_zero_tolerance(folder):
    about = json.loads((folder / "export.json").read_text())
    assert {name: about["tolerance"][name] == 0 for name in ("command.valid", "law.lyapunov")} == {
        "command.valid": True,
        "law.lyapunov": False,
    }


def test_rejects_source_with_compiler_warnings(folder):
    edit(folder / "autopilot.c", "void autopilot_init", "static int unused;\nvoid autopilot_init")
    with pytest.raises(InputError, match="reported an error"):
        verify_folder(folder)


@pytest.mark.thorough
def test_detects_undefined_behaviour(folder):
    bad = "double room[2] = {0, 0};\n    volatile int k = 2;\n    room[k] = p->law.k1;\n    out->law.lyapunov = room[k]"
    edit(folder / "autopilot.c", "out->law.lyapunov = ", f"{bad}; out->law.lyapunov = ")
    with pytest.raises(InputError, match="ended with exit code"):
        verify_folder(folder)


def test_rejects_folder_that_is_not_an_export(tmp_path, folder):
    with pytest.raises(InputError, match="trimtab export SCENARIO"):
        verify_folder(tmp_path / "nothing")
    about = json.loads((folder / "export.json").read_text())
    (folder / "export.json").write_text(json.dumps(about | {"name": "../../x"}))
    with pytest.raises(InputError, match="not a folder"):
        verify_folder(folder)
