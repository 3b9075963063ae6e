"""Modules that start without JAX: all that declare, read, print or plot, but simulate no run."""

import os
import resource
import subprocess
import sys

import pytest

USE = """
import sys
import numpy as np
from click.testing import CliRunner
import trimtab.cli, trimtab.commands.flight_summary, trimtab.commands.run, trimtab.core.errors
import trimtab.logs.messages, trimtab.plots.run, trimtab.scenarios.catalogue
from trimtab.core.quantity import Quantity
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, metrics, mode_switches
from trimtab.logs.mcap import read_mcap, write_mcap

HEAVY = ("jax", "jaxlib", "scipy", "pandas", "xarray", "matplotlib", "PIL", "rich", "mcap", "difflib")
def absent(*names):
    loaded = [n for n in names if n in sys.modules]
    assert not loaded, loaded

absent(*HEAVY)
ticks = np.arange(0, 50) * 10_000
yaw = np.exp(-np.arange(50) / 10.0)
log = Log(
    t=to_seconds(ticks), ticks=ticks, signals={"truth.yaw_rate": yaw, "law.mode": np.zeros(50, np.int32)},
    declarations={
        "truth.yaw_rate": Quantity("rad/s", "Rate."), "law.mode": Quantity("1", "M.", kind="mode", modes=("a",)),
    },
    metadata={"scenario": "hand-made", "seed": 1}, final={"truth.yaw_rate": 0.0},
)
target = Target("yaw_rate", 0.0, 0.1)
found = metrics(log, [target], ["yaw_rate"])
assert found["yaw_rate"]["settling_s"] == 0.024, found
assert mode_switches(log) == 0
assert len(trimtab.plots.run.select_panels(log.between(0, 0.02))) == 2
absent(*HEAVY)
listed = CliRunner().invoke(trimtab.cli.main, ["list", "--json"])
assert "hovercraft/spin" in listed.stdout
absent(*HEAVY)
raised = {"law.saturated": {"for_s": 0.5, "first_s": 1.0}}
flown = {"metrics": found, "final": {"yaw_rate": 0.0}, "mode_switches": 0, "flags": raised, "lost_s": 2.0}
result = {"scenario": "x", "seed": 1, "duration_s": 1.0, "ideal": None, "real": flown}
trimtab.commands.flight_summary.print_result(result, {"yaw_rate": "rad/s"})
assert "rich" in sys.modules
file = write_mcap(log, sys.argv[1] + "/log.mcap")
assert (read_mcap(file)["truth.yaw_rate"] == yaw).all()
absent("jax", "jaxlib", "scipy", "pandas", "xarray", "matplotlib")
trimtab.plots.run.plot_run(log, None, sys.argv[1] + "/log.png", targets=[target])
assert "matplotlib" in sys.modules
absent("jax", "jaxlib", "scipy", "pandas", "xarray")
"""


def run(text, *words):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("COV_", "COVERAGE"))}
    return subprocess.run([sys.executable, "-c", text, *words], env=environment, capture_output=True, text=True)


@pytest.mark.thorough
def test_logs_metrics_tables_and_plots_work_without_jax(tmp_path):
    done = run(USE, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "yaw_rate (rad/s)" in done.stdout


@pytest.mark.parametrize(
    "module",
    [
        "trimtab.cli",
        "trimtab.logs.samples",
        "trimtab.logs.log",
        "trimtab.logs.mcap",
        "trimtab.logs.stream",
        "trimtab.plots.dilution",
        "trimtab.plots.navigation",
        "trimtab.plots.replay",
        "trimtab.plots.run",
        "trimtab.plots.tracking",
        "trimtab.run.program",
    ],
)
def test_modules_for_logs_plots_and_compiled_flight_import_without_jax(module):
    done = run(f"import sys, {module}\nprint('jax' in sys.modules)")
    assert done.stdout == "False\n", done.stderr


@pytest.mark.parametrize(
    "module", ["trimtab.cli", "trimtab.commands.options", "trimtab.commands.output", "trimtab.commands.list"]
)
def test_the_command_starts_without_numpy(module):
    heavy = ("numpy", "jax", "rich", "importlib.metadata")
    done = run(f"import sys, {module}\nprint([m for m in {heavy} if m in sys.modules])")
    assert done.stdout == "[]\n", done.stderr


def test_help_describes_every_verb_without_importing_them():
    code = """
import sys
from click.testing import CliRunner
from trimtab.cli import VERBS, main
listed = CliRunner().invoke(main, ["--help"], terminal_width=500).stdout
assert CliRunner().invoke(main, ["rnu"]).exit_code == 2
modules = {name: f"trimtab.commands.{name.replace('-', '_')}" for name in VERBS}
assert not set(modules.values()) & set(sys.modules)
import importlib
for name, module in modules.items():
    command = importlib.import_module(module).command
    assert f"  {name}  " in listed, name
    assert command.get_short_help_str(500) in listed, name
"""
    done = run(code)
    assert done.returncode == 0, done.stderr


def test_navigation_assessment_imports_no_jax_or_scipy_stats():
    done = run("import sys, trimtab.logs.navigation\nprint({'jax', 'scipy.stats'} & set(sys.modules))")
    assert done.stdout == "set()\n", done.stderr


def cpu_seconds(*words):
    """CPU time of a command (s), the lesser of two, and what it said on standard error."""
    took = []
    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, "-m", "trimtab", *words], capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        took.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(took), done.stderr


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("smulate hovercraft/spin", "run"),
        ("run hovercraft/spinn", "hovercraft/spin"),
        ("list hovercraft/spinn", "hovercraft/spin"),
        ("campaign hovercraft/spinn --runs 10", "hovercraft/spin"),
        ("fly hovercraft/spinn", "hovercraft/spin"),
        ("trim hovercraft/spinn", "hovercraft/spin"),
    ],
)
def test_typo_is_answered_within_four_times_version_cpu_time(typed, meant):
    """The limit is four times the CPU time of --version. Importing JAX alone takes more than ten times."""
    version, _ = cpu_seconds("--version")
    took, said = cpu_seconds(*typed.split())
    assert meant in said
    assert took < 4 * version
