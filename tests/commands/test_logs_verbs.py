"""`trimtab plot`, `compare` and `completion` by command line."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.typed_names import keep_paths
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.mcap import write_mcap

REST = "hovercraft/zero-velocity"


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Folder with two flights, the second with another mass."""
    folder = tmp_path_factory.mktemp("flights")
    for name, more in (("a", ()), ("b", ("--set", "world.vehicle.mass=2.7 kg"))):
        done = call("run", REST, "--duration", "1", "--no-ideal", *more, "--out", str(folder / name))
        assert done.exit_code == 0, done.output
    return folder


def call(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.mark.thorough
def test_plot_draws_only_named_signals(flights):
    log, picture = flights / "a" / "run.mcap", flights / "some.svg"
    done = call("plot", log, "truth.yaw_rate", "actuators.*", "--until", "500 ms", "--plot", picture, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["signals"][0] == "truth.yaw_rate"
    assert len(said["signals"]) > 2
    assert said["rows"] == 500
    assert "truth.yaw_rate" in picture.read_text()


@pytest.mark.thorough
def test_run_draws_animation_and_refuses_other_formats(tmp_path):
    done = call("run", REST, "--duration", "0.3", "--animate", tmp_path / "a.gif")
    assert done.exit_code == 0, done.output
    assert f"wrote {tmp_path / 'a.gif'}" in done.stdout
    assert (tmp_path / "a.gif").read_bytes()[:6] == b"GIF89a"
    refused = call("run", REST, "--animate", tmp_path / "a.mp4")
    assert refused.exit_code == 2
    assert f"--animate {tmp_path / 'a.gif'}" in refused.stderr


def test_plot_draws_animation_of_a_log(tmp_path):
    ticks = np.arange(4) * ms(100)
    log = tmp_path / "run.mcap"
    write_mcap(Log(to_seconds(ticks), ticks, {"truth.north": 0.1 * ticks, "truth.east": 0.0 * ticks}), log)
    done = call("plot", log, "--animate", tmp_path / "b.gif", "--json")
    assert json.loads(done.stdout)["files"] == [str(tmp_path / "b.gif")]
    assert (tmp_path / "b.gif").read_bytes()[:6] == b"GIF89a"
    (tmp_path / "own.gif").write_bytes(b"GIF89a of the user")
    for wrong, says in (("b.mp4", "does not end in .gif"), ("own.gif", "--overwrite")):
        refused = call("plot", log, "--animate", tmp_path / wrong)
        assert refused.exit_code == 2
        assert says in refused.stderr


@pytest.mark.thorough
def test_plot_works_without_signals_and_rejects_unknown_signal(flights):
    assert call("plot", flights / "b" / "run.mcap").exit_code == 0  # the run's own picture lies there: it is trimtab's
    refused = call("plot", flights / "b" / "run.mcap", "truth.yaw_rat")
    assert refused.exit_code == 2
    assert "truth.yaw_rate" in refused.stderr


@pytest.mark.thorough
def test_compare_reports_first_difference_between_two_flights(flights, tmp_path):
    logs = (flights / "a" / "run.mcap", flights / "b" / "run.mcap")
    done = call("compare", *logs, "--plot", tmp_path / "both.png")
    assert done.exit_code == 1
    assert done.stdout.startswith("DIFFERENT from 0.0")
    assert (tmp_path / "both.png").is_file()
    same = call("compare", logs[0], logs[0], "--json")
    assert same.exit_code == 0
    assert json.loads(same.stdout)["equal"] is True


@pytest.mark.thorough
def test_compare_with_one_log_repeats_the_flight(flights):
    done = call("compare", flights / "b" / "run.mcap", "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["equal"]
    assert said["instants"] == 1000
    assert said["compared"] > 40


def complete(*words):
    """Return the completions of the last word."""
    given = {"_TRIMTAB_COMPLETE": "bash_complete", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    code = "from trimtab.cli import main; main(prog_name='trimtab')"
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | given, capture_output=True, text=True)
    return [line.partition(",")[2] for line in done.stdout.splitlines()]


@pytest.mark.thorough
def test_shell_completion_offers_verbs_scenarios_and_settings():
    assert set(complete("trimtab", "com")) == {"compare", "completion"}
    assert complete("trimtab", "run", "hovercraft/zero") == [REST]
    assert call("list", REST).exit_code == 0
    assert complete("trimtab", "run", REST, "--set", "world.vehicle.ma") == ["world.vehicle.mass="]


@pytest.mark.parametrize(
    ("words", "last", "offered"),
    [
        (["run", REST, "--set"], "world.vehicle.ma", ["world.vehicle.mass="]),
        (["run", REST, "--seed"], "", []),
        (["run", "hovercraft/spinn"], "--animat", ["--animate"]),
        (["rum"], "--see", []),
    ],
    ids=str,
)
def test_incomplete_lines_are_completed_without_errors(tmp_path, monkeypatch, words, last, offered):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path))
    keep_paths(REST, ["world.vehicle.mass", "world.vehicle.inertia"])
    found = ShellComplete(main, {}, "trimtab", "_TRIMTAB_COMPLETE").get_completions(words, last)
    assert [item.value for item in found] == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_script_for_each_shell(shell):
    done = call("completion", shell)
    assert done.exit_code == 0
    assert "_TRIMTAB_COMPLETE" in done.stdout
