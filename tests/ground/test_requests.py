"""A ground station makes a flying autopilot hold, resume and end: pymavlink, a vehicle and `trimtab fly`.

A replay of the flight's log reproduces every step, including the requests.
"""

import dataclasses

import pytest
from flight.pair import Program
from ground.serving import served
from ground.test_pymavlink import SET_MODE, Peer

from trimtab.compiler.native.compiler import find_compiler
from trimtab.flight.parameter_store import read_parameters
from trimtab.logs.mcap import read_mcap
from trimtab.loop.supervisor import CAUSES, MODES
from trimtab.run.parameter_changes import read_changes
from trimtab.run.replay import replay
from trimtab.scenarios.recorded import rebuild_scenario

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
GUIDED, HOLD = 15, 4
LAND, PAUSE_CONTINUE, OVERRIDE_GOTO = 21, 193, 252
ACCEPTED, TEMPORARILY_REJECTED = 0, 1
ARMED, CRITICAL = 128, 5
AUTOPILOT, STORAGE = 191, 245
"""MAV_COMP_ID_ONBOARD_COMPUTER; PREFLIGHT_STORAGE."""


def flies(peer, text):
    """Wait until the vehicle reports this text about its autopilot."""
    peer.await_("STATUSTEXT", lambda m: m.text == f"autopilot: {text}")


def change_gain(peer):
    """Read, change and store parameters of the autopilot's own component. One change is refused."""
    mav = peer.mav

    def value(name, ask):
        return peer.await_("PARAM_VALUE", lambda m: m.param_id == name and m.get_srcComponent() == AUTOPILOT, ask)

    first = value("AL_K1", lambda: mav.param_request_read_send(1, AUTOPILOT, b"AL_K1", -1))
    assert first.param_value == 1.0
    mav.param_request_list_send(1, 0)  # of all components
    last = value("AA_DEAD_ZONE", lambda: None)
    assert 20 < last.param_index < first.param_count
    assert value("AL_K1", lambda: mav.param_set_send(1, AUTOPILOT, b"AL_K1", 1.25, 9)).param_value == 1.25
    refused = value("AAT_SPEE_MAX_RPM", lambda: mav.param_set_send(1, AUTOPILOT, b"AAT_SPEE_MAX_RPM", -1.0, 9))
    assert refused.param_value == 12000
    mav.command_long_send(1, AUTOPILOT, STORAGE, 0, 1, 0, 0, 0, 0, 0, 0)
    assert peer.await_("COMMAND_ACK", lambda m: m.get_srcComponent() == AUTOPILOT).result == ACCEPTED


def ask(peer):
    """Make all requests one after the other, each answered and carried out before the next."""
    change_gain(peer)
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


def test_station_makes_the_autopilot_hold_resume_and_end(tmp_path):
    with served(tmp_path / "config") as vehicle:
        peer = Peer(vehicle.port, vehicle.passphrase)
        peer.await_("HEARTBEAT")
        for refused in ((SET_MODE, 1, HOLD), (OVERRIDE_GOTO, 0, 2), (LAND,)):
            assert peer.command(*refused) == TEMPORARILY_REJECTED
        line = ("--link", f"udp://127.0.0.1:{vehicle.port}", "--out", str(tmp_path / "here"), "--json")
        line += ("--parameters", str(tmp_path / "kept.json"))
        fly = Program("fly", "hovercraft/forward", "--duration", "60 s", *line, folder=tmp_path)
        peer.await_("HEARTBEAT", lambda m: m.base_mode & ARMED)
        ask(peer)
        fly.process.terminate()
        ended = fly.finished()
        assert (peer.gaps, peer.unknown) == (0, 0)  # no sample for it, and no hole where they were
        peer.close()
        report = vehicle.stop()
    assert "supervisor: ended: end request" in ended.said
    assert report["released_s"] is not None
    check_log(read_mcap(tmp_path / "here" / "flight.mcap"))
    assert read_parameters(tmp_path / "kept.json", "hovercraft/forward") == {"autopilot.law.k1": "1.25"}


def check_log(log):
    """Assert that each mode follows its request, that none is refused, and that a replay is exact.

    On a busy machine the supervisor may also report that it lost and recovered the link.
    """
    modes, causes = log["supervisor.mode"].astype(int), log["supervisor.cause"].astype(int)
    pairs = list(zip(modes.tolist(), causes.tolist(), strict=True))
    course = [(MODES[m], CAUSES[c]) for k, (m, c) in enumerate(pairs) if not k or pairs[k - 1] != (m, c)]
    held = [("hold", "hold request"), ("flying", "resume request")]
    asked = [one for one in course if one[1].endswith("request")]
    assert asked == [*held, *held, ("ended", "end request")], course
    assert log["supervisor.refusals"][-1] == 0
    assert log["downlink.pilot.fresh"].sum() == 5
    (change,) = read_changes(log)
    assert (change.path, change.slot, change.value) == ("law.k1", 0, 1.25)
    without = dataclasses.replace(log, metadata={**log.metadata, "events": []})
    assert not replay(without, rebuild_scenario(log), backend="c").exact
    found = replay(log, rebuild_scenario(log), backend="c")
    assert (found.exact, len(found.replayed_log)) == (True, len(log)), found.first
