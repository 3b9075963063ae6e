"""Progress on standard error: finished runs, remaining time and size on disk."""

import contextlib
import os
import pty
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands import console, progress
from trimtab.core.errors import InputError

INLINE = "module://matplotlib_inline.backend_inline"
"""What a notebook sets, whoever started it."""


@pytest.mark.parametrize(
    ("variables", "is_drawn"),
    [({}, True), ({"JPY_PARENT_PID": "1"}, False), ({"TERM": "dumb"}, False), ({"MPLBACKEND": INLINE}, False)],
)
def test_spinner_is_drawn_on_terminal_but_not_in_notebook(variables, is_drawn):
    """A notebook's `!` gives a command a terminal; each frame of a spinner would appear in the page."""
    code = "import time\nfrom trimtab.commands.progress import show_spinner as show\n"
    code += "with show('compiling'): time.sleep(0.2)"
    own = (
        {k: v for k, v in os.environ.items() if k not in ("JPY_PARENT_PID", "MPLBACKEND")}
        | {"TERM": "xterm"}
        | variables
    )
    screen, end = pty.openpty()
    try:
        subprocess.run([sys.executable, "-c", code], stderr=end, env=own, check=True)
        os.write(end, b".")
        said = os.read(screen, 100_000)
    finally:
        os.close(screen)
        os.close(end)
    assert (b"compiling" in said) == is_drawn, said
    assert is_drawn or said == b"."


def test_console_shows_which_logs_are_being_read(monkeypatch, tmp_path):
    def refuse(file):
        raise InputError("the log", "is read", fix="none")

    said = []
    monkeypatch.setattr(console, "show_spinner", lambda text: said.append(text) or contextlib.nullcontext())
    monkeypatch.setattr("trimtab.console.recordings.load_recording", refuse)
    files = [tmp_path / "flight.mcap", tmp_path / "vehicle.mcap"]
    for file in files:
        file.touch()
    done = CliRunner().invoke(main, ["console", *map(str, files)])
    assert done.exit_code == 2, done.output
    assert said == [f"reading {files[0]} and {files[1]}"]


def test_long_run_reports_remaining_time(monkeypatch, capsys):
    clock = iter([10.0, 20.0, 25.0, 30.0, 32.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.show_progress(1000) as tell:
        for _ in range(4):
            tell("flying", 10)
    said = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"flying: 20 of 1000, about 16 min left on \d+ cores?", said[0])
    assert len(said) == 2  # not at 25 s, but at 30 s once more
    with progress.show_progress(10) as tell:
        tell("flying", 10)
    assert capsys.readouterr().err == ""


REMINDERS = progress._reminders
"""As it is outside tests, where no command prints lines by the clock (tests/conftest.py)."""


class MadeUpEvent:
    """An event on a clock of its own: three waits of ten seconds, then the work has ended."""

    def __init__(self):
        self.waits = []

    def wait(self, timeout):
        self.waits.append(timeout)
        return len(self.waits) > 3

    def set(self): ...


@pytest.fixture
def made_up_clock(monkeypatch):
    """Time that passes by ten seconds at each wait of the reminders."""
    event = MadeUpEvent()
    monkeypatch.setattr(progress, "_reminders", REMINDERS)
    monkeypatch.setattr(progress.threading, "Event", lambda: event)
    monkeypatch.setattr(progress.threading, "Thread", StartedThread)
    monkeypatch.setattr(progress.time, "monotonic", lambda: 10.0 * len(event.waits))
    return event


class StartedThread:
    """A thread that runs to its end when it is started."""

    def __init__(self, target, daemon):
        self.start = target

    def join(self): ...


def test_wait_without_terminal_prints_line_every_ten_seconds(made_up_clock, capsys):
    with progress.show_spinner("compiling own"):
        pass
    assert capsys.readouterr().err == "".join(f"compiling own: {s} s so far\n" for s in (10, 20, 30))
    assert set(made_up_clock.waits) == {10.0}


def test_long_runs_print_line_every_ten_seconds(made_up_clock, capsys):
    with progress.show_progress(50) as tell:
        tell("flying", 0)
    assert capsys.readouterr().err == "".join(f"0 of 50, {s} s so far\n" for s in (10, 20, 30))


def test_remaining_time_is_extrapolated_from_finished_runs(monkeypatch, capsys):
    """400 pieces of 20 ms, reported five at a time: after the first second 7 of 8 s remain."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    lines = progress._ProgressLines(400, lambda line: print(line, file=sys.stderr))
    for _ in range(15):
        now[0] += 0.1
        lines.add("flying", 5)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    seconds = re.fullmatch(r"flying: \d+ of 400, about (\d+) s left on \d+ cores?", said[0])
    assert seconds, said
    assert float(seconds[1]) == 7


def fly_on_a_screen(total, monkeypatch):
    """Five pieces of a second each, on a clock that is made up and a screen that can be drawn over."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "_can_redraw", lambda: True)
    with progress.show_progress(total) as tell:
        for _ in range(5):
            tell("flying", 1)
            now[0] += 1.0


def test_duration_of_hours_is_printed_once_on_terminal(monkeypatch, capsys):
    fly_on_a_screen(86_400, monkeypatch)
    said = capsys.readouterr().err
    assert len(re.findall(r"flying: 2 of 86400, about 24\.0 h left on \d+ cores?", said)) == 1
    assert said.count(" left on ") == 1


def test_duration_below_one_hour_prints_no_line_on_terminal(monkeypatch, capsys):
    fly_on_a_screen(3500, monkeypatch)
    assert " left on " not in capsys.readouterr().err


@pytest.mark.parametrize(("seconds", "text"), [(89, "89 s"), (119, "119 s"), (180, "3 min"), (5401, "1.5 h")])
def test_wait_is_formatted_in_readable_units(seconds, text):
    assert progress.format_wait(seconds) == text


@pytest.mark.thorough
def test_short_campaign_prints_no_time_or_disk_estimate(tmp_path):
    words = ("campaign", "hovercraft/spin", "--set", "duration=1", "--runs", "70", "--store", str(tmp_path / "a.zarr"))
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert " on " not in done.stderr


@pytest.mark.thorough
def test_insufficient_disk_space_is_reported_before_campaign_runs(tmp_path, monkeypatch):
    """1000 rows of 51 bytes: six numbers and three flags each. Stored rows are not counted again."""
    monkeypatch.setattr(progress.shutil, "disk_usage", lambda there: SimpleNamespace(free=50_000) if there else None)
    words = ("campaign", "hovercraft/spin", "--set", "duration=1", "--store", str(tmp_path / "a.zarr"), "--runs")
    said = "store: up to 51 kB more, but only 50 kB are free on the disk of"
    assert said in CliRunner().invoke(main, [*words, "1000"]).stderr
    assert "store: up to" not in CliRunner().invoke(main, [*words, "1000"]).stderr
