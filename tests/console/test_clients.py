"""Messages that a page may send."""

import json

import pytest

from trimtab.console.access import OBSERVER, PILOT
from trimtab.console.clients import MESSAGES, parse_message

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
