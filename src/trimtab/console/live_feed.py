"""Connection between a flight and its pages. Rows of signals and events are sent to all pages, and requests of pilots
are passed to the flight."""

import asyncio
import json
import socket
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from trimtab.console.access import PILOT
from trimtab.console.alarms import ALARM, Flight
from trimtab.console.clients import Client
from trimtab.console.flight_numbers import FlightNumbers
from trimtab.core.time import to_seconds
from trimtab.flight.console_packets import END_SILENCE, HEAD, LARGEST_PACKET, ROW, TEXT

STATUS_PERIOD = 0.2
EVENTS_KEPT = 200
"""Maximum number of past events that are sent to a new page."""
MUTABLE = ("request", "stop", "set", "save")
"""Types of messages from pages that are forwarded to the flight unchanged."""


class LiveFeed:
    """Console's end of the connection between a live flight and its console."""

    def __init__(self, end: socket.socket, hello: dict[str, Any], ended: Callable[[], None]) -> None:
        """end: one end of a socket pair, whose other end belongs to the flight.

        ended: function that is called at the end of the flight.
        """
        end.setblocking(False)
        self._end, self._ended, self.hello = end, ended, hello
        self._flight, self._numbers = Flight(hello), FlightNumbers(hello["signals"])
        self.clients: list[Client] = []
        self._count = 0
        self._pilot: int | None = None
        self._stick_clock = 0.0
        """Time (s) at which a pilot last sent a stick position or took the stick."""
        self._events: list[dict[str, Any]] = []
        self._checks: list[Any] = []
        self._timing: dict[str, Any] = {}
        self._alarms: dict[str, dict[str, Any]] = {}
        self._values = {(p["path"], p["slot"]): p for p in hello["parameters"]}

    def join(self, client: Client) -> None:
        """Add a page, and send it the description of the flight and the last events."""
        client.send({"type": "hello", "role": client.role, **self.hello})
        for event in self._events:
            client.send(event)
        self.clients.append(client)

    def leave(self, client: Client, why: str) -> None:
        """Remove a page. If the page had the stick, the stick is not released: the dead man's switch acts on the
        missing data."""
        self.clients.remove(client)
        if self._pilot == client.number:
            self._pilot = None
        if why:
            self.note(f"console: page {client.number} closed: {why}")

    def next_number(self) -> int:
        """Return a number for a new page."""
        self._count += 1
        return self._count

    def note(self, text: str) -> None:
        """Send a line of text to the flight's log. The flight returns the line as an event."""
        self._tell({"type": "note", "text": text})

    def handle(self, client: Client, message: dict[str, Any]) -> None:
        """Handle a message that a page has sent."""
        kind, number = message["type"], client.number
        if kind == "ping":
            client.send({"type": "pong", "sent": message["sent"], "clock": time.monotonic()})
        elif kind == "acknowledge":
            self._acknowledge(client, message["alarm"])
        elif kind == "stick":
            if self._pilot == number:
                self._stick_clock = time.monotonic()
                self._tell({**message, "pilot": number, "clock": self._stick_clock})
        elif kind == "take":
            self._take(client, message["id"])
        elif kind == "release":
            if self._pilot == number:
                self._pilot, self._flight.piloted_since = None, None
                self._tell({"type": "release", "pilot": number})
            client.send({"type": "answer", "id": message["id"], "ok": True, "text": "you have released the stick"})
        elif kind in MUTABLE:
            self._tell({**message, "client": number})

    def _take(self, client: Client, id: int) -> None:
        holder = self._pilot
        if self.hello["pilot"] is None:
            text = "the control law of this scenario does not use a stick"
        elif holder not in (None, client.number):
            text = f"page {holder} has the stick"
        else:
            self._pilot, self._stick_clock, text = client.number, time.monotonic(), ""
            self._flight.piloted_since = time.monotonic()
            self._tell({"type": "take", "pilot": client.number})
        client.send({"type": "answer", "id": id, "ok": not text, "text": text or "you have the stick"})

    def _acknowledge(self, client: Client, alarm: str) -> None:
        held = self._alarms.get(alarm)
        if held is not None and client.role == PILOT and not held["acknowledged"]:
            held["acknowledged"] = True
            self.note(f"console: alarm {alarm} acknowledged by page {client.number}")

    def _tell(self, message: Mapping[str, Any]) -> None:
        try:
            self._end.send(TEXT + json.dumps(message).encode())
        except OSError:
            self._publish(
                {"type": "event", "t": None, "text": "the autopilot does not accept requests", "level": ALARM}
            )

    async def run(self) -> None:
        """Forward the data of the flight to the pages until the flight ends."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._end.fileno(), self._read)
        while True:
            await asyncio.sleep(STATUS_PERIOD)
            self._update_alarms()
            if self._pilot is not None and time.monotonic() - self._stick_clock > to_seconds(END_SILENCE):
                self._pilot = None  # the dead-man switch has ended the flight: another page may take the stick
            if self.clients:
                self._publish_status()

    def _read(self) -> None:
        """Read all packets that have arrived from the flight. Of several rows, only the newest row is used."""
        row: bytes | None = None
        while True:
            try:
                packet = self._end.recv(LARGEST_PACKET)
            except BlockingIOError:
                break
            except OSError:
                packet = b""
            if not packet:
                self._finish()
                break
            if packet[:1] == ROW:
                row = packet[1:]
            else:
                self._handle_flight(json.loads(packet[1:]))
        if row is not None:
            row = self._numbers.extend(row)
            t, clock = HEAD.unpack_from(row)
            self._flight.take_row(t, clock, np.frombuffer(row, "<f4", offset=HEAD.size))
            for client in self.clients:
                client.send_row(row)

    def _finish(self) -> None:
        asyncio.get_running_loop().remove_reader(self._end.fileno())
        self._publish({"type": "end", "text": "the flight is over"})
        self._ended()

    def _handle_flight(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "checks":
            self._checks = message["checks"]
        elif kind == "timing":
            self._timing = message
        elif kind == "answer":
            for client in self.clients:
                if client.number == message["client"]:
                    client.send({n: message[n] for n in ("type", "id", "ok", "text")})
        elif kind == "value":
            held = self._values.get((message["path"], message["slot"]))
            if held is not None:
                held["value"] = message["value"]
                self._publish(message)
        elif kind == "event":
            message.setdefault("level", "info")
            self._events = [*self._events[1 - EVENTS_KEPT :], message]
            self._publish(message)

    def _publish(self, message: Mapping[str, Any]) -> None:
        for client in self.clients:
            client.send(message)

    def _update_alarms(self) -> None:
        """Update the alarms. Report the start and end of each alarm as an event and in the flight's log."""
        now = {a.id: a for a in self._flight.list_alarms(time.monotonic())}
        for id in [id for id in self._alarms if id not in now]:
            self.note(f"console: cleared: {self._alarms.pop(id)['text']}")
        for id, alarm in now.items():
            held = self._alarms.get(id)
            if held is None or (held["level"] != alarm.level and alarm.level == ALARM):
                self._alarms[id] = {**alarm._asdict(), "since": self._flight.t, "acknowledged": False}
                self.note(f"console: {alarm.level}: {alarm.text}")
            else:
                held |= {"level": alarm.level, "text": alarm.text}

    def _publish_status(self) -> None:
        flight, timing = self._flight, self._timing
        battery, is_armed = flight.read("battery.voltage"), flight.read("vehicle.armed") == 1
        if is_armed:
            self._checks = []  # the checks apply only before arming
        common = {
            "type": "status",
            "checks": self._checks,
            "requests": flight.explain_requests(),
            "link": flight.describe_link(timing),
            "deadlines": timing.get("deadlines"),
            "overruns": timing.get("overruns"),
            "battery": None if battery != battery else {"voltage": battery, "remaining": None},
            "armed": is_armed,
            "owned": flight.read("vehicle.owned") == 1,
            "alarms": list(self._alarms.values()),
            "stick_latency": timing.get("stick_latency"),
            "longest_stick_latency": timing.get("longest_stick_latency"),
            "clients": len(self.clients),
        }
        for client in self.clients:
            own = "nobody" if self._pilot is None else "you" if self._pilot == client.number else "other"
            client.send({**common, "pilot": own})


def row_size(signals: int) -> int:
    """Return the size (bytes) of a row with `signals` signals, as sent to a page."""
    return HEAD.size + struct.calcsize("<f") * signals
