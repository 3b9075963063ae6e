"""Stored flights: repeated requests are read from the store, and an interrupted search resumes."""

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.analysis.campaign.search.axes import axis_of_link, axis_of_path
from trimtab.analysis.campaign.search.falsify import falsify
from trimtab.analysis.campaign.search.stability_map import stability_map
from trimtab.analysis.campaign.search.tune import tune
from trimtab.analysis.campaign.store.memo import FlightMemo
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.scenarios.build import build

REST = "hovercraft/zero-velocity"
ASKED = (np.array([[0.25, 0.5]]), np.array([7], np.uint32))


class Flights:
    """Counts how often it is flown."""

    def __init__(self):
        self.count = 0

    def __call__(self):
        self.count += 1
        return {"margin": np.array([0.1, np.nan, np.inf]), "lost": np.array([False, True, False])}


def test_stored_flights_are_recalled_bit_for_bit(tmp_path):
    fly = Flights()
    first = FlightMemo(tmp_path / "new" / "store", {"seed": 1}).recall(ASKED, fly)
    memo = FlightMemo(tmp_path / "new" / "store", {"seed": 1})
    again = memo.recall(ASKED, fly)
    assert (fly.count, memo.recalled) == (1, 1)
    assert list(first) == list(again)
    for name, column in first.items():
        np.testing.assert_array_equal(again[name], column)
        assert again[name].dtype == column.dtype


@pytest.mark.parametrize(
    ("about", "asked"),
    [
        ({"seed": 2}, ASKED),
        ({"seed": 1}, (ASKED[0], np.array([8], np.uint32))),
        ({"seed": 1}, (ASKED[0].T, ASKED[1])),
        ({"seed": 1}, (ASKED[0].astype(np.float32), ASKED[1])),
    ],
    ids=["another seed", "another word", "another shape", "another type"],
)
def test_different_requests_are_flown_again(about, asked, tmp_path):
    fly = Flights()
    FlightMemo(tmp_path, {"seed": 1}).recall(ASKED, fly)
    FlightMemo(tmp_path, about).recall(asked, fly)
    assert fly.count == 2


def test_changed_scenario_file_is_flown_again(tmp_path):
    own, fly = tmp_path / "own.py", Flights()
    for text in ("mass = 1", "mass = 1", "mass = 2"):
        own.write_text(text)
        FlightMemo(tmp_path / "store", {}, f"{own}:scenario").recall(ASKED, fly)
    assert fly.count == 2


def test_damaged_memo_is_flown_again(tmp_path):
    fly = Flights()
    FlightMemo(tmp_path, {}).recall(ASKED, fly)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    FlightMemo(tmp_path, {}).recall(ASKED, fly)
    FlightMemo(None, {}).recall(ASKED, fly)
    assert fly.count == 3
    with pytest.raises(InputError, match="store"):
        FlightMemo(file / "folder", {})


class Stop:
    """Ctrl-C after so many calls of progress."""

    def __init__(self, after):
        self.left = after

    def __call__(self, more):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt


def fly_falsify(**more):
    spread, success = {"world.vehicle.mass": "uniform(80%, 120%)"}, ["error_rms:yaw_rate <= 0.5"]
    found = falsify(REST, spread=spread, success=success, settings={"duration": "3"}, runs=600, **more)
    return found.candidate_margins


def fly_tune(**more):
    gains = {"autopilot.law.k1": "0.5:3"}
    settings = {"duration": "3"}
    tuning = tune(
        REST, gains=gains, cost="error_rms:yaw_rate", settings=settings, runs=8, held_out=16, iterations=3, **more
    )
    return np.array(list(tuning.after.values()))


def fly_map(store=None, progress=lambda more: None):
    scenario = build(REST, {"duration": "3"})
    axes = axis_of_path("world.vehicle.mass", [1.0, 3.0, 5.0]), axis_of_link("loss", [0.0, 0.5, 0.9])
    memo = FlightMemo(store, {"scenario": REST})
    return stability_map(scenario, *axes, runs=2, depth=2, progress=progress, memo=memo).share


@pytest.mark.thorough
@pytest.mark.parametrize("fly", [fly_falsify, fly_tune, fly_map])
def test_interrupted_search_resumes_to_the_same_result(fly, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        fly(store=tmp_path, progress=Stop(0))
    kept = {file.name: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert kept
    went_on = fly(store=tmp_path)
    assert kept.items() <= {file.name: file.stat().st_mtime_ns for file in tmp_path.iterdir()}.items()
    np.testing.assert_array_equal(went_on, fly())


def test_ctrl_c_exits_130_and_keeps_the_store(monkeypatch, tmp_path):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    kept = []

    def search(*words, store, **more):
        store.mkdir()
        (store / "block.npz").write_text("")
        kept.append(store)
        if len(kept) == 1:
            raise KeyboardInterrupt
        raise InputError("here", "it ends")

    monkeypatch.setattr("trimtab.analysis.campaign.search.falsify.falsify", search)
    words = ["falsify", REST, "--spread", "world.vehicle.mass=uniform(80%, 120%)"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 130, done.output
    assert "the same command continues" in done.stderr
    kept[0].joinpath("block.npz").unlink()
    kept[0].rmdir()
    assert CliRunner().invoke(main, words).exit_code == 2
    assert kept[0] == kept[1]
