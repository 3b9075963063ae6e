"""What `trimtab vehicle` writes and reads of a log, and the watchdog's time that it refuses."""

import pytest

from trimtab.commands import vehicle
from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.native.compiler import find_compiler


def test_a_watchdog_shorter_than_a_few_heartbeats_is_refused():
    assert vehicle._parse_watchdog("50 ms") == ms(50)
    with pytest.raises(InputError, match="heartbeats"):
        vehicle._parse_watchdog("10 ms")


def test_no_log_and_one_that_is_too_long_are_not_read(tmp_path):
    long = tmp_path / "vehicle.mcap"
    with long.open("wb") as file:
        file.truncate(vehicle.MOST_SUMMARISED + 1)  # a hole: reading it would be refused, for it is no log
    assert vehicle._summarise_flight(None, 0, None) == {"real": None}
    assert vehicle._summarise_flight(long, 0, None) == {"real": None}


@pytest.mark.slow
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    """The vehicle's log of 191 kB/s had lain in the temporary folder."""
    from live.pair import Program, make_key

    make_key(tmp_path)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    words = ("vehicle", "hovercraft/zero-velocity", "--listen", "udp://127.0.0.1:14672", "--json")
    there = Program(*words, folder=tmp_path)
    try:
        there.wait_for("listens on")
        assert not list((tmp_path / "temporary").rglob("*.mcap"))
        there.process.terminate()
        ended = there.finished()
        assert (ended.status, ended.result["log"], ended.result["real"]) == (0, None, None)
    finally:
        if there.process.poll() is None:
            there.process.kill()
            there.process.communicate()
