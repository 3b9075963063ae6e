"""Wrong key, clock, scenario and owner: each error suggests a command that then flies. In virtual time."""

import json
import shutil

import pytest
from flight.pair import make_key
from flight.virtual_programs import LINK, LISTEN, VirtualPrograms

from trimtab.compiler.native.compiler import find_compiler
from trimtab.flight.mavlink.keys import create_key
from trimtab.flight.mavlink.stamps import DIGITS, EPOCH, PER_SECOND
from trimtab.flight.virtual_time import UNIX_START

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
NAME = "hovercraft/forward"
SHORT = ("--duration", "1 s")
NOW = int((UNIX_START - EPOCH) * PER_SECOND)
"""Stamp of the start of virtual time."""


class Ends:
    """A waiting vehicle, and autopilots started against it, each with its own folder of keys."""

    def __init__(self, folder, *options):
        self.folder, self.programs = folder, VirtualPrograms(folder)
        self.key = folder / "config" / "keys" / "hovercraft.key"
        if not self.key.exists():
            make_key(folder)
        words = ("vehicle", NAME, "--listen", LISTEN, "--key", str(self.key), *options)
        self.vehicle = self.programs.start("vehicle", *words)
        self.vehicle.wait_for("listens on")

    def start(self, name, *options, scenario=NAME):
        own = self.folder / name / "config" / "keys"
        own.mkdir(parents=True, exist_ok=True)
        shutil.copy(self.key, own)
        signed = () if "--key" in options else ("--key", str(own / self.key.name))
        return self.programs.start(name, "fly", scenario, "--link", LINK, *signed, *SHORT, *options)

    def fly(self, name, *options, **kinds):
        return self.programs.finish(self.start(name, *options, **kinds))

    def close(self):
        self.programs.machines["vehicle"].interrupt()
        try:
            return self.programs.finish(self.vehicle)
        finally:
            self.programs.close()


@pytest.fixture
def ends(tmp_path):
    started = Ends(tmp_path)
    yield started
    if started.vehicle.status is None:
        started.close()


def fix(ended):
    """Command suggested by the message."""
    return ended.said.partition("Fix: ")[2].strip()


@pytest.mark.thorough
def test_suggested_fix_of_each_refusal_makes_it_fly(ends):
    other = create_key(ends.folder / "other.key")
    refused = ends.fly("key", "--key", str(other.path))
    assert refused.status == 2
    assert "wrong key: " in refused.said
    assert "--key FILE" in fix(refused)
    assert ends.fly("key", "--key", str(ends.folder / "config" / "keys" / "hovercraft.key")).status == 0

    stored = ends.folder / "clock" / "config" / "keys" / "hovercraft.key.1-191-0.time"
    stored.parent.mkdir(parents=True)
    ahead = NOW + 86_400 * PER_SECOND
    stored.write_text(f"{ahead:0{DIGITS}d}\n")
    refused = ends.fly("clock")
    assert refused.status == 2
    assert "wrong clock: the stored time stamp is 8" in refused.said
    assert fix(refused).endswith("--clock computer")
    assert ends.fly("clock", "--clock", "computer").status == 0
    assert ends.fly("clock").status == 0  # and it stays so

    refused = ends.fly("scenario", scenario="hovercraft/spin")
    assert refused.status == 2
    assert "wrong scenario: " in refused.said
    assert "scenario: hovercraft/forward on the vehicle, hovercraft/spin here" in refused.said
    assert "fly hovercraft/forward" in fix(refused)
    refused = ends.fly("scenario", "--set", "world.vehicle.mass=2.8")
    assert "world.vehicle.mass: 2.6 on the vehicle, 2.8 here" in refused.said
    assert ends.fly("scenario", "--set", "world.vehicle.mass=2.8", "--accept", "world.vehicle.mass").status == 0

    ended = ends.close()
    assert "signed with another key" in ended.said
    assert "the clock of 1/191 is 8" in ended.said


def test_vehicle_clock_once_ahead_is_followed_or_reset(tmp_path):
    make_key(tmp_path)
    store = tmp_path / "config" / "keys" / "hovercraft.key.1-1-0.time"
    store.write_text(f"{NOW + 86_400 * PER_SECOND:0{DIGITS}d}\n")
    ends = Ends(tmp_path)
    try:
        refused = ends.fly("clock")
        assert refused.status == 2
        assert "the vehicle's is ahead of this computer's" in refused.said
        assert fix(refused).partition("   ")[0].endswith("--clock vehicle")
        flown = ends.fly("clock", "--clock", "vehicle")
        assert flown.status == 0
        assert "signed by the vehicle's clock, which is +8" in flown.said
    finally:
        ends.close()
    ends = Ends(tmp_path, "--clock", "computer")
    try:
        assert ends.fly("clock").status == 0
    finally:
        ends.close()


@pytest.mark.thorough
def test_second_autopilot_takes_over_only_on_request(ends):
    first = ends.start("first", "--duration", "60 s")
    ends.vehicle.wait_for("commanded by")
    second = ends.fly("second")
    assert second.status == 2
    assert "wrong owner: the vehicle is flown by another autopilot" in second.said
    assert fix(second).partition("   ")[0].endswith("--take-over")
    assert first.status is None
    third = ends.fly("third", "--take-over")
    assert third.status == 0
    ended = ends.programs.finish(first)
    assert ended.status == 1
    assert ended.result is not None
    assert ended.result["cause"].startswith("the vehicle was taken over by session ")
    told = ends.close().said
    assert told.count("commanded by 1/191") == 2
    assert "Disarming by" not in json.dumps(told)
