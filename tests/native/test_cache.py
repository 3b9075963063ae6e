"""Entries are whole, this user's, and bounded; or they are none."""

import os
import threading
import time
from pathlib import Path

import pytest

from trimtab.native import cache as module
from trimtab.native.cache import (
    alone,
    anywhere,
    kept,
    lookup,
    not_kept,
    private,
    store,
    work_folder,
    write_whole,
)

pytestmark = pytest.mark.usefixtures("cache")

CONTENT = bytes(range(256)) * 40
DAYS_AGO = time.time() - 3 * module.DAY


def put(folder: Path, key: str, content: bytes = CONTENT) -> Path:
    with work_folder(folder) as work:
        (work / "made.so").write_bytes(content)
        return store(folder, key, work / "made.so", {"flags": "-O2 -x"})


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
def test_entry_that_is_not_whole_counts_as_none_and_is_replaced(damage) -> None:
    library = put(kept(), "one")
    assert lookup(kept(), "one") == library
    damage(library, library.with_suffix(".txt"))
    assert lookup(kept(), "one") is None
    assert put(kept(), "one").read_bytes() == CONTENT
    assert lookup(kept(), "one") == library


def test_files_are_their_owners_alone_whatever_the_mask() -> None:
    before = os.umask(0)
    try:
        library = put(kept(), "one")
    finally:
        os.umask(before)
    assert all(not path.stat().st_mode & 0o077 for path in (kept(), library, library.with_suffix(".txt")))
    assert {path.name for path in kept().iterdir()} == {"one.so", "one.txt"}, "left-overs"


def test_manifest_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    names = []
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda old, new: (names.append(Path(new).name), replace(old, new)))
    put(kept(), "one")
    assert names == ["one.so", "one.txt"]


def test_failed_write_leaves_the_old_file(monkeypatch: pytest.MonkeyPatch) -> None:
    path = kept() / "note"
    write_whole(path, "old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_whole(path, "new")
    assert path.read_text() == "old"
    assert list(kept().iterdir()) == [path]


def test_left_overs_go_after_a_day() -> None:
    folder = kept()
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


def test_what_was_used_longest_ago_goes_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT", 3 * len(CONTENT))
    folder = kept()
    for hours, key in ((5, "a"), (4, "b"), (3, "c")):
        for path in (library := put(folder, key), library.with_suffix(".txt")):
            age(path, time.time() - 3600.0 * hours)
    assert lookup(folder, "a") is not None, "used now"
    put(folder, "d")
    assert {path.name for path in folder.iterdir()} == {f"{key}.{end}" for key in "acd" for end in ("so", "txt")}


def test_new_entry_stays_even_if_it_alone_is_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT", 10)
    put(kept(), "a")
    put(kept(), "b")
    assert {path.name for path in kept().iterdir()} == {"b.so", "b.txt"}


def test_private_folder_is_made_anew_if_something_removes_it() -> None:
    first = private()
    assert first.stat().st_mode & 0o077 == 0
    assert private() == first
    first.rmdir()
    assert private().is_dir()


def test_private_folder_ends_with_the_process_not_with_its_children(elsewhere) -> None:
    text = """
import os, sys
from trimtab.native.cache import private
folder = private()
if os.fork() == 0:
    sys.exit()
os.wait()
print(folder, folder.is_dir())
"""
    said, trouble = elsewhere(text).communicate(timeout=30)
    folder, there = said.split()
    assert there == "True", trouble
    assert not Path(folder).exists()


def test_second_folder_is_tried_and_the_reason_kept() -> None:
    def picky(folder: Path) -> Path:
        if folder == kept():
            raise OSError(28, "No space left on device")
        return folder

    assert not_kept() == ""
    assert anywhere(picky) == private()
    assert "No space" in not_kept()


def test_no_folder_gives_both_reasons() -> None:
    def never(folder: Path) -> Path:
        raise OSError(f"not {folder}")

    with pytest.raises(OSError, match=f"not {kept()}; not {private()}"):
        anywhere(never)


def test_noexec_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.statvfs

    def noexec(path):
        fields = list(real(path))
        fields[8] |= os.ST_NOEXEC
        return os.statvfs_result(fields)

    monkeypatch.setattr(os, "statvfs", noexec)
    with pytest.raises(PermissionError, match="noexec"):
        kept()


def test_one_at_a_time_and_no_lock_is_left() -> None:
    inside, most = 0, 0

    def work() -> None:
        nonlocal inside, most
        with alone(kept(), "one"):
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
    assert list(kept().iterdir()) == []


def test_waiting_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PATIENCE", 0.1)
    with alone(kept(), "one"):
        began = time.monotonic()
        with alone(kept(), "one"):
            assert 0.1 <= time.monotonic() - began < 2.0
        assert (kept() / "one.lock").exists(), "removed by one who didn't hold it"
