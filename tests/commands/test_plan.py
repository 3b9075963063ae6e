"""Plans: found again when nothing has changed, not found when anything has; trouble means no plan, never an error."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from trimtab.commands import plan as module
from trimtab.commands.plan import FORMAT, CachedRun, find_run, keep_run

REQUEST = {"scenario": "hovercraft/spin", "settings": {"world.vehicle.mass": "3"}, "without": [], "ideal": True}
PLAN = CachedRun(
    {"library": "x.so", "metadata": {"targets": [["yaw_rate", 3.0, 0.1]], "text": "ψ", "none": None}},
    {
        "parameters": np.array([1.5, np.nan, -np.inf, -0.0]),
        "rows": np.arange(12, dtype=np.int32).reshape(3, 4),
        "word": np.uint32(7),
        "flags": np.array([True, False]),
        "empty": np.zeros((0, 3)),
    },
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache of the test's own; and files count as settled though the test has just written them."""
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("trimtab.commands.sources.START_NS", time.time_ns() + 3600 * 10**9)
    return tmp_path / "cache" / "plans"


@pytest.fixture
def boat(tmp_path):
    file = tmp_path / "boat.py"
    file.write_text("MASS = 2.6\n")
    return file


def kept(request=REQUEST, plan=PLAN, files=()):
    assert find_run(request) is None
    assert keep_run(request, plan, files)
    return request


def test_what_was_kept_is_found_to_the_bit(folder):
    found = find_run(kept())
    assert found is not None
    assert found.content == PLAN.content
    assert list(found.arrays) == list(PLAN.arrays)
    for name, array in PLAN.arrays.items():
        assert found.arrays[name].dtype == array.dtype
        assert found.arrays[name].shape == array.shape
        assert found.arrays[name].tobytes() == array.tobytes()
    (file,) = folder.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(
    "other",
    [REQUEST | {"scenario": "hovercraft/forward"}, REQUEST | {"ideal": False}, REQUEST | {"settings": {}}, {}],
)
def test_another_request_has_no_plan(other):
    kept()
    assert find_run(other) is None


def test_numbers_that_are_not_finite_come_back():
    kept(plan=CachedRun({"a": [float("inf"), float("nan")]}, {}))
    assert repr(find_run(REQUEST)) == "Plan(content={'a': [inf, nan]}, arrays={})"


def test_order_of_the_request_does_not_matter():
    kept()
    assert find_run(dict(reversed(REQUEST.items()))) is not None


def test_a_later_plan_replaces_the_earlier():
    kept()
    assert keep_run(REQUEST, CachedRun({"library": "y.so"}, {}), [])
    assert find_run(REQUEST) == CachedRun({"library": "y.so"}, {})


def test_a_change_of_the_users_file_is_seen_even_with_its_size_and_time_kept(boat):
    kept(files=[boat])
    assert find_run(REQUEST) is not None
    about = boat.stat()
    boat.write_text("MASS = 2.7\n")
    os.utime(boat, ns=(about.st_atime_ns, about.st_mtime_ns))
    assert find_run(REQUEST) is None
    boat.write_text("MASS = 2.6\n")
    assert find_run(REQUEST) is not None
    boat.unlink()
    assert find_run(REQUEST) is None


def test_names_of_files_are_looked_for_at_the_same_place(boat, tmp_path, monkeypatch):
    kept(files=[boat])
    kept(REQUEST | {"seedless": True})
    monkeypatch.chdir(tmp_path)
    assert find_run(REQUEST) is None
    assert find_run(REQUEST | {"seedless": True}) is not None  # made from no file of the user's: any place will do
    monkeypatch.undo()


def test_a_search_path_of_another_order_is_another_place(boat, tmp_path, monkeypatch):
    kept(files=[boat])
    monkeypatch.syspath_prepend(tmp_path)
    assert find_run(REQUEST) is None


def test_place_is_where_the_process_was_when_it_asked(boat, tmp_path, monkeypatch):
    """A scenario that changes the folder while it is loaded."""
    assert find_run(REQUEST) is None
    here = Path.cwd()
    monkeypatch.chdir(tmp_path)
    assert keep_run(REQUEST, PLAN, [boat])
    assert find_run(REQUEST) is None
    monkeypatch.chdir(here)
    assert find_run(REQUEST) is not None


def test_without_asking_first_nothing_is_kept(monkeypatch):
    monkeypatch.setattr(module, "_search_paths", {})
    assert not keep_run(REQUEST, PLAN, [])


def test_a_file_changed_since_the_program_began_keeps_the_plan_out(boat, monkeypatch):
    monkeypatch.setattr("trimtab.commands.sources.START_NS", time.time_ns())
    assert find_run(REQUEST) is None
    assert not keep_run(REQUEST, PLAN, [boat])
    os.utime(boat, (0, 0))  # a time set back by hand: the time of the change of the inode still tells
    assert not keep_run(REQUEST, PLAN, [boat])


@pytest.mark.parametrize("what", ["contents", "installed", "python"])
def test_changed_surroundings_make_another_key(what, tmp_path, monkeypatch):
    site = tmp_path / "site-packages"
    site.mkdir()
    (site / "jax-0.10.2.dist-info").mkdir()
    package = tmp_path / "package"
    package.mkdir()
    (package / "a.py").write_text("X = 1\n")
    monkeypatch.setattr("trimtab.commands.sources.PACKAGE", str(package))
    monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    module._environment.cache_clear()
    try:
        kept()
        if what == "contents":
            (package / "a.py").write_text("X = 2\n")
        elif what == "installed":
            (site / "jax-0.10.2.dist-info").rename(site / "jax-0.10.3.dist-info")
        else:
            monkeypatch.setattr(sys, "version", "3.99")
        assert find_run(REQUEST) is not None  # this process goes on with what it has loaded
        module._environment.cache_clear()
        assert find_run(REQUEST) is None
    finally:
        module._environment.cache_clear()


def damaged(data):
    body = len(FORMAT) + 32
    yield "empty", b""
    yield "cut in the first line", data[:7]
    yield "cut in the digest", data[: len(FORMAT) + 5]
    yield "cut at the end", data[:-1]
    yield "longer", data + b"\0"
    yield "older", b"trimtab plan 0\n" + data[len(FORMAT) :]
    yield "foreign", b"\x89PNG" * 1000
    for at in (len(FORMAT), body, body + 9, len(data) // 2, len(data) - 1):
        yield f"bit {at}", data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


def test_damaged_files_are_no_plan_and_are_replaced(folder):
    kept()
    (file,) = folder.iterdir()
    data = file.read_bytes()
    for what, bad in damaged(data):
        file.write_bytes(bad)
        assert find_run(REQUEST) is None, what
    assert keep_run(REQUEST, PLAN, [])
    assert find_run(REQUEST) is not None


def test_whole_files_that_are_something_else_are_no_plan(folder):
    """With a right digest: what another program, or another version, may have packed."""
    import hashlib

    kept()
    (file,) = folder.iterdir()

    def put(text, tail=b""):
        body = len(text).to_bytes(8, "little") + text + tail
        file.write_bytes(FORMAT + hashlib.sha256(body).digest() + body)

    right = {"key": file.stem, "files": {}, "place": [], "content": {}, "arrays": []}
    put(json.dumps(right).encode())
    assert find_run(REQUEST) == CachedRun({}, {})
    for wrong in (
        [],
        3,
        right | {"key": "0" * 64},
        right | {"arrays": ["a"]},
        right | {"files": {"/nowhere/at/all.py": "0"}},
        {k: v for k, v in right.items() if k != "files"},
    ):
        put(json.dumps(wrong).encode())
        assert find_run(REQUEST) is None, wrong
    put(b"{")
    assert find_run(REQUEST) is None
    put(json.dumps(right).encode(), b"more")
    assert find_run(REQUEST) is None


def test_a_plan_under_another_requests_name_is_no_plan(folder):
    kept()
    (file,) = folder.iterdir()
    other = REQUEST | {"ideal": False}
    file.rename(folder / (module._cache_name(other) + ".plan"))
    assert find_run(other) is None


class Runs:
    """An object that would leave a trace if it were unpickled."""

    def __reduce__(self):
        return os.mkdir, ("unpickled",)


@pytest.mark.parametrize(
    "plan",
    [
        CachedRun({"a": object()}, {}),
        CachedRun({"a": {1, 2}}, {}),
        CachedRun({}, {"a": np.array([Runs()], object)}),
        CachedRun({}, {("a",): np.zeros(1)}),  # pyright: ignore[reportArgumentType]
        CachedRun({"a": (1, 2)}, {}),
        CachedRun({"a": {1: 2}}, {}),
    ],
    ids=["object", "set", "object array", "name that is no text", "tuple", "key that is no text"],
)
def test_what_cannot_be_stored_is_not_kept_and_leaves_nothing(plan, folder):
    assert find_run(REQUEST) is None
    assert not keep_run(REQUEST, plan, [])
    assert list(folder.iterdir()) == []


def test_a_request_or_file_that_cannot_be_read_is_not_kept(tmp_path):
    assert find_run({"path": Path()}) is None
    assert not keep_run({"path": Path()}, PLAN, [])
    assert find_run(REQUEST) is None
    assert not keep_run(REQUEST, PLAN, [tmp_path / "gone.py"])


def test_a_folder_that_others_can_write_to_is_refused(folder):
    kept()
    folder.chmod(0o777)
    assert find_run(REQUEST) is None
    assert not keep_run(REQUEST, PLAN, [])
    folder.chmod(0o700)
    assert find_run(REQUEST) is not None


def test_a_file_that_others_can_write_to_is_refused(folder):
    kept()
    (file,) = folder.iterdir()
    file.chmod(0o666)
    assert find_run(REQUEST) is None


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="owners of files are told apart on POSIX")
def test_somebody_elses_folder_is_refused(folder, monkeypatch):
    kept()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert find_run(REQUEST) is None


def test_no_folder_no_plan(tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "taken"))
    assert find_run(REQUEST) is None
    assert not keep_run(REQUEST, PLAN, [])
    monkeypatch.setenv("TRIMTAB_CACHE", "/dev/null/cache")
    assert not keep_run(REQUEST, PLAN, [])


def test_a_full_disk_leaves_the_old_plan_and_nothing_else(folder, monkeypatch):
    kept()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert not keep_run(REQUEST, CachedRun({"library": "z.so"}, {}), [])
    assert len(list(folder.iterdir())) == 1
    found = find_run(REQUEST)
    assert found is not None
    assert found.content == PLAN.content


def test_the_oldest_go_and_so_does_what_was_left_behind(folder, monkeypatch):
    monkeypatch.setattr(module, "MOST", 3)
    stale, fresh = folder / "a.b.part", folder / "c.d.part"
    for n in range(5):
        kept(REQUEST | {"n": n})
        os.utime(folder / (module._cache_name(REQUEST | {"n": n}) + ".plan"), (n, n))
        stale.write_text("")
        fresh.write_text("")
        os.utime(stale, (0, 0))
    kept(REQUEST | {"n": 5})
    assert [n for n in range(6) if find_run(REQUEST | {"n": n})] == [3, 4, 5]
    assert not stale.exists()
    assert fresh.exists()


WARM = """
import sys
from trimtab.commands.plan import Plan, find, keep
found = find({"scenario": "x"})
if found is None:
    import numpy as np
    print("kept", keep({"scenario": "x"}, Plan({"a": 1}, {"b": np.arange(3)}), []))
else:
    print(found.content, found.arrays["b"].tolist(), "jax" in sys.modules)
"""


def test_a_second_program_finds_it_without_jax():
    def run():
        return subprocess.run([sys.executable, "-c", WARM], capture_output=True, text=True, timeout=60)

    first = run()
    if first.stdout == "kept False\n":  # the package's own files were changed within the last seconds
        time.sleep(3)
        first = run()
    assert first.stdout == "kept True\n", first.stderr
    assert run().stdout == "{'a': 1} [0, 1, 2] False\n"
