"""Flights with a console in virtual time: STOP, and a console that is killed or stopped in flight."""

import contextlib
import json
import socket

import pytest
from flight.virtual_pair import LOG, VirtualPair, events

from trimtab.compiler.native.compiler import find_compiler
from trimtab.console.hello import describe_flight
from trimtab.core.time import ms, seconds
from trimtab.flight.console_line import ConsoleLine
from trimtab.scenarios.build import build

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]


class ConsoleFlight:
    """A flight that the console, played by the test, arms. act: called with the flight 0.5 s after arming."""

    def __init__(self, act, duration):
        self.pair = VirtualPair(build("hovercraft/forward", {"supervisor": "automatic"}))
        own, self.server = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.server.setblocking(False)
        self.reads, self.act_time = True, 0

        def fly(flyer, machine):
            line = ConsoleLine(own, machine.clock)
            describe_flight(flyer, line)
            with own:
                return flyer.fly(log=LOG, tell=self.pair.said.append, console=line, duration=duration)

        def do():
            self.act_time = self.pair.vehicle.clock.now()
            act(self)

        self.pair.start_vehicle()
        self.pair.start_autopilot(fly)
        self.pair.time.call_at(0.1, self._serve)
        self.pair.when_armed(do)
        with self.server:
            self.pair.run()
        self.flight, self.served = self.pair.flying.result, self.pair.serving.result
        self.log, self.truth = self.pair.logs()

    def send(self, kind, **content):
        with contextlib.suppress(OSError):
            self.server.send(b"j" + json.dumps({"type": kind, "client": 1, **content}).encode())

    def _serve(self):
        """Read what the flight sends, and ask to arm until the vehicle is armed."""
        with contextlib.suppress(OSError):
            while self.reads and self.server.recv(1 << 16):
                pass
        if getattr(self.pair, "vehicle", None) is None or self.pair.vehicle.release_time is None:
            self.send("request", request="arm", id=1)
        self.pair.time.call_at(self.pair.time.seconds + 0.1, self._serve)


def test_stop_at_the_console_makes_outputs_safe_from_the_next_step():
    done = ConsoleFlight(lambda flight: flight.send("stop"), duration=seconds(5))
    log, stop = done.log, next(e["t"] for e in done.log.metadata["events"] if e["text"] == "stopped from the console")
    valid, armed_s = log["command.valid"].astype(bool), done.flight.arming_time * 1e-7
    assert valid[(log.t > armed_s + 0.1) & (log.t < stop)].all()
    assert not valid[log.t > stop].any()
    assert done.served.mode == "disarmed"
    assert 0 < done.served.disarm_time - done.act_time < ms(30)  # two periods and the link
    after = done.truth.t > done.served.disarm_time * 1e-7 + 0.02
    assert (done.truth["actuators.speed_rpm"][after] == 0).all()


def kill(flight):
    flight.server.close()


def stop_reading(flight):
    flight.reads = False


@pytest.mark.parametrize(
    ("act", "problem", "duration"),
    [(kill, "the console has ended", 2), (stop_reading, "the console accepts no data", 20)],
)
def test_console_that_fails_in_flight_is_reported_and_flight_continues(act, problem, duration):
    """The socket takes rows for some seconds before it is full."""
    done = ConsoleFlight(act, seconds(duration))
    told = [text for text in events(done.log) if text.startswith(problem)]
    assert told == [f"{problem}: its pages cannot stop the flight, use Ctrl-C"]
    assert any(problem in text for text in done.pair.said)
    assert (done.flight.problems, done.served.problems) == ((), ())
    assert done.flight.t - done.flight.arming_time >= seconds(duration)
    assert done.log["command.valid"][-1]
    assert done.flight.deadlines.own + done.flight.deadlines.scheduler == 0
