"""Whatever ends a campaign, no row is lost, none is double, and the message says how to go on."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from campaign.small import BLOCK, assert_same, small

from trimtab.campaign.campaign import Campaign
from trimtab.campaign.store import read_store
from trimtab.core.errors import InputError

RUNS = 20 * BLOCK - 5
CHILD = """
import sys, time
from campaign.small import small

def told(done):
    print(done, flush=True)
    time.sleep(float(sys.argv[3]))

small(int(sys.argv[2])).run(sys.argv[1], progress=told)
"""


@pytest.fixture(scope="module")
def whole():
    """Columns of the campaign that nothing interrupted, in memory."""
    return small(RUNS).run().columns


@pytest.fixture
def store(tmp_path):
    return tmp_path / "rows.zarr"


def start(store, runs=RUNS, pause=0.1, script=CHILD):
    paths = os.pathsep.join(p for p in [str(Path(__file__).parents[1]), *sys.path] if p)
    words = [sys.executable, "-c", script, str(store), str(runs), str(pause)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": paths})


def kept(store):
    return len(read_store(store)[1]["run"])


def test_killed_and_started_again_flies_what_is_missing(store, whole):
    child = start(store)
    for _ in range(4):
        assert child.stdout.readline()
    child.kill()
    child.communicate()
    there = kept(store)
    assert 4 * BLOCK <= there < RUNS
    told = []
    again = small(RUNS).run(store, progress=told.append)
    assert (again.flown, told[0], told[-1]) == (RUNS - there, there + BLOCK, RUNS)
    assert_same(again.columns, whole)
    assert small(RUNS).run(store).flown == 0


@pytest.mark.slow
def test_killed_at_any_moment(store, whole):
    """A minute: forty kills, from the store's first file to the last row."""
    rng, before = np.random.default_rng(0), 0
    for _ in range(40):
        child = start(store, pause=0)
        while not (store / ".lock").exists() or not child.stdout.readable():
            time.sleep(0.001)
        if before:
            child.stdout.readline()
        time.sleep(rng.uniform(0, 0.1))
        child.kill()
        child.communicate()
        if (store / "zarr.json").exists() and "identity" in json.loads((store / "zarr.json").read_text())["attributes"]:
            assert kept(store) >= before
            before = kept(store)
        if before == RUNS:
            break
    again = small(RUNS).run(store)
    assert again.flown == RUNS - before
    assert_same(again.columns, whole)


def test_interrupted_it_ends_soon_and_keeps_its_rows(store, whole):
    child = start(store)
    for _ in range(3):
        child.stdout.readline()
    child.send_signal(signal.SIGINT)
    began = time.monotonic()
    child.communicate()
    assert time.monotonic() - began < 5
    assert child.returncode != 0
    there = kept(store)
    assert 3 * BLOCK <= there < RUNS
    again = small(RUNS).run(store)
    assert again.flown == RUNS - there
    assert_same(again.columns, whole)


LONG = """
import sys
from campaign.small import small
from trimtab.campaign import here

real = here.fly_block

def fly_block(*given, **more):
    print("flies", flush=True)
    return real(*given, **more)

here.fly_block = fly_block
settings = {"duration": "300 s", "links": "measured", "world.uplink.capacity": "32"}
small(4096, block=2048, settings=settings).run(sys.argv[1])
"""


def test_interrupted_in_a_block_of_minutes(store):
    child = start(store, script=LONG)
    assert child.stdout.readline() == "flies\n"
    time.sleep(1)
    began = time.monotonic()
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    assert time.monotonic() - began < 10
    assert kept(store) == 0


def test_second_campaign_on_a_store_that_is_being_written(store, whole):
    child = start(store)
    child.stdout.readline()
    with pytest.raises(InputError, match=r"another campaign is writing it") as refused:
        small(RUNS).run(store)
    assert "--store OTHER.zarr" in refused.value.fix
    child.communicate()
    assert_same(read_store(store)[1], whole)


def test_store_of_another_campaign(store):
    small(2 * BLOCK).run(store)
    for other in ({"seed": 4}, {"metrics": ["peak:yaw_rate"]}, {"spread": {"world.vehicle.mass": "normal(100%, 5%)"}}):
        with pytest.raises(InputError, match="rows of another campaign: campaign") as refused:
            small(2 * BLOCK, **other).run(store)
        assert "OTHER.zarr" in refused.value.fix
    folder = store.parent / "photographs"
    (folder / "2024").mkdir(parents=True)
    (folder / "2024" / "cat.png").write_bytes(b"cat")
    with pytest.raises(InputError, match="other things in it"):
        small(2 * BLOCK).run(folder)
    assert (folder / "2024" / "cat.png").read_bytes() == b"cat"


def test_metric_of_a_file_that_was_changed(store, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def worst(rows):\n    return rows['yaw_rate'].max(axis=1)\n")
    asked = {"metrics": [f"{file}:worst"]}
    small(BLOCK, **asked).run(store)
    assert small(BLOCK, **asked).run(store).flown == 0
    file.write_text("def worst(rows):\n    return rows['yaw_rate'].min(axis=1)\n")
    with pytest.raises(InputError, match="another campaign: files"):
        small(BLOCK, **asked).run(store)


def test_more_runs_and_fewer(store, whole):
    first = small(5 * BLOCK + 7).run(store)
    assert_same(first.columns, {n: c[: 5 * BLOCK + 7] for n, c in whole.items()})
    more = small(RUNS).run(store)
    assert more.flown == RUNS - 5 * BLOCK - 7
    assert_same(more.columns, whole)
    fewer = small(100).run(store)
    assert (fewer.flown, fewer.success.trials) == (0, 100)
    assert_same(fewer.columns, {n: c[:100] for n, c in whole.items()})


@pytest.mark.parametrize("column", ["error_rms:yaw_rate", "success", "done"])
@pytest.mark.parametrize("torn", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: bytes(len(b)), None])
def test_chunk_that_a_crash_of_the_machine_tore(store, whole, column, torn):
    small(4 * BLOCK).run(store)
    chunk = store / column / "c" / "2"
    if torn:
        chunk.write_bytes(torn(chunk.read_bytes()))
        with pytest.raises(InputError, match=r"damaged(.|\n)*start the command that made it again"):
            read_store(store)
    else:
        chunk.unlink()
    again = small(4 * BLOCK).run(store)
    assert again.flown == BLOCK
    assert_same(again.columns, {n: c[: 4 * BLOCK] for n, c in whole.items()})


def test_what_killed_processes_leave_is_no_hindrance(store, monkeypatch, whole):
    def killed(*_):
        raise SystemExit

    with monkeypatch.context() as patched:
        patched.setattr("zarr.core.attributes.Attributes.update", killed)  # nothing says yet whose the arrays are
        with pytest.raises(SystemExit):
            small(BLOCK).run(store)
    assert (store / "done" / "zarr.json").exists()
    left = store / "done" / "zarr.0123.partial"
    left.write_bytes(b"half")
    assert_same(small(BLOCK).run(store).columns, {n: c[:BLOCK] for n, c in whole.items()})
    assert not left.exists()
    (store / "zarr.json").write_text('{"zarr_fo')
    with pytest.raises(InputError, match="damaged"):
        small(BLOCK).run(store)


FULL = """
import os, subprocess, sys
from campaign.small import small
from trimtab.core.errors import InputError

place = sys.argv[1]
mount = lambda *options: subprocess.run(("mount", *options, place), check=True)
mount("-t", "tmpfs", "-o", f"size={sys.argv[3]},mode=700", "tmpfs")
runs = int(sys.argv[2])
for size in ("64m", None):
    try:
        found = small(runs).run(f"{place}/rows.zarr")
        print(found.flown, flush=True)
    except InputError as error:
        print(error.part, error.problem, error.fix, sep="|", flush=True)
        mount("-o", f"remount,size={size}")
import numpy as np
np.savez(sys.argv[4], **found.columns)
"""


@pytest.mark.parametrize("size", ["8k", "200k"])
def test_disk_that_is_full(tmp_path, whole, size):
    (tmp_path / "disk").mkdir()
    own = ["unshare", "--mount"] if os.getuid() == 0 else ["unshare", "-rm"]
    trial = [*own, "mount", "-t", "tmpfs", "tmpfs", str(tmp_path / "disk")]
    if shutil.which("unshare") is None or subprocess.run(trial, capture_output=True).returncode:
        pytest.skip("no permission to mount file systems")
    paths = os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)])
    words = [*own, sys.executable, "-c", FULL, str(tmp_path / "disk"), str(RUNS), size, str(tmp_path / "found.npz")]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths})
    assert done.returncode == 0, done.stderr
    refused, flown = done.stdout.splitlines()
    assert "rows.zarr" in refused
    there = RUNS - int(flown)
    if size == "200k":
        assert "the disk is full" in refused
        assert f": {there} runs are kept" in refused
        assert "start the same command again" in refused
        assert 0 < there < RUNS
    else:
        assert "No space left" in refused
        assert there == 0
    with np.load(tmp_path / "found.npz") as found:
        assert_same(dict(found), whole)


@pytest.mark.parametrize("how", [{"threads": 1}, {"threads": 2}, {"block": 128}, {"block": 1000}, {"store": True}])
def test_same_rows_bit_for_bit(how, whole, store):
    of = small(RUNS, block=how.get("block", BLOCK))
    assert_same(of.run(store if "store" in how else None, threads=how.get("threads")).columns, whole)


@pytest.mark.slow
def test_same_rows_of_jax_in_any_blocks():
    """Half a minute: four programs are compiled."""
    wanted = small(130, block=2048).run(backend="jax").columns
    assert_same(small(130, block=40).run(backend="jax").columns, wanted)


def test_row_is_that_of_a_single_run(whole):
    of = small(RUNS)
    for run in (0, 77, RUNS - 1):
        row = of.row(run, of.rerun(run))
        assert {n: row[n] for n in row} == {n: whole[n][run] for n in row}


def test_workers_elsewhere_take_only_what_has_a_name():
    by_object = Campaign(small(1).scenario(0), runs=64)
    for of in (by_object, small(64, metrics=[lambda rows: rows["yaw_rate"][:, -1]])):
        with pytest.raises(InputError, match="can't be given an object") as refused:
            of.run(workers=lambda *_: iter(()))
        assert "file.py:function" in refused.value.fix
