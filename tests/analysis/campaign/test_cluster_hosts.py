"""Campaigns on a cluster of two hosts: access control, and a cut cable."""

import re
import subprocess
import sys
import time

import numpy as np
import pytest
from analysis.campaign.dask_processes import Processes, certificates, environment
from analysis.campaign.small import BLOCK, assert_same, small
from flight.transports.namespaces import FAR, NEAR, Hosts, why_not

from trimtab.analysis.campaign.store.store import read_store

pytestmark = pytest.mark.real_time

RUNS = 12 * BLOCK - 9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("cluster")
    certificates(made)
    (made / "other").mkdir()
    certificates(made / "other")
    return made


@pytest.fixture(scope="module")
def whole():
    return small(RUNS).run().columns


CLIENT = """
import sys
import numpy as np
from analysis.campaign.small import small
from trimtab.analysis.campaign.workers.cluster import cluster_workers
from trimtab.core.errors import InputError

uri, folder, runs, ca, host, out = sys.argv[1:]
try:
    workers = cluster_workers(uri, ca=f"{folder}/{ca}", cert=f"{folder}/{host}.pem", key=f"{folder}/{host}.key")
    np.savez(out, **small(int(runs)).run(workers=workers).columns)
except InputError as error:
    sys.exit(f"refused {error}")
"""
BARE = """
import socket, ssl, sys
context = ssl.create_default_context(cafile=sys.argv[1])
context.check_hostname = False
print(context.wrap_socket(socket.create_connection((sys.argv[2], 8786))).recv(1))
"""


@pytest.mark.skipif(bool(why_not()), reason=why_not())
def test_campaign_on_two_hosts_gives_the_same_rows(folder, whole, tmp_path):
    """Half a minute: scheduler and a worker on one host, a worker and the client on the other."""
    with Hosts() as hosts, Processes(folder, lambda host: hosts.inside(int(host in ("two", "desk")))) as processes:
        _, uri = processes.scheduler(NEAR, 8786)
        near, far = processes.worker("one", uri), processes.worker("two", uri)
        assert NEAR in near.log.read_text()
        assert FAR in far.log.read_text()

        def client(host, *words):
            program = [sys.executable, "-c", CLIENT, uri, str(folder), str(RUNS)]
            full = [*hosts.inside(host), *program, *words, str(tmp_path / "f.npz")]
            return subprocess.run(full, capture_output=True, text=True, env=environment(), timeout=200)

        done = client(1, "ca.pem", "desk")
        assert done.returncode == 0, done.stderr
        with np.load(tmp_path / "f.npz") as found:
            assert_same(dict(found), whole)
        assert "rejects the certificate" in client(1, "ca.pem", "other/desk").stderr
        assert "did not sign" in client(1, "other/ca.pem", "desk").stderr
        words = [*hosts.inside(1), sys.executable, "-c", BARE, str(folder / "ca.pem"), NEAR]
        none = subprocess.run(words, capture_output=True, text=True)
        assert "CERTIFICATE_REQUIRED" in none.stderr


CUT = """
import subprocess, sys, time
from analysis.campaign.small import small
from trimtab.analysis.campaign.workers.cluster import cluster_workers
from trimtab.core.errors import InputError

uri, folder, runs, store = sys.argv[1:]
files = {"ca": f"{folder}/ca.pem", "cert": f"{folder}/desk.pem", "key": f"{folder}/desk.key"}

def told(done):
    print(done, flush=True)
    time.sleep(0.5)

try:
    small(int(runs)).run(store, workers=cluster_workers(uri, **files), progress=told)
except InputError as error:
    print(error, flush=True)
"""


@pytest.mark.skipif(bool(why_not()), reason=why_not())
def test_cut_cable_ends_the_campaign_with_rows_stored(folder, whole, tmp_path):
    """A minute: the client's host is cut off in the middle of the campaign."""
    with Hosts() as hosts, Processes(folder, lambda host: hosts.inside(int(host == "desk"))) as processes:
        _, uri = processes.scheduler(NEAR, 8786)
        processes.worker("one", uri)
        words = [*hosts.inside(1), sys.executable, "-c", CUT, uri, str(folder), str(RUNS), str(tmp_path / "rows.zarr")]
        out = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        client = subprocess.Popen(words, env=environment(), **out)
        assert client.stdout.readline()
        assert client.stdout.readline()
        hosts.run(1, "ip", "link", "set", "vb", "down")
        began = time.monotonic()
        said, noise = client.communicate(timeout=120)
        print("ended after", time.monotonic() - began)
        assert time.monotonic() - began < 75
        assert re.search(r"scheduler (is gone|does not answer).*: [1-9]\d* finished runs are stored", said)
        assert "Traceback" not in noise
        assert small(RUNS).run(tmp_path / "rows.zarr").flown_runs < RUNS
        assert_same(read_store(tmp_path / "rows.zarr")[1], whole)
