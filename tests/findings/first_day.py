"""A new user's first day: what was typed, what happened at first, and what happens here.

Each function returns what happens and whether it is right.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from findings import first_day_slips
from findings.finding import Finding, Outcome, run_tests
from trimtab import InputError, build, plot_run, quantity, replace, simulate
from trimtab.core.record import record

OWN = "# my own file\n"
SCENARIO = "from trimtab import build\n\n\ndef scenario():\n    return build('hovercraft/zero-velocity')\n"
LAW = """
import jax
import jax.numpy as jnp
from trimtab import build, record, replace
from trimtab.laws.velocity import ZeroVelocity


@record
class Broken(ZeroVelocity):
    def step(self, t, state, input):
        state, output = super().step(t, state, input)
        return state, replace(output, demand=jax.tree.map(lambda v: v + jnp.inf, output.demand))


def scenario():
    made = build("hovercraft/zero-velocity")
    law = Broken(made.autopilot.law.k1, made.autopilot.law.k2, made.autopilot.law.model)
    return replace(made, autopilot=replace(made.autopilot, law=law))
"""
INTERRUPTED = """
import os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from trimtab.cli import main
from trimtab.run import simulate

class Dropping:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass

def compile_scenario(*_, **__):
    if threading.current_thread() is threading.main_thread():
        Dropping()
    time.sleep(600)

simulate.compile_scenario = compile_scenario
main()
"""


def trimtab(*words: str, files: dict[str, str] | None = None, script: str = "") -> tuple[int, str, dict[str, str]]:
    """Run the command line in a new folder with these files; return exit code, output, and the files afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (files or {}).items():
            Path(folder, name).parent.mkdir(exist_ok=True, parents=True)
            Path(folder, name).write_text(text)
        command = [sys.executable, *(("-c", script) if script else ("-m", "trimtab")), *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=_environment())
        left = {name: Path(folder, name).read_text() for name in files or {}}
        return done.returncode, done.stdout + done.stderr, left


def _environment() -> dict[str, str]:
    paths = [str(Path(p).resolve()) for p in sys.path if p and Path(p).is_dir()]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths)}


def keeps(*words: str, files: dict[str, str]) -> tuple[str, bool]:
    """Return the answer, and True if the user's files are unchanged and the answer says what to type."""
    code, said, left = trimtab(*words, files=files)
    return said.strip(), code == 2 and left == files and "--overwrite" in said


def answers(*words: str, code: int = 2, says: str = "Fix:", script: str = "", **files: str) -> tuple[str, bool]:
    """Return the answer, and True if exit code and text are the expected ones."""
    named = {name.replace("__", "."): text for name, text in files.items()}
    got, said, _ = trimtab(*words, files=named, script=script)
    return f"exit {got}: {said.strip()}", got == code and says in said


@contextlib.contextmanager
def _new_folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def refuses(do: object, says: str) -> tuple[str, bool]:
    """Return the error of a call, and True if it is an InputError with this text."""
    try:
        return repr(do()), False  # pyright: ignore[reportCallIssue]
    except InputError as error:
        return str(error), says in str(error)


def _draws() -> tuple[str, bool]:
    log = simulate("hovercraft/spin", duration="100 ms")
    with _new_folder() as folder:
        plot_run(log, str(folder / "x.png"))
        written = [p.name for p in folder.iterdir()]
    return f"wrote {written}", written == ["x.png"]


def _reads_mass() -> tuple[str, bool]:
    mass = replace(build("hovercraft/spin").world.vehicle, mass="3").mass
    return repr(mass), type(mass) is float and mass == 3.0


def _short_reprs() -> tuple[str, bool]:
    made = build("hovercraft/spin")
    sizes = [len(repr(one)) for one in (made, made.world.vehicle, simulate(made, duration="100 ms"))]
    return f"{sizes} characters", max(sizes) < 1000


def _by_name() -> tuple[str, bool]:
    log = simulate("hovercraft/forward", duration="100 ms")
    return repr(log).partition("\n")[0], len(log) == 100


def _declares_degrees() -> object:
    @record
    class Course:
        """A course. Source: this file."""

        angle: float = quantity("deg", "Angle of the course.", default=90.0)

    return Course()


def _flies_integer() -> object:
    return simulate("hovercraft/spin", duration=30)


def _own_slips() -> Outcome:
    wrong = [finding.id for finding in first_day_slips.FINDINGS if not finding.run().holds]
    return Outcome(f"wrong answers: {', '.join(wrong) or 'none'}", not wrong)


MASS = ("--spread", "world.vehicle.mass=uniform(80%, 120%)")
ZERO = "hovercraft/zero-velocity"
BOARD = {"d/autopilot.c": OWN, "d/README.md": OWN, "d/main.c": OWN}

FINDINGS = [
    Finding(
        "falsify overwrites its scenario",
        "falsify mine.py:scenario … --out mine.py",
        "the user's source is overwritten",
        lambda: keeps("falsify", "mine.py:scenario", *MASS, "--out", "mine.py", files={"mine.py": SCENARIO}),
    ),
    Finding(
        "tune overwrites its scenario",
        "tune mine.py:scenario … --out mine.py",
        "the user's source is overwritten",
        lambda: keeps(
            *("tune", "mine.py:scenario", "--gain", "autopilot.law.k1=0.5:3", "--out", "mine.py"),
            files={"mine.py": SCENARIO},
        ),
    ),
    Finding(
        "export overwrites",
        "export hovercraft/spin --out d, with an own autopilot.c, README.md, main.c",
        "replaced silently",
        lambda: keeps("export", "hovercraft/spin", "--out", "d", files=BOARD),
    ),
    Finding(
        "firmware overwrites",
        "firmware hovercraft/forward --out d, with an own autopilot.c, README.md, main.c",
        "replaced silently, also when it then refuses",
        lambda: keeps("firmware", "hovercraft/forward", "--out", "d", files=BOARD),
    ),
    Finding(
        "Ctrl-C in a garbage-collection callback",
        "run mine.py:scenario, Ctrl-C while compiling",
        "swallowed, and the work goes on",
        lambda: answers(
            *("run", "mine.py:scenario"), code=130, says="stopped by Ctrl-C", script=INTERRUPTED, mine__py=SCENARIO
        ),
    ),
    Finding("integer duration", "simulate(s, duration=30)", "flies 3 µs", lambda: refuses(_flies_integer, '"30 s"')),
    Finding(
        "float duration",
        "simulate(s, duration=30.0)",
        "flies 3 µs",
        lambda: refuses(lambda: simulate("hovercraft/spin", duration=30.0), '"30.0 s"'),  # pyright: ignore
    ),
    Finding(
        "integer period",
        "replace(autopilot, period=10)",
        "flies at 1 µs",
        lambda: refuses(
            lambda: simulate(
                replace(build("hovercraft/spin"), autopilot=replace(build("hovercraft/spin").autopilot, period=10))
            ),
            "too short",
        ),
    ),
    Finding(
        "fractional seed",
        "simulate(s, seed=1.5)",
        "accepted",
        lambda: refuses(lambda: simulate("hovercraft/spin", seed=1.5), "must be a whole number"),  # pyright: ignore
    ),
    Finding("mass as text", 'replace(vehicle, mass="3")', "the text is kept", _reads_mass),
    Finding(
        "unit spelled out",
        'quantity("kilograms")',
        "accepted",
        lambda: refuses(lambda: quantity("kilograms", "Mass."), 'quantity("kg"'),
    ),
    Finding(
        "unit deg",
        'quantity("deg", default=90.0)',
        "flies 90 rad",
        lambda: refuses(_declares_degrees, 'quantity("rad"'),
    ),
    Finding("plot_run with a file", 'plot_run(log, "x.png")', "writes nothing", _draws),
    Finding(
        "law with infinite output",
        "run law.py:scenario",
        "the vehicle stands still, exit 0",
        lambda: answers("run", "law.py:scenario", code=1, says="NOT FINITE (real): law.demand", law__py=LAW),
    ),
    Finding(
        "diverged state",
        "run hovercraft/spin --set initial.yaw_rate=1e200",
        "LOST, exit 0",
        lambda: answers("run", "hovercraft/spin", "--set", "initial.yaw_rate=1e200", code=1, says="LOST"),
    ),
    Finding(
        "fault after the flight",
        "run hovercraft/spin --fault 'uplink off @ 500 s'",
        "silent",
        lambda: answers("run", "hovercraft/spin", "--fault", "uplink off @ 500 s"),
    ),
    Finding(
        "log period of zero",
        "run hovercraft/spin --log-period 0",
        "a warning and exit 0",
        lambda: answers("run", "hovercraft/spin", "--log-period", "0", says="must be above 0 s"),
    ),
    Finding(
        "negative delay",
        "map … --x delay=-1:0.6",
        "-1 is printed 65 times",
        lambda: answers("map", ZERO, "--x", "delay=-1:0.6", "--y", "loss=0:0.9", says="delay must be at least 0 s"),
    ),
    Finding(
        "file without a function",
        "run mine.py",
        "misleading advice",
        lambda: answers("run", "mine.py", says="Fix: trimtab run mine.py:scenario", mine__py=SCENARIO),
    ),
    Finding("typo in list", "list typo", "misleading advice", lambda: answers("list", "typo", says="unknown scenario")),
    Finding(
        "negative duration",
        "run hovercraft/spin --duration -5",
        "another option is named",
        lambda: answers("run", "hovercraft/spin", "--duration", "-5", says="Fix: --duration"),
    ),
    Finding(
        "setting without its path",
        "run hovercraft/spin --set mass='3 kg'",
        "misleading advice",
        lambda: answers("run", "hovercraft/spin", "--set", "mass=3 kg", says="--set world.vehicle.mass="),
    ),
    Finding(
        "error as JSON",
        "run --json hovercraft/spinn",
        "plain text",
        lambda: answers("run", "--json", "hovercraft/spinn", says='"error": {"part"'),
    ),
    Finding(
        "metric without its kind",
        "campaign hovercraft/spin --success 'yaw_rate < 0.1'",
        "misleading advice",
        lambda: answers("campaign", "hovercraft/spin", "--success", "yaw_rate < 0.1", says="settling:yaw_rate < 0.1"),
    ),
    Finding(
        "picture as folder",
        "demo --out d.png",
        "a folder d.png",
        lambda: answers("demo", "--out", "d.png", says="must name a folder"),
    ),
    Finding(
        "too many runs",
        "campaign hovercraft/spin --runs 5e9",
        "a minute, then a traceback",
        lambda: answers("campaign", "hovercraft/spin", "--runs", "5e9", says="must be a whole number from 1 to"),
    ),
    Finding(
        "typo of a scenario or a first word",
        "run hovercraft/spinn, campaign hovercraft/spin --set wrld.mass=3",
        "2.5 to 4.6 s before the message",
        lambda: run_tests("commands/test_output.py::test_typo_is_reported_before_heavy_imports"),
    ),
    Finding(
        "typo in a path, after a run or a first typo",
        "run hovercraft/spin --set world.vehicle.mas=3",
        "3.4 s before the message",
        lambda: run_tests(
            "commands/test_output.py::test_repeated_wrong_path_is_reported_without_importing_jax",
            "commands/test_output.py::test_run_caches_setting_paths_of_scenario",
        ),
    ),
    Finding(
        "full disk",
        "list > /dev/full",
        "a traceback of 40 lines",
        lambda: run_tests("commands/test_standard_streams.py::test_full_disk_prints_one_line_and_exits_with_1"),
    ),
    Finding(
        "narrow terminal",
        "run hovercraft/zero-velocity, with COLUMNS=60 and 80",
        "digits are cut",
        lambda: run_tests("commands/test_output.py"),
    ),
    Finding(
        "long work without a terminal",
        "campaign … 2> file",
        "six minutes without a word",
        lambda: run_tests("commands/test_progress.py"),
    ),
    Finding(
        "own names of Python calls",
        "trimtab.list(), simulate(name, dt=0.01), log.time, log[0], scenario.vehicle",
        "19 bare AttributeErrors or TypeErrors",
        lambda: run_tests(
            "test_front_door.py::test_common_alternative_name_suggests_ours",
            "core/test_explain_call.py",
            "logs/test_log.py::test_unknown_attribute_error_suggests_a_replacement",
            "loop/test_summary.py::test_missing_scenario_member_error_says_what_to_write",
        ),
    ),
    Finding(
        "demo",
        "demo",
        "the yaw rate rises to the end, and no verdict",
        lambda: run_tests("test_cli.py::test_demo_verdict_matches_settling_times"),
    ),
    Finding(
        "commands of the front page",
        "each command of README.md as printed",
        "command not found",
        lambda: run_tests("docs/test_front_pages.py::test_every_readme_command_is_valid"),
    ),
    Finding(
        "picture of a run",
        "run … --plot x.png",
        "17 to 22 equal panels, no plan view, no limits, no verdict",
        lambda: run_tests("plots/test_run.py"),
    ),
    Finding(
        "firmware of any vehicle",
        "firmware vessel/path",
        "every vehicle but the fan hovercraft is refused",
        lambda: run_tests("firmware/test_any_vehicle.py::test_pulse_tables_map_each_component_of_the_command"),
    ),
    Finding("slips in an own law or vehicle", "44 files", "tracebacks, wrong advice", _own_slips),
    Finding("short reprs", "repr(scenario), repr(log)", "4 692 to 33 483 characters", _short_reprs),
    Finding("scenario by name", 'simulate("hovercraft/forward")', "TypeError", _by_name),
]
