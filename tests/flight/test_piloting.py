"""A pilot at a console played by the test, a vehicle in a thread, and an autopilot over a loopback link."""

import json
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from flight.wall_clock_pair import Pair

from trimtab.compiler.native.compiler import find_compiler
from trimtab.console.hello import describe_flight
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.console_packets import HEAD
from trimtab.logs.mcap import read_mcap
from trimtab.loop.supervisor import FLYING, STANDBY
from trimtab.run.parameter_changes import read_changes
from trimtab.run.replay import replay
from trimtab.scenarios import catalogue
from trimtab.scenarios.recorded import rebuild_scenario

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
PATIENCE = 60.0
GAIN = "autopilot.law.k1"


class Page:
    """The console's server as seen by the flight: reads rows and messages, and sends requests."""

    def __init__(self):
        self.own, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.own.settimeout(0.05)
        self.rows, self.messages, self.has_stick = [], [], False
        self.forward = 0.0

    def send(self, kind, **content):
        self.own.send(b"j" + json.dumps({"type": kind, **content}).encode())

    def read(self):
        """Read the data of the next 50 ms. Send the stick position if this page holds the stick."""
        if self.has_stick:
            self.send("stick", pilot=1, forward=self.forward, turn=0.0, mode=1, clock=time.monotonic())
        try:
            packet = self.own.recv(1 << 16)
        except TimeoutError:
            return
        if packet[:1] == b"r":
            self.rows.append(np.frombuffer(packet, "<f4", offset=1 + HEAD.size))
        elif packet:
            self.messages.append(json.loads(packet[1:]))

    def wait(self, what, why):
        end = time.monotonic() + PATIENCE
        while not what():
            assert time.monotonic() < end, (why, self.messages[-5:])
            self.read()

    def arm(self, is_armed, id):
        """Request arming each second until armed. On a busy machine a check may fail and refuse a request."""
        due, end = 0.0, time.monotonic() + PATIENCE
        while not is_armed():
            now = time.monotonic()
            assert now < end, ("arming", self.messages[-5:])
            if now >= due:
                self.send("request", request="arm", client=1, id=id)
                due = now + 1.0
            self.read()

    def heard(self, text):
        return any(text in m.get("text", "") for m in self.messages)

    def answer(self, id):
        return next((m for m in self.messages if m["type"] == "answer" and m["id"] == id), None)


class PausedLine(ConsoleLine):
    """Link to the console. While paused, requests wait in the socket."""

    is_paused = False

    def receive(self):
        return [] if self.is_paused else super().receive()


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """One flight: armed by the pilot, driven by the stick, a gain changed, the stick released, stopped."""
    found = catalogue.load_scenario("hovercraft/pilot", {"stick": "console", "supervisor": "automatic"})[0]
    scenario = replace(found, failsafe=replace(found.failsafe, timeout=seconds(8), age_max=8.0))
    folder, page = tmp_path_factory.mktemp("piloted"), Page()
    pair = Pair(scenario, "test-piloting", confirmed=frozenset({"failsafe.timeout"}))
    pair.start(folder / "vehicle.mcap")
    line, over, flight = PausedLine(page.other), threading.Event(), []
    hello = describe_flight(pair.flyer, line)
    slots = {s["path"]: k for k, s in enumerate(hello["signals"])}

    def read(path):
        return page.rows[-1][slots[path]]

    def fly():
        flight.append(
            pair.flyer.fly(
                duration=seconds(600),
                log=folder / "flight.mcap",
                wanted_real_time=False,
                console=line,
                stop=over.is_set,
            )
        )

    pair.flyer.connect()
    thread = threading.Thread(target=fly)
    thread.start()
    try:
        page.wait(lambda: len(page.rows) > 25, "rows")
        held = read("vehicle.armed")
        page.arm(lambda: read("vehicle.armed") == 1, 1)
        page.send("take", pilot=1)
        page.has_stick, page.forward = True, 1.0
        page.wait(lambda: read("estimate.state.surge_velocity") > 0.3, "it moves")
        page.send("set", path=GAIN, slot=0, value=1.7, client=1, id=7)
        page.send("set", path=GAIN, slot=0, value=-3.0, client=1, id=8)
        page.send("set", path="autopilot.law.nothing", slot=0, value=1.0, client=1, id=9)
        page.wait(lambda: page.answer(7) and page.answer(8) and page.answer(9), "answers")
        page.has_stick = False
        page.wait(lambda: page.heard("supervisor: hold: hold request"), "the dead man holds")
        page.wait(lambda: page.heard("flight ended"), "the dead man ends it")
        page.wait(lambda: read("vehicle.armed") == 0, "it is disarmed")
        line.is_paused = True  # so that one period reads both requests
        page.send("request", request="clear", client=1, id=10)
        page.send("request", request="arm", client=1, id=12)
        line.is_paused = False
        page.wait(lambda: read("supervisor.mode") in (STANDBY, FLYING), "cleared")
        page.arm(lambda: read("vehicle.armed") == 1, 11)
        page.send("stop", client=1)
        page.wait(lambda: read("vehicle.armed") == 0 and page.heard("stopped from the console"), "stopped")
    finally:
        over.set()
        thread.join(20)
        pair.end()
        line.close()
        page.own.close()
    log = read_mcap(folder / "flight.mcap")
    return SimpleNamespace(page=page, log=log, held=held, flight=flight[0])


def test_vehicle_stays_disarmed_until_the_pilot_arms(flown):
    assert flown.held == 0
    assert "the vehicle was never armed" not in flown.flight.problems


def test_stick_moves_the_vehicle_and_is_logged(flown):
    log = flown.log
    assert log["downlink.stick.value.forward"].max() == 1.0
    assert log["downlink.stick.value.mode"][-1] == 1
    fresh = log["downlink.stick.fresh"].astype(bool)
    assert 10 < fresh.sum() < len(fresh) / 5
    assert log["estimate.state.surge_velocity"].max() > 0.3


def test_gain_change_within_bounds_is_applied_and_logged(flown):
    good, bad, unknown = (flown.page.answer(k) for k in (7, 8, 9))
    assert (good["ok"], bad["ok"], unknown["ok"]) == (True, False, False)
    assert "must be" in bad["text"]
    assert "no parameter" in unknown["text"]
    assert [(c.path, c.value) for c in read_changes(flown.log)] == [("law.k1", 1.7)]
    values = [m["value"] for m in flown.page.messages if m["type"] == "value" and m["path"] == GAIN]
    assert values[:2] == [1.7, 1.7]


def test_second_request_in_one_period_is_refused(flown):
    """A step takes one request. The other one would be lost without a report."""
    first, second = (flown.page.answer(k) for k in (10, 12))
    assert (first["ok"], second["ok"]) == (True, False)
    assert "try again" in second["text"]


def test_stick_timeout_holds_then_ends_the_flight(flown):
    told = [e["text"] for e in flown.log.metadata["events"]]
    hold = next(k for k, text in enumerate(told) if "supervisor: hold: hold request" in text)
    end = next(k for k, text in enumerate(told) if "flight ended" in text)
    assert hold < end
    times = [e["t"] for e in flown.log.metadata["events"]]
    assert times[end] - times[hold] == pytest.approx(2.5, abs=0.5)


def test_replayed_frames_give_bit_identical_commands(flown):
    found = replay(flown.log, rebuild_scenario(flown.log), backend="c")
    assert (found.exact, found.equal, found.first) == (True, True, None)


def test_timing_and_stick_latency_are_sent_to_console(flown):
    timing = [m for m in flown.page.messages if m["type"] == "timing"]
    assert timing
    deadlines = timing[-1]["deadlines"]
    assert len(deadlines["edges"]) == len(deadlines["late"]) + 1 == len(deadlines["work"]) + 1
    assert sum(deadlines["work"]) <= flown.flight.deadlines.work.summary().n
    assert any(m["stick_latency"] is not None and 0 <= m["stick_latency"] < 0.5 for m in timing)
