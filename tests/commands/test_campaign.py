"""`trimtab campaign`: table, JSON, exit codes, the store, and the rerun of one run."""

import json
import re

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.campaign import drop_option
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

SCENARIO = "hovercraft/zero-velocity"
ASKED = [
    SCENARIO,
    "--runs",
    "80",
    "--seed",
    "3",
    "--set",
    "duration=4",
    "--spread",
    "world.vehicle.mass=normal(100%, 5%)",
]
ASKED += ["--metric", "error_rms:yaw_rate", "--success", "error_rms:yaw_rate <= 3.49"]


def typed(*words):
    return CliRunner().invoke(main, ["campaign", *ASKED, *words])


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    return folder, typed("--store", str(folder / "a.zarr"), "--json")


@pytest.mark.thorough
def test_json_reports_runs_success_share_and_metrics(kept):
    _, result = kept
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["runs"] == found["flown"] == 80
    assert found["success"]["low"] < found["success"]["share"] < found["success"]["high"]
    assert len(found["failed"]) == round(80 * (1 - found["success"]["share"]))
    assert set(found["metrics"]["error_rms:yaw_rate"]) >= {"median", "median_low", "p95", "largest"}


@pytest.mark.thorough
def test_out_folder_contains_table_and_pictures(kept):
    folder, _ = kept
    found = json.loads(typed("--store", str(folder / "a.zarr"), "--out", str(folder / "pictures"), "--json").stdout)
    names = {f.name for f in (folder / "pictures").iterdir()}
    assert "campaign.parquet" in names
    assert {"convergence.png", "histogram-error_rms-yaw_rate.png"} <= names
    assert "parallel-coordinates.png" not in names, "one varied parameter has no second axis"
    assert {str(folder / "pictures" / n) for n in names} == set(found["files"])


@pytest.mark.thorough
def test_repeated_command_reuses_store_and_reports_same_result(kept):
    folder, result = kept
    again = json.loads(typed("--store", str(folder / "a.zarr"), "--json").stdout)
    assert again["flown"] == 0
    assert again["success"] == json.loads(result.stdout)["success"]


def test_large_store_size_is_reported_while_writing(tmp_path, monkeypatch):
    monkeypatch.setattr("trimtab.commands.progress.LARGE", 1000)
    shown, folder = typed("--store", str(tmp_path / "a.zarr")), tmp_path / "a.zarr"
    assert shown.exit_code == 0, shown.output
    (said,) = re.findall(r"^store: about ([0-9.]+) kB$", shown.stderr, re.MULTILINE)
    size = sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 1000
    assert float(said) == pytest.approx(size, rel=0.1)


@pytest.mark.thorough
def test_rerun_equals_stored_run_bit_for_bit(kept):
    folder, _ = kept
    once = typed("--store", str(folder / "a.zarr"), "--rerun", "41", "--out", str(folder / "41"))
    assert once.exit_code == 0, once.output
    assert "equal to the stored run, bit for bit" in once.stdout
    assert {f.name for f in (folder / "41").iterdir()} == {"run-41.mcap", "run-41.png"}


def test_requirements_decide_the_exit_code(kept):
    folder, result = kept
    share = json.loads(result.stdout)["success"]["share"]
    store = ("--store", str(folder / "a.zarr"))
    assert typed(*store, "--require", f"success >= {share - 0.2:.3f} @ 95%").exit_code == 0
    refused = typed(*store, "--require", f"success >= {share + 0.15:.3f} @ 95%")
    assert refused.exit_code == 1
    assert "not met" in refused.stdout


def test_table_lists_failed_runs_and_rerun_command(kept):
    folder, result = kept
    shown = typed("--store", str(folder / "a.zarr")).stdout
    failed = json.loads(result.stdout)["failed"]
    assert "error_rms:yaw_rate" in shown
    assert f"failed: {failed[0]}" in shown
    assert f"--rerun {failed[0]}" in shown


@pytest.mark.parametrize("typed_out", ["--out camp", "--out=camp"])
def test_rerun_command_omits_out_folder(typed_out):
    command = f"trimtab campaign a/b --runs 5 {typed_out} --spread 'm=uniform(80%, 120%)'"
    assert drop_option(command, "--out") == "trimtab campaign a/b --runs 5 --spread 'm=uniform(80%, 120%)'"
    assert drop_option("trimtab campaign a/b", "--out") == "trimtab campaign a/b"


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--spread", "world.vehicle.inertia"], "not of the form PATH=DISTRIBUTION"),
        (["--spread", "world.vehicle.mass=normal(1, 2)"], "named twice"),
        (["--correlate", "world.vehicle.mass=0.3"], "not PATH,PATH=NUMBER"),
        (["--require", "success > 0.99"], "unknown comparison"),
        (["--require", "p95(settling:yaw_rate) <= 3"], "settling:yaw_rate"),
        (["--stop", "width(success) <= 2"], "not a valid width"),
        (["--device", "gpu"], "no GPU"),
        (["--rerun", "80"], "run 80 does not exist"),
        (["--cluster", "tcp://10.0.0.1:8786"], "tls://"),
    ],
)
def test_invalid_options_are_rejected_with_fix(words, problem):
    result = typed(*words)
    assert result.exit_code == 2, result.output
    assert problem in result.stderr
    assert "Fix:" in result.stderr


def test_rejects_store_of_another_campaign(kept):
    folder, _ = kept
    other = typed("--store", str(folder / "a.zarr"), "--spread", "autopilot.law.k2=normal(100%, 5%)")
    assert other.exit_code == 2
    assert "another campaign" in other.stderr


@pytest.mark.thorough
def test_run_option_flies_same_run_as_simulate():
    """`trimtab run --run` repeats a run that a search found."""
    asked = ["run", SCENARIO, "--seed", "3", "--run", "5", "--duration", "4 s", "--no-ideal", "--json"]
    found = json.loads(CliRunner().invoke(main, asked).stdout)
    log = simulate(build(SCENARIO, {"duration": "4"}), seed=3, run=5)
    assert found["run"] == 5
    assert found["real"]["final"]["yaw_rate"] == log.final["truth.yaw_rate"]
    assert log.final["truth.yaw_rate"] != simulate(build(SCENARIO, {"duration": "4"}), seed=3).final["truth.yaw_rate"]


@pytest.mark.thorough
def test_animation_shows_the_runs_or_one_run(tmp_path):
    done = typed("--animate", str(tmp_path / "all.gif"), "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["files"] == [str(tmp_path / "all.gif")]
    done = typed("--rerun", "2", "--animate", str(tmp_path / "one.gif"))
    assert f"wrote {tmp_path / 'one.gif'}" in done.stdout, done.output
    cart = ["campaign", "examples/my_cart.py:scenario", "--runs", "4"]
    for words, says in (
        ((*cart, "--animate", "paths.gif"), "has no north and east"),
        ((*cart, "--animate", "paths.png"), "does not end in .gif"),
    ):
        refused = CliRunner().invoke(main, words)
        assert refused.exit_code == 2
        assert says in refused.stderr
