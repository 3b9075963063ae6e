"""An emulated board in lockstep: its time stops until the command of the current instant arrives."""

import shutil
from contextlib import closing

import pytest
from firmware.board import emulator
from firmware.conftest import build_elf
from firmware.host import KEY
from firmware.peer import Peer

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def peer(written, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lockstep")
    shutil.copytree(written.folder, folder / "board")
    image = build_elf(folder / "board", "LOCKSTEP=1")
    with emulator(image, folder) as port, closing(Peer(port, written.dialect, KEY)) as other:
        yield other


def instants(heard):
    return [m.get("t") for _, m in heard if m.name == "INSTANT"]


def command(peer, t):
    peer.send("COMMAND", t=t, valid=True, rudder_pulse=1.5e-3, speed_rpm=6000.0)


def test_lockstep_time_advances_only_with_command_of_current_instant(peer):
    assert instants(peer.listen(0.2)) == []  # nobody with the key has spoken
    peer.send("COMMAND_LONG", target_system=1, command=400, param1=1.0)
    first = peer.listen(5.0, lambda m: m.name == "INSTANT") + peer.listen(0.2)
    assert instants(first) == [0]
    counted = [m.get("samples") for _, m in first if m.name == "INSTANT"]
    assert counted == [sum(m.name.startswith("SAMPLE_") for _, m in first)] == [1]
    command(peer, 10_000)  # of an instant that has not come
    peer.heartbeat()
    assert instants(peer.listen(0.2)) == []
    command(peer, 0)
    assert instants(peer.listen(5.0, lambda m: m.name == "INSTANT")) == [10_000]
    assert instants(peer.listen(0.2)) == []


def test_commands_reach_pulses_one_tick_later(peer):
    heard = peer.listen(0.1)
    for t in range(10_000, 300_000, 10_000):
        command(peer, t)
        heard += peer.listen(5.0, lambda m: m.name == "INSTANT")
    assert instants(heard)[-1] == 300_000
    servos = [(m.get("time_usec"), m.get("servo3_raw")) for _, m in heard if m.name == "SERVO_OUTPUT_RAW"]
    assert servos[-1] == (20_000, 2000)  # the lift fan turns from the first frame on
