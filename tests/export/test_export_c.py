"""export_c: every scenario's autopilot in both precisions, the whole loop in double; compiled, checked, compared."""

import json
import subprocess

import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.export.export_c import export_c
from trimtab.export.verify import verify_folder
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
NAMES = [name for name in catalogue.scenario_names() if not name.startswith("swarm/")]
"""Of a swarm the step of one craft is exported: tests/scenarios/test_swarm_formation.py."""


def exported(name, folder, **options):
    scenario, _ = catalogue.load_scenario(name)
    return export_c(scenario, folder, **options)


def steps_of_flight(name):
    """How often the autopilot steps in the whole flight."""
    scenario, _ = catalogue.load_scenario(name)
    return scenario.duration // scenario.autopilot.period


SINGLE = ["hovercraft/zero-velocity", "hovercraft/spin", "hovercraft/heading-bang-bang"]
LARGE = dict.fromkeys((n for n in NAMES if n.startswith("navigation/platform-")), 5_632)
LARGE["navigation/platform-ranging"] = 28_672
LARGE["navigation/aerial"] = 32_768
LARGE |= dict.fromkeys(("hovercraft/pose", "hovercraft/track"), 75_776)
"""Most stack (bytes) of autopilots that need more than 4 KiB; measured: up to 5 344, 27 552 and 31 800, and
73 360 where the hovercraft flies on its ultrasonic INS, of whose rows of 36 some 400 stand there. The others' triangles
of 36 covariances lie in memory, as all rows over 24 do (`compiler.arrays`)."""
BOTH = [(name, "double") for name in NAMES] + [(name, "single") for name in SINGLE]
HERE = ("hovercraft/forward", "hovercraft/heading-bang-bang", "navigation/still")
"""The others are of the same parts, or flown on the emulated board (tests/export): with the thorough tests."""
MARKED = [b if b[0] in HERE else pytest.param(*b, marks=pytest.mark.thorough) for b in BOTH]


@pytest.mark.thorough
@pytest.mark.sanitizer
@pytest.mark.parametrize(("name", "real"), MARKED)
def test_exported_autopilot_matches_the_simulation(name, real, tmp_path):
    exported(name, tmp_path, real=real, steps=1500)
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first
    assert verdict.sanitized
    assert verdict.steps == min(1500, steps_of_flight(name))
    print(f"stack {verdict.stack_bytes} B")
    assert 0 < verdict.stack_bytes < LARGE.get(name, 4096)


@pytest.mark.thorough
@pytest.mark.sanitizer
def test_exported_loop_matches_the_simulation(tmp_path):
    exported("hovercraft/zero-velocity", tmp_path, part="loop", steps=1000)
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first
    assert verdict.sanitized


@pytest.mark.thorough
@pytest.mark.sanitizer
@pytest.mark.parametrize("part", ["autopilot", "loop"])
def test_exported_monitor_verdicts_are_bit_identical(part, tmp_path):
    formulas = "turn: always[0.1 s, 0.5 s](abs(estimate.state.yaw_rate - 3 rad/s) < 2.9 rad/s)"
    formulas += "; comes: (estimate.age < 0.2 s) until[0.1 s, 0.7 s] estimate.state.yaw_rate > 10 deg/s"
    formulas += "; last: (estimate.age < 0.2 s) since[50 ms, 0.4 s] estimate.state.yaw_rate > 10 deg/s"
    export_c(build("hovercraft/spin", {"autopilot.monitor.formulas": formulas}), tmp_path, part=part)
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first
    said = {name: off for name, (off, _) in verdict.worst.items() if name.startswith("monitor.")}
    assert len(said) == 6
    assert {off for name, off in said.items() if name.endswith("verdict")} == {0.0}
    if part == "autopilot":  # a loop's frames are its own, and XLA rounds its truth otherwise than C
        assert set(said.values()) == {0.0}
    assert "monitor" in (tmp_path / f"{part}.h").read_text()


@pytest.mark.thorough
def test_exported_ideal_loop_passes_verify(tmp_path):
    scenario, _ = catalogue.load_scenario("hovercraft/spin")
    export_c(scenario.ideal(), tmp_path, part="loop", steps=500)
    assert verify_folder(tmp_path).good


@pytest.mark.thorough
def test_exported_files_document_units_licence_and_period(tmp_path):
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
    [({"part": "wing"}, "autopilot"), ({"real": "half"}, "double"), ({"steps": 0}, "at least 1")],
)
def test_rejects_wrong_options(options, says, tmp_path):
    with pytest.raises(InputError, match=says):
        exported("hovercraft/spin", tmp_path, **options)


@pytest.mark.thorough
def test_rejects_unwritable_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="out"):
        exported("hovercraft/spin", tmp_path / "file" / "below", steps=5)


TIMES_AT_THE_ENDS = """
#include "autopilot.h"
#include <stdio.h>
#include <string.h>

static _Alignas(64) unsigned char memory[1 << 16];

int main(void)
{
    static const int64_t times[] = {INT64_MIN, INT64_MIN + 1, -1, 0, 1, INT64_MAX - 1, INT64_MAX};
    for (int i = 0; i < 49; ++i) {
        autopilot_params p;
        autopilot_state s;
        autopilot_in in;
        autopilot_out out;
        memset(&in, 0, sizeof in);
        autopilot_defaults(&p);
        autopilot_init(&p, &s WORKSPACE);
        in.t = times[i / 7];
        in.samples.FIRST.t = in.samples.SECOND.t = times[i % 7];
        in.samples.FIRST.fresh = in.samples.FIRST.valid = in.samples.SECOND.fresh = in.samples.SECOND.valid = true;
        for (int k = 0; k < 3; ++k) autopilot_step(&p, &s, &in, &out WORKSPACE);
    }
    puts(sizeof memory >= LEAST ? "done" : "no room");
    return 0;
}
"""


SIMPLE = ("WORKSPACE=", "LEAST=0", "FIRST=navigation", "SECOND=navigation")
INERTIAL = ("WORKSPACE=,memory", "LEAST=AUTOPILOT_WORKSPACE", "FIRST=imu", "SECOND=ranging")


@pytest.mark.thorough
@pytest.mark.sanitizer
@pytest.mark.parametrize(("navigation", "names"), [("errors", SIMPLE), ("ins", INERTIAL)])
def test_extreme_times_cause_no_integer_overflow(navigation, names, tmp_path):
    """Also without a compiler flag that makes signed integers wrap."""
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {"navigation": navigation})
    export_c(scenario, tmp_path)
    (tmp_path / "ends.c").write_text(TIMES_AT_THE_ENDS)
    flags = ["-std=c11", "-ffp-contract=off", "-fno-wrapv", "-fsanitize=signed-integer-overflow"]
    flags += [f"-D{name}" for name in names]
    command = ["gcc", *flags, "-fno-sanitize-recover=all", "ends.c", "autopilot.c", "-lm", "-o", "ends"]
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "ends"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
