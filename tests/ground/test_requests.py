"""A ground station has a flying autopilot hold, go on and end: pymavlink, a vehicle and `trimtab fly`, three programs.

Replayed, the flight's log gives every step's numbers again, requests included.
"""

import pytest
from ground.serving import served
from ground.test_pymavlink import SET_MODE, Peer
from live.pair import Program

from trimtab.logs.mcap import read_mcap
from trimtab.loop.supervisor import CAUSES, MODES
from trimtab.native.compiler import find_compiler
from trimtab.run.replay import replay
from trimtab.scenarios.recorded import rebuild_scenario

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
GUIDED, HOLD = 15, 4
LAND, PAUSE_CONTINUE, OVERRIDE_GOTO = 21, 193, 252
ACCEPTED, TEMPORARILY_REJECTED = 0, 1
ARMED, CRITICAL = 128, 5


def flies(peer, text):
    """Wait until the vehicle says this of its autopilot."""
    peer.await_("STATUSTEXT", lambda m: m.text == f"autopilot: {text}")


def ask(peer):
    """All there is, each answered and done before the next."""
    assert peer.command(SET_MODE, 1, HOLD) == ACCEPTED
    peer.await_("HEARTBEAT", lambda m: m.custom_mode == HOLD and m.base_mode & ARMED)
    assert peer.command(SET_MODE, 1, GUIDED) == ACCEPTED
    peer.await_("HEARTBEAT", lambda m: m.custom_mode == GUIDED)
    assert peer.command(OVERRIDE_GOTO, 0, 2) == ACCEPTED
    flies(peer, "hold")
    assert peer.command(PAUSE_CONTINUE, 1) == ACCEPTED
    flies(peer, "flying")
    assert peer.command(LAND) == ACCEPTED
    peer.await_("HEARTBEAT", lambda m: m.system_status == CRITICAL and not m.base_mode & ARMED)


def test_a_station_has_the_autopilot_hold_go_on_and_end(tmp_path):
    with served(tmp_path / "config") as vehicle:
        peer = Peer(vehicle.port, vehicle.passphrase)
        peer.await_("HEARTBEAT")
        for refused in ((SET_MODE, 1, HOLD), (OVERRIDE_GOTO, 0, 2), (LAND,)):
            assert peer.command(*refused) == TEMPORARILY_REJECTED
        line = ("--link", f"udp://127.0.0.1:{vehicle.port}", "--out", str(tmp_path / "here"), "--json")
        fly = Program("fly", "hovercraft/forward", "--duration", "60 s", *line, folder=tmp_path)
        peer.await_("HEARTBEAT", lambda m: m.base_mode & ARMED)
        ask(peer)
        fly.process.terminate()
        ended = fly.finished()
        peer.close()
        report = vehicle.stop()
    assert "supervisor: ended: end request" in ended.said
    assert report["released_s"] is not None
    check_log(read_mcap(tmp_path / "here" / "flight.mcap"))


def check_log(log):
    """Mode after mode, each by its request, none refused; and the same numbers once more.

    A busy machine's silences may come between: the supervisor says of them that it has lost, and found, the link.
    """
    modes, causes = log["supervisor.mode"].astype(int), log["supervisor.cause"].astype(int)
    pairs = list(zip(modes.tolist(), causes.tolist(), strict=True))
    course = [(MODES[m], CAUSES[c]) for k, (m, c) in enumerate(pairs) if not k or pairs[k - 1] != (m, c)]
    held = [("hold", "hold request"), ("flying", "resume request")]
    asked = [one for one in course if one[1].endswith("request")]
    assert asked == [*held, *held, ("ended", "end request")], course
    assert log["supervisor.refusals"][-1] == 0
    assert log["downlink.pilot.fresh"].sum() == 5
    found = replay(log, rebuild_scenario(log), backend="c")
    assert (found.exact, len(found.replayed_log)) == (True, len(log)), found.first
