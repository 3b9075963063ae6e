"""Campaigns on a cluster of this machine's processes, with certificates."""

import json
import re
import signal
import threading
import time

import pytest
from analysis.campaign.dask_processes import Processes, certificates, files
from analysis.campaign.small import BLOCK, assert_same, small

from trimtab.analysis.campaign.store.store import read_store
from trimtab.analysis.campaign.workers import cluster as of_cluster
from trimtab.analysis.campaign.workers.cluster import cluster_workers, fly_rows, machine_identity
from trimtab.analysis.campaign.workers.prepare import plan_from_dict, prepare_campaign, scenario_of
from trimtab.core.errors import InputError
from trimtab.loop.calibration import Calibration, Entry, format_calibration

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
RUNS = 12 * BLOCK - 9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("cluster")
    certificates(made)
    (made / "other").mkdir()
    certificates(made / "other")
    return made


@pytest.fixture
def processes(folder):
    with Processes(folder) as made:
        yield made


@pytest.fixture(scope="module")
def whole():
    return small(RUNS).run().columns


@pytest.mark.thorough
def test_rejects_invalid_addresses_and_certificate_files(folder):
    good = files(folder)
    for uri in (
        "10.0.0.1:8786",
        "tls://10.0.0.1",
        "tls://10.0.0.1:0",
        "tls://10.0.0.1:99999",
        "ssh://a:1",
        "tls://a b:1",
    ):
        with pytest.raises(InputError, match=r"must be tls://HOST:PORT"):
            cluster_workers(uri, **good)
    with pytest.raises(InputError, match="anyone who reaches the port can run programs") as refused:
        cluster_workers("tcp://10.0.0.1:8786")
    assert refused.value.fix.startswith('cluster="tls://10.0.0.1:8786" tls_ca=')
    with pytest.raises(InputError, match="does not use certificates"):
        cluster_workers("tcp://127.0.0.1:8786", **good)
    for flag, name in (("tls_ca", "ca"), ("tls_cert", "cert"), ("tls_key", "key")):
        with pytest.raises(InputError, match=f"^{flag}: tls:// needs"):
            cluster_workers("tls://10.0.0.1:8786", **{**good, name: ""})
        with pytest.raises(InputError, match=f"^{flag}: the file "):
            cluster_workers("tls://10.0.0.1:8786", **{**good, name: folder / "none.pem"})
    with pytest.raises(InputError, match="can't be used: KEY_VALUES_MISMATCH"):
        cluster_workers("tls://10.0.0.1:8786", **{**good, "key": folder / "one.key"})
    cluster_workers("tls://[::1]:8786", **good)
    cluster_workers("tcp://localhost:8786")


@pytest.mark.real_time
def test_unreachable_scheduler_is_reported_with_a_fix(folder):
    with pytest.raises(InputError, match="cannot reach a scheduler at this address: Connection refused") as refused:
        small(BLOCK).run(workers=cluster_workers("tls://127.0.0.1:9", **files(folder)))
    assert "dask scheduler --protocol tls --port 9" in refused.value.fix


@pytest.mark.thorough
def test_rejects_worker_that_would_compute_different_rows():
    ready = small(BLOCK).ready
    told = machine_identity(ready, "c")
    columns = fly_rows(ready.plan.as_dict(), told, 3, 7)
    whole = small(BLOCK).run().columns
    for name, column in columns.items():
        assert column.tobytes() == whole[name][3:7].tobytes()
    for name in told:
        with pytest.raises(InputError, match=f"would compute different rows: .*{name} is ") as refused:
            fly_rows(ready.plan.as_dict(), {**told, name: "other"}, 3, 7)
        assert ("a C compiler" in refused.value.fix) == (name == "backend")


@pytest.mark.real_time
def test_campaign_on_two_workers_and_rejected_certificates(folder, processes, whole, tmp_path, monkeypatch):
    _, uri = processes.scheduler()
    for host in ("one", "two"):
        processes.worker(host, uri)
    told = []
    found = small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)), progress=told.append)
    assert_same(found.columns, whole)
    assert (found.flown_runs, len(told)) == (RUNS, 12)
    assert small(RUNS).run(tmp_path / "rows.zarr").flown_runs == 0
    stranger = files(folder / "other")
    with pytest.raises(InputError, match="did not sign the scheduler's certificate"):
        small(BLOCK).run(workers=cluster_workers(uri, **stranger))
    with pytest.raises(InputError, match="the scheduler rejects the certificate: TLSV1_ALERT"):
        small(BLOCK).run(workers=cluster_workers(uri, **{**stranger, "ca": folder / "ca.pem"}))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def worst(rows):\n    return rows['yaw_rate'].max(axis=1)\n")
    with pytest.raises(InputError, match=r"worker tls://[^ ]+: metrics mine.py:worst: there is no file 'mine.py'"):
        small(BLOCK, metrics=["mine.py:worst"]).run(workers=cluster_workers(uri, **files(folder)))


BOAT = Calibration(
    {
        "Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002, procedure="inertia"),
        "Thruster.reverse_ratio": Entry([1.1e-3, -3.2e-2, 3.8e-1, -1.08], "1", procedure="reverse"),
    }
)


def with_boat(file, runs):
    """Return a campaign of a craft with a calibration file and a spread."""
    settings = {"links": "measured", "duration": "2 s", "world.uplink.capacity": "32", "calibration": str(file)}
    return small(runs, settings=settings)


@pytest.mark.thorough
def test_plan_contains_the_calibration_for_workers(tmp_path):
    file = tmp_path / "boat.toml"
    file.write_text(format_calibration(BOAT), encoding="utf-8")
    asked = with_boat(file, BLOCK)
    told = machine_identity(asked.ready, "jax")
    file.unlink()
    plain = json.loads(json.dumps(asked.ready.plan.as_dict()))
    assert "boat.toml" not in json.dumps(plain)
    columns = fly_rows(plain, told, 0, 2)
    own = small(BLOCK).run(backend="jax").columns
    assert scenario_of(prepare_campaign(plan_from_dict(plain)), 0).world.vehicle.inertia == 0.11
    assert columns["error_rms:yaw_rate"].tobytes() != own["error_rms:yaw_rate"][:2].tobytes()
    other = BOAT.merge(Calibration({"Hovercraft.inertia": Entry(0.12, "kg m^2", procedure="inertia")}))
    file.write_text(format_calibration(other), encoding="utf-8")
    assert machine_identity(with_boat(file, BLOCK).ready, "jax")["campaign"] != told["campaign"]


@pytest.mark.real_time
def test_remote_workers_fly_a_calibrated_craft(folder, processes, tmp_path):
    """The workers run in another folder, and the calibration file is deleted before they start."""
    file = tmp_path / "boat.toml"
    file.write_text(format_calibration(BOAT), encoding="utf-8")
    asked, wanted = with_boat(file, 2 * BLOCK), with_boat(file, 2 * BLOCK).run().columns
    file.unlink()
    _, uri = processes.scheduler()
    processes.worker("one", uri)
    assert_same(asked.run(workers=cluster_workers(uri, **files(folder))).columns, wanted)


class Slowly:
    """Tells how many rows are done, does something at some count, and takes its time."""

    def __init__(self, at, action):
        self._at, self._action, self.done = at, action, 0

    def __call__(self, done):
        self.done = done
        if self._action is not None and done >= self._at:
            action, self._action = self._action, None
            self.when = time.monotonic()
            action()
        time.sleep(0.1)


@pytest.mark.real_time
def test_killed_worker_loses_no_rows(folder, processes, whole, tmp_path):
    """Ten seconds."""
    _, uri = processes.scheduler()
    doomed = processes.worker("one", uri)
    processes.worker("two", uri)
    watch = Slowly(3 * BLOCK, doomed.kill)
    found = small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)), progress=watch)
    assert doomed.wait(5) == -signal.SIGKILL
    assert found.flown_runs == RUNS
    assert_same(found.columns, whole)


@pytest.mark.real_time
def test_killed_scheduler_ends_campaign_with_rows_stored(folder, processes, whole, tmp_path):
    """Ten seconds."""
    scheduler, uri = processes.scheduler()
    processes.worker("one", uri)
    watch = Slowly(3 * BLOCK, scheduler.kill)
    with pytest.raises(InputError, match=r"the scheduler is gone: [1-9][0-9]* finished runs are stored") as ended:
        small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)), progress=watch)
    print("ended after", time.monotonic() - watch.when)
    assert time.monotonic() - watch.when < 15
    assert "start the same command again" in ended.value.fix
    kept = int(re.search(r"(\d+) finished runs are stored", str(ended.value))[1])
    assert kept == len(read_store(tmp_path / "rows.zarr")[1]["run"]) < RUNS
    _, uri = processes.scheduler()
    processes.worker("one", uri)
    again = small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)))
    assert again.flown_runs == RUNS - kept
    assert_same(again.columns, whole)


@pytest.mark.real_time
def test_hanging_scheduler_ends_the_campaign_with_an_error(folder, processes, tmp_path):
    """A minute."""
    scheduler, uri = processes.scheduler()
    processes.worker("one", uri)
    watch = Slowly(2 * BLOCK, lambda: scheduler.send_signal(signal.SIGSTOP))
    with pytest.raises(
        InputError, match=r"scheduler (is gone|does not answer).*: [1-9][0-9]* finished runs are stored"
    ):
        small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)), progress=watch)
    print("ended after", time.monotonic() - watch.when)
    assert time.monotonic() - watch.when < 60


@pytest.mark.real_time
def test_killed_last_worker_ends_campaign_with_rows_stored(folder, processes, whole, tmp_path, monkeypatch):
    """Half a minute."""
    monkeypatch.setattr(of_cluster, "WORKER_TIMEOUT", 4.0)
    _, uri = processes.scheduler()
    only = processes.worker("one", uri)
    watch = Slowly(2 * BLOCK, only.kill)
    with pytest.raises(InputError, match=r"had no worker for 4 s: [1-9][0-9]* finished runs are stored"):
        small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)), progress=watch)
    print("ended after", time.monotonic() - watch.when)
    assert time.monotonic() - watch.when < 60
    monkeypatch.undo()
    only = processes.worker("one", uri)

    def replace():
        only.kill()
        threading.Timer(2.0, processes.worker, ("two", uri)).start()

    done = len(read_store(tmp_path / "rows.zarr")[1]["run"])
    watch = Slowly(done + BLOCK, replace)
    again = small(RUNS).run(tmp_path / "rows.zarr", workers=cluster_workers(uri, **files(folder)), progress=watch)
    assert again.flown_runs == RUNS - done
    assert_same(again.columns, whole)
