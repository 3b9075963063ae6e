"""Messages that a page may send."""

import asyncio
import json

import pytest
from starlette.websockets import WebSocketState

from trimtab.console import clients
from trimtab.console.access import OBSERVER, PILOT
from trimtab.console.clients import MESSAGES, VIOLATION, Client, parse_message

GOOD = {
    "ping": {"sent": 12.5},
    "acknowledge": {"alarm": "mute"},
    "take": {"id": 1},
    "release": {"id": 2},
    "stick": {"forward": 1, "turn": -0.5, "mode": 2},
    "request": {"request": "hold", "id": 3},
    "stop": {},
    "set": {"path": "autopilot.law.k1", "slot": 0, "value": 1e-3, "id": 4},
    "save": {"id": 5},
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_valid_messages_are_parsed_without_extra_fields(kind):
    sent = {"type": kind, **GOOD[kind]}
    assert parse_message(json.dumps({**sent, "pilot": 9, "clock": 1e9}), PILOT) == sent


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense",
        "[]",
        "3",
        "null",
        '{"type": "note", "text": "into the log"}',
        '{"type": ["stop"]}',
        '{"type": "stick", "forward": 1.01, "turn": 0, "mode": 0}',
        '{"type": "stick", "forward": NaN, "turn": 0, "mode": 0}',
        '{"type": "stick", "forward": true, "turn": 0, "mode": 0}',
        '{"type": "stick", "forward": 0, "turn": 0, "mode": -1}',
        '{"type": "stick", "forward": 0, "turn": 0, "mode": 1.5}',
        '{"type": "stick", "forward": 0, "turn": 0}',
        '{"type": "request", "request": "none", "id": 1}',
        '{"type": "request", "request": ["arm"], "id": 1}',
        '{"type": "request", "request": "arm"}',
        '{"type": "set", "path": "a", "slot": 0, "value": Infinity, "id": 1}',
        '{"type": "set", "path": "a", "slot": 0, "value": "1", "id": 1}',
        '{"type": "set", "path": 3, "slot": 0, "value": 1, "id": 1}',
        '{"type": "save", "id": 99999999999}',
        "[" * 3000,
    ],
)
def test_rejects_malformed_messages(text):
    with pytest.raises((ValueError, RecursionError)):
        parse_message(text, PILOT)


@pytest.mark.parametrize("kind", MESSAGES)
def test_observers_cannot_send_commands(kind):
    text = json.dumps({"type": kind, **GOOD[kind]})
    if kind in ("ping", "acknowledge"):
        assert parse_message(text, OBSERVER)["type"] == kind
    else:
        with pytest.raises(ValueError, match="observer"):
            parse_message(text, OBSERVER)


class DeafSocket:
    """Socket of a page that sends nothing, and accepts a number of messages only."""

    application_state = WebSocketState.CONNECTED

    def __init__(self, accepted):
        self.accepted, self.received, self.closed = accepted, [], None

    async def receive(self):
        await asyncio.Event().wait()

    async def send_text(self, text):
        if len(self.received) == self.accepted:
            await asyncio.Event().wait()
        self.received.append(text)

    send_bytes = send_text

    async def close(self, code, reason):
        self.closed = code, reason


@pytest.mark.parametrize("last", ["text", "row"])
def test_page_that_accepts_no_data_is_disconnected_after_five_seconds(monkeypatch, last):
    """The test shortens the five seconds."""
    assert clients.LONGEST_SEND == 5.0
    monkeypatch.setattr(clients, "LONGEST_SEND", 0.05)

    async def serve():
        socket = DeafSocket(accepted=1)
        client = Client(1, PILOT, socket)
        client.send({"type": "hello"})
        if last == "text":
            client.send({"type": "event"})
        else:
            client.send_row(b"row")
        began = asyncio.get_running_loop().time()
        why = await asyncio.wait_for(client.serve(lambda *_: None), 10)
        return socket, why, asyncio.get_running_loop().time() - began

    socket, why, took = asyncio.run(serve())
    assert (why, len(socket.received)) == ("the page accepted no data for 0.05 s", 1)
    assert socket.closed == (VIOLATION, why)
    assert took >= 0.05
