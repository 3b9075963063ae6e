"""export_c: every scenario's autopilot in both precisions, the whole loop in double; compiled, checked, compared."""

import json

import pytest

from trimtab.core.errors import InputError
from trimtab.export.export_c import export_c
from trimtab.export.verify import verify_folder
from trimtab.native.compiler import find_compiler
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
NAMES = list(catalogue.scenario_names())


def exported(name, folder, **options):
    scenario, _ = catalogue.load_scenario(name)
    return export_c(scenario, folder, **options)


SINGLE = ["hovercraft/zero-velocity", "hovercraft/spin", "hovercraft/heading-bang-bang"]
LARGE = {"navigation/platform-ranging": 28672}
"""Most stack (bytes) of autopilots that need more than 4 KiB; measured: 27 552."""
BOTH = [(name, "double") for name in NAMES] + [(name, "single") for name in SINGLE]
HERE = ("hovercraft/forward", "hovercraft/heading-bang-bang", "navigation/still")
"""The others are of the same parts, or flown on the emulated board (tests/export): with the slow tests."""
MARKED = [b if b[0] in HERE else pytest.param(*b, marks=pytest.mark.slow) for b in BOTH]


@pytest.mark.parametrize(("name", "real"), MARKED)
def test_autopilot_computes_what_was_simulated(name, real, tmp_path):
    exported(name, tmp_path, real=real, steps=1500)
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first
    assert verdict.sanitized
    assert verdict.steps == 1500
    print(f"stack {verdict.stack_bytes} B")
    assert 0 < verdict.stack_bytes < LARGE.get(name, 4096)


def test_whole_loop_computes_what_was_simulated(tmp_path):
    exported("hovercraft/zero-velocity", tmp_path, part="loop", steps=1000)
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first
    assert verdict.sanitized


def test_ideal_loop_too(tmp_path):
    scenario, _ = catalogue.load_scenario("hovercraft/spin")
    export_c(scenario.ideal(), tmp_path, part="loop", steps=500)
    assert verify_folder(tmp_path).good


def test_the_text_says_what_it_is(tmp_path):
    written = exported("hovercraft/spin", tmp_path, steps=10)
    names = {f.name for f in written.files}
    assert names >= {"autopilot.h", "autopilot.c", "README.md", "CMakeLists.txt", "replay.c", "vectors.csv"}
    header = (tmp_path / "autopilot.h").read_text()
    assert "double yaw_rate;  /* rad/s: Rate of turn, clockwise from above. Frame B. */" in header
    assert "under any licence" in header
    source = (tmp_path / "autopilot.c").read_text()
    assert "malloc" not in source
    about = json.loads((tmp_path / "export.json").read_text())
    assert about["period_s"] == 0.001
    assert set(about["tolerance"]) == set(about["outputs"])
    readme = (tmp_path / "README.md").read_text()
    assert "trimtab export --verify" in readme


@pytest.mark.parametrize(
    ("options", "says"),
    [({"part": "wing"}, "autopilot"), ({"real": "half"}, "double"), ({"steps": 0}, "too few")],
)
def test_wrong_options_are_refused(options, says, tmp_path):
    with pytest.raises(InputError, match=says):
        exported("hovercraft/spin", tmp_path, **options)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out"):
        exported("hovercraft/spin", tmp_path / "file" / "below", steps=5)
