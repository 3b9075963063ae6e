"""Running a compiler: status, output, hangs, kills, full disks and interrupts."""

import os
import time
from pathlib import Path

import pytest

from trimtab.compiler.native.compiler import run_compiler

pytestmark = pytest.mark.usefixtures("cache")


def shell(text: str, work: Path, limit: float = 10.0):
    return run_compiler(("/bin/sh", "-c", text), work, limit)


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def test_returns_status_and_both_streams(tmp_path: Path) -> None:
    outcome = shell("echo out; echo err >&2; exit 3", tmp_path)
    assert outcome.status == 3
    assert sorted(outcome.text.split()) == ["err", "out"]
    assert outcome.interruption == ""


def test_runs_in_folder_without_input_in_c_locale(tmp_path: Path) -> None:
    assert shell('pwd; echo "$TMPDIR $LC_ALL"; cat', tmp_path).text.split() == [str(tmp_path), str(tmp_path), "C"]


@pytest.mark.real_time
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_hanging_process_is_stopped_with_its_children(tmp_path: Path) -> None:
    began = time.monotonic()
    outcome = shell("sleep 60 & echo $! >child; wait", tmp_path, limit=0.3)
    assert time.monotonic() - began < 5.0
    assert outcome.status is None
    assert "did not end within 0.3 s" in outcome.interruption
    child = int((tmp_path / "child").read_text())
    while is_running(child) and time.monotonic() - began < 5.0:
        time.sleep(0.01)
    assert not is_running(child)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kill -9 $$", "killed by signal 9"),
        ("echo 'gcc: fatal error: Killed signal terminated program cc1'; exit 1", "child program was killed"),
        ("echo 'clang: error: unable to execute command: Killed'; exit 254", "child program was killed"),
    ],
)
def test_killed_compiler_is_reported_as_interruption(tmp_path: Path, text: str, words: str) -> None:
    assert words in shell(text, tmp_path).interruption


@pytest.mark.parametrize("text", ["No space left on device", "Disk quota exceeded", "File too large"])
def test_full_disk_raises_os_error_only_on_failure(tmp_path: Path, text: str) -> None:
    with pytest.raises(OSError, match=text):
        shell(f"echo 'as: a.o: {text}'; exit 1", tmp_path)
    assert shell(f"echo 'warning: {text}'; exit 0", tmp_path).status == 0


def test_unstartable_compiler_returns_status_127(tmp_path: Path) -> None:
    outcome = run_compiler((str(tmp_path / "gone"),), tmp_path, 1.0)
    assert outcome.status == 127
    assert "could not be started" in outcome.text


def test_keyboard_interrupt_stops_the_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import subprocess

    started = []

    def interrupted(process: "subprocess.Popen[bytes]", **_: object) -> None:
        started.append(process.pid)
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess.Popen, "communicate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        shell("sleep 60", tmp_path)
    with pytest.raises(ProcessLookupError):
        os.kill(started[0], 0)
