"""After any interruption of a campaign, no row is lost or duplicated, and the message states how to continue."""

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
from analysis.campaign.small import BLOCK, assert_same, small

from trimtab.analysis.campaign.store.store import read_store
from trimtab.core.errors import InputError

RUNS = 20 * BLOCK - 5
CHILD = """
import sys, time
from analysis.campaign.small import small

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


HEARS = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
"""A process whose ancestor was put into the background by a shell would not hear Ctrl-C."""


def start(store, runs=RUNS, pause=0.1, script=CHILD):
    paths = os.pathsep.join(p for p in [str(Path(__file__).parents[2]), *sys.path] if p)
    words = [sys.executable, "-c", HEARS + script, str(store), str(runs), str(pause)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": paths})


def flying(store, rows):
    """Start a campaign in a separate process and return once the given number of rows is stored."""
    child = start(store)
    while not (store / "done" / "c" / str(rows // BLOCK - 1)).exists():
        assert child.poll() is None
        time.sleep(0.01)
    return child


def kept(store):
    return len(read_store(store)[1]["run"])


@pytest.mark.real_time
def test_restart_after_kill_flies_only_missing_runs(store, whole):
    child = flying(store, 4 * BLOCK)
    child.kill()
    child.communicate()
    there = kept(store)
    assert 4 * BLOCK <= there < RUNS
    told = []
    again = small(RUNS).run(store, progress=told.append)
    assert (again.flown_runs, min(told) >= there, told[-1]) == (RUNS - there, True, RUNS)
    assert told == sorted(told), "two blocks under way, and one tale of how far it is"
    assert_same(again.columns, whole)
    assert small(RUNS).run(store).flown_runs == 0


@pytest.mark.real_time
def test_kill_at_any_moment_loses_no_stored_row(store, whole):
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
    assert again.flown_runs == RUNS - before
    assert_same(again.columns, whole)


@pytest.mark.real_time
def test_interrupted_campaign_ends_soon_and_keeps_its_rows(store, whole):
    child = flying(store, 3 * BLOCK)
    child.send_signal(signal.SIGINT)
    began = time.monotonic()
    child.communicate()
    assert time.monotonic() - began < 5
    assert child.returncode != 0
    there = kept(store)
    assert 3 * BLOCK <= there < RUNS
    again = small(RUNS).run(store)
    assert again.flown_runs == RUNS - there
    assert_same(again.columns, whole)


LONG = """
import sys
from analysis.campaign.small import small
from trimtab.analysis.campaign.workers import local

real = local.fly_block

def fly_block(*given, **more):
    print("flies", flush=True)
    return real(*given, **more)

local.fly_block = fly_block
settings = {"duration": "300 s", "links": "measured", "world.uplink.capacity": "32"}
small(4096, block=2048, settings=settings).run(sys.argv[1])
"""


@pytest.mark.real_time
def test_interrupt_during_a_long_block_ends_soon(store):
    child = start(store, script=LONG)
    assert child.stdout.readline() == "flies\n"
    time.sleep(1)
    began = time.monotonic()
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    assert time.monotonic() - began < 10
    assert kept(store) == 0


@pytest.mark.real_time
def test_rejects_second_campaign_writing_to_the_same_store(store, whole):
    child = flying(store, BLOCK)
    with pytest.raises(InputError, match=r"another campaign is writing to it") as refused:
        small(RUNS).run(store)
    assert 'store="OTHER.zarr"' in refused.value.fix
    child.communicate()
    assert_same(read_store(store)[1], whole)


@pytest.mark.thorough
def test_more_runs_extend_the_store_and_fewer_read_it(store, whole):
    first = small(5 * BLOCK + 7).run(store)
    assert_same(first.columns, {n: c[: 5 * BLOCK + 7] for n, c in whole.items()})
    more = small(RUNS).run(store)
    assert more.flown_runs == RUNS - 5 * BLOCK - 7
    assert_same(more.columns, whole)
    fewer = small(100).run(store)
    assert (fewer.flown_runs, fewer.success.trials) == (0, 100)
    assert_same(fewer.columns, {n: c[:100] for n, c in whole.items()})


FULL = """
import os, subprocess, sys
from analysis.campaign.small import small
from trimtab.core.errors import InputError

place = sys.argv[1]
mount = lambda *options: subprocess.run(("mount", *options, place), check=True)
mount("-t", "tmpfs", "-o", f"size={sys.argv[3]},mode=700", "tmpfs")
runs = int(sys.argv[2])
for size in ("64m", None):
    try:
        found = small(runs).run(f"{place}/rows.zarr")
        print(found.flown_runs, flush=True)
    except InputError as error:
        print(error.part, error.problem, error.fix, sep="|", flush=True)
        mount("-o", f"remount,size={size}")
import numpy as np
np.savez(sys.argv[4], **found.columns)
"""


@pytest.mark.thorough
@pytest.mark.parametrize("size", ["8k", "200k"])
def test_full_disk_error_states_stored_runs(tmp_path, whole, size):
    (tmp_path / "disk").mkdir()
    own = ["unshare", "--mount"] if os.getuid() == 0 else ["unshare", "-rm"]
    trial = [*own, "mount", "-t", "tmpfs", "tmpfs", str(tmp_path / "disk")]
    if shutil.which("unshare") is None or subprocess.run(trial, capture_output=True).returncode:
        pytest.skip("no permission to mount file systems")
    paths = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, sys.path)])
    words = [*own, sys.executable, "-c", FULL, str(tmp_path / "disk"), str(RUNS), size, str(tmp_path / "found.npz")]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths})
    assert done.returncode == 0, done.stderr
    refused, flown = done.stdout.splitlines()
    assert "rows.zarr" in refused
    there = RUNS - int(flown)
    if size == "200k":
        assert "the disk is full" in refused
        assert f"; {there} finished runs are stored" in refused
        assert "start the same command again" in refused
        assert 0 < there < RUNS
    else:
        assert "No space left" in refused
        assert there == 0
    with np.load(tmp_path / "found.npz") as found:
        assert_same(dict(found), whole)
