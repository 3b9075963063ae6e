"""Cache entries are complete, private to this user and bounded in size; others are ignored."""

import os
import threading
import time
from pathlib import Path

import pytest

from trimtab.compiler.native import cache as module
from trimtab.compiler.native.cache import (
    cache_problem,
    cached_library_folder,
    find_in_folder,
    lock_key,
    private_folder,
    store_library,
    try_folders,
    work_folder,
    write_atomically,
)

pytestmark = pytest.mark.usefixtures("cache")

CONTENT = bytes(range(256)) * 40
DAYS_AGO = time.time() - 3 * module.DAY


def put(folder: Path, key: str, content: bytes = CONTENT) -> Path:
    with work_folder(folder) as work:
        (work / "made.so").write_bytes(content)
        return store_library(folder, key, work / "made.so", {"flags": "-O2 -x"})


def age(path: Path, when: float = DAYS_AGO) -> None:
    os.utime(path, (when, when))


def truncate(library: Path, manifest: Path) -> None:
    os.truncate(library, len(CONTENT) // 2)


def flip(library: Path, manifest: Path) -> None:
    library.write_bytes(CONTENT[:-1] + b"\x00")


def empty(library: Path, manifest: Path) -> None:
    library.write_bytes(b"")


def no_manifest(library: Path, manifest: Path) -> None:
    manifest.unlink()


def half_manifest(library: Path, manifest: Path) -> None:
    os.truncate(manifest, 60)


def foreign_manifest(library: Path, manifest: Path) -> None:
    manifest.write_text(manifest.read_text().replace("key one", "key two"))


def garbage_manifest(library: Path, manifest: Path) -> None:
    manifest.write_bytes(b"\xff\xfe\x00")


def no_library(library: Path, manifest: Path) -> None:
    library.unlink()


def link(library: Path, manifest: Path) -> None:
    library.rename(library.with_name("other"))
    library.symlink_to("other")


def pipe(library: Path, manifest: Path) -> None:
    library.unlink()
    os.mkfifo(library)


def writable_library(library: Path, manifest: Path) -> None:
    library.chmod(0o722)


def writable_manifest(library: Path, manifest: Path) -> None:
    manifest.chmod(0o660)


def foreign_library(library: Path, manifest: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can give files away")
    os.chown(library, 12345, -1)


DAMAGE = [
    truncate, flip, empty, no_manifest, half_manifest, foreign_manifest, garbage_manifest, no_library, link, pipe,
    writable_library, writable_manifest, foreign_library,
]  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
def test_incomplete_entry_is_ignored_and_replaced(damage) -> None:
    library = put(cached_library_folder(), "one")
    assert find_in_folder(cached_library_folder(), "one") == library
    damage(library, library.with_suffix(".txt"))
    assert find_in_folder(cached_library_folder(), "one") is None
    assert put(cached_library_folder(), "one").read_bytes() == CONTENT
    assert find_in_folder(cached_library_folder(), "one") == library


def test_files_are_private_under_any_umask() -> None:
    before = os.umask(0)
    try:
        library = put(cached_library_folder(), "one")
    finally:
        os.umask(before)
    assert all(
        not path.stat().st_mode & 0o077 for path in (cached_library_folder(), library, library.with_suffix(".txt"))
    )
    assert {path.name for path in cached_library_folder().iterdir()} == {"one.so", "one.txt"}, "left-overs"


def test_manifest_is_written_after_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    names = []
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda old, new: (names.append(Path(new).name), replace(old, new)))
    put(cached_library_folder(), "one")
    assert names == ["one.so", "one.txt"]


def test_failed_write_leaves_the_old_file(monkeypatch: pytest.MonkeyPatch) -> None:
    path = cached_library_folder() / "note"
    write_atomically(path, "old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(cached_library_folder().iterdir()) == [path]


def test_stale_files_are_removed_after_a_day() -> None:
    folder = cached_library_folder()
    old, new = folder / "tmp-old", folder / "tmp-new"
    for left in (old, new):
        left.mkdir()
        (left / "program.c").write_text("x")
    halves = [folder / name for name in ("half.so", "alone.txt", "dead.lock")]
    for path in halves:
        path.write_text("x")
        age(path)
    (folder / "busy.lock").write_text("")
    age(old)
    whole = put(folder, "whole")
    age(whole)
    age(whole.with_suffix(".txt"))
    put(folder, "one")
    names = {path.name for path in folder.iterdir()}
    assert names == {"tmp-new", "busy.lock", "whole.so", "whole.txt", "one.so", "one.txt"}


def test_least_recently_used_entry_is_evicted_above_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT", 3 * len(CONTENT))
    folder = cached_library_folder()
    for hours, key in ((5, "a"), (4, "b"), (3, "c")):
        for path in (library := put(folder, key), library.with_suffix(".txt")):
            age(path, time.time() - 3600.0 * hours)
    assert find_in_folder(folder, "a") is not None, "used now"
    put(folder, "d")
    assert {path.name for path in folder.iterdir()} == {f"{key}.{end}" for key in "acd" for end in ("so", "txt")}


def test_new_entry_larger_than_the_limit_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT", 10)
    put(cached_library_folder(), "a")
    put(cached_library_folder(), "b")
    assert {path.name for path in cached_library_folder().iterdir()} == {"b.so", "b.txt"}


def test_removed_private_folder_is_created_again() -> None:
    first = private_folder()
    assert first.stat().st_mode & 0o077 == 0
    assert private_folder() == first
    first.rmdir()
    assert private_folder().is_dir()


def test_private_folder_is_removed_by_its_own_process_only(elsewhere) -> None:
    text = """
import os, sys
from trimtab.compiler.native.cache import private_folder
folder = private_folder()
if os.fork() == 0:
    sys.exit()
os.wait()
print(folder, folder.is_dir())
"""
    said, trouble = elsewhere(text).communicate()
    folder, there = said.split()
    assert there == "True", trouble
    assert not Path(folder).exists()


def test_private_folder_is_tried_and_cache_problem_recorded() -> None:
    def picky(folder: Path) -> Path:
        if folder == cached_library_folder():
            raise OSError(28, "No space left on device")
        return folder

    assert cache_problem() == ""
    assert try_folders(picky) == private_folder()
    assert "No space" in cache_problem()


def test_error_lists_the_problems_of_both_folders() -> None:
    def never(folder: Path) -> Path:
        raise OSError(f"not {folder}")

    with pytest.raises(OSError, match=f"not {cached_library_folder()}; not {private_folder()}"):
        try_folders(never)


def test_rejects_noexec_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.statvfs

    def noexec(path):
        fields = list(real(path))
        fields[8] |= os.ST_NOEXEC
        return os.statvfs_result(fields)

    monkeypatch.setattr(os, "statvfs", noexec)
    with pytest.raises(PermissionError, match="noexec"):
        cached_library_folder()


@pytest.mark.real_time
def test_lock_admits_one_thread_and_is_removed() -> None:
    inside, most = 0, 0

    def work() -> None:
        nonlocal inside, most
        with lock_key(cached_library_folder(), "one"):
            inside += 1
            most = max(most, inside)
            time.sleep(0.05)
            inside -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10.0)
    assert most == 1
    assert list(cached_library_folder().iterdir()) == []


@pytest.mark.real_time
def test_waiting_for_a_lock_times_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PATIENCE", 0.1)
    with lock_key(cached_library_folder(), "one"):
        began = time.monotonic()
        with lock_key(cached_library_folder(), "one"):
            assert 0.1 <= time.monotonic() - began < 2.0
        assert (cached_library_folder() / "one.lock").exists(), "removed by one who didn't hold it"
