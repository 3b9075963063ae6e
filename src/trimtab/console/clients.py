"""Connections to the pages of a console. A slow page gets only the newest row of signals. Content and rate of a page's
messages are checked.

The server closes the connection to a page if the page accepts no data for LONGEST_SEND (s), or if it sends invalid, too
large or too frequent messages. Only messages of known types, with values of the expected types, are passed to the
flight.
"""

import asyncio
import contextlib
import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from trimtab.console.access import PILOT
from trimtab.loop.supervisor_modes import REQUESTS

LARGEST_MESSAGE = 4096
MOST_MESSAGES = 200
"""Maximum number of messages per second from a page."""
MOST_TEXTS = 500
"""Maximum number of messages in the queue for a page. If the queue is full, the oldest message is dropped."""
LONGEST_SEND = 5.0
LAST_READ = 0.1
VIOLATION = 1008

Check = Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_axis(value: Any) -> bool:
    return _is_number(value) and -1 <= value <= 1


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 31


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= 256


ANSWERED = {"id": _is_count}
MESSAGES: Mapping[str, Mapping[str, Check]] = {
    "ping": {"sent": _is_number},
    "acknowledge": {"alarm": _is_name},
    "take": ANSWERED,
    "release": ANSWERED,
    "stick": {"forward": _is_axis, "turn": _is_axis, "mode": _is_count},
    "request": {"request": lambda value: value in REQUESTS[1:], **ANSWERED},
    "stop": {},
    "set": {"path": _is_name, "slot": _is_count, "value": _is_number, **ANSWERED},
    "save": ANSWERED,
}
"""Fields of each type of message, by the type. Each field has a function that checks the field's value."""
OBSERVED = ("ping", "acknowledge")
"""Types of messages that an observer may send."""


def parse_message(text: str, role: str) -> dict[str, Any]:
    """Parse a message of a page. Raise ValueError, with the reason, if the message is not valid."""
    message = json.loads(text)
    if not isinstance(message, dict):
        raise ValueError("the message is not a JSON object")
    kind = message.get("type")
    fields = MESSAGES.get(kind) if isinstance(kind, str) else None
    if fields is None:
        raise ValueError(f"unknown type {str(kind)[:40]!r}")
    if role != PILOT and kind not in OBSERVED:
        raise ValueError(f"an observer must not send the message {kind!r}")
    for name, is_good in fields.items():
        if not is_good(message.get(name)):
            raise ValueError(f"the message {kind!r} has an invalid field {name!r}")
    return {"type": kind, **{name: message[name] for name in fields}}


class Client:
    """Connection of one page to the server."""

    def __init__(self, number: int, role: str, socket: WebSocket) -> None:
        """number: number of the page, by which events name the page."""
        self.number, self.role, self._socket = number, role, socket
        self._texts: deque[str] = deque(maxlen=MOST_TEXTS)
        self._row: bytes | None = None
        self._wake = asyncio.Event()
        self._second, self._count = 0.0, 0

    def send(self, message: Mapping[str, Any]) -> None:
        """Queue a message for the page. If the queue is full, the oldest message is dropped."""
        self._texts.append(json.dumps(message, allow_nan=False))
        self._wake.set()

    def send_row(self, row: bytes) -> None:
        """Store a row, to be sent when the page is ready. A newer row replaces a row that is not sent yet."""
        self._row = row
        self._wake.set()

    async def serve(self, handle: Callable[["Client", dict[str, Any]], None]) -> str:
        """Serve the page until its connection is closed. Return the reason why the server closed the connection, or ""
        if the page closed it."""
        tasks = [asyncio.create_task(self._read(handle)), asyncio.create_task(self._feed())]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        await asyncio.wait(tasks, timeout=LAST_READ)  # for a broken socket, the reading task returns the reason
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
        why = next((text for text in ended if isinstance(text, str) and text), "")
        with contextlib.suppress(RuntimeError, OSError):
            if self._socket.application_state == WebSocketState.CONNECTED:
                await asyncio.wait_for(self._socket.close(VIOLATION, why[:100]), 1.0)
        return why

    async def _feed(self) -> str:
        try:
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._texts:
                    await asyncio.wait_for(self._socket.send_text(self._texts.popleft()), LONGEST_SEND)
                row, self._row = self._row, None
                if row is not None:
                    await asyncio.wait_for(self._socket.send_bytes(row), LONGEST_SEND)
        except TimeoutError:
            return f"the page accepted no data for {LONGEST_SEND:g} s"
        except (WebSocketDisconnect, RuntimeError, OSError):
            return ""

    async def _read(self, handle: Callable[["Client", dict[str, Any]], None]) -> str:
        try:
            while True:
                packet = await self._socket.receive()
                if packet["type"] == "websocket.disconnect":
                    too_large = packet.get("code") == 1009
                    return f"the page sent a message of more than {LARGEST_MESSAGE} bytes" if too_large else ""
                if self._is_flooding():
                    return f"the page sent more than {MOST_MESSAGES} messages a second"
                text = packet.get("text")
                if text is None:
                    return "the page sent a binary message"
                handle(self, parse_message(text, self.role))
        except (ValueError, RecursionError) as error:
            return f"the page sent an invalid message: {error}"
        except (WebSocketDisconnect, RuntimeError, OSError):
            return ""

    def _is_flooding(self) -> bool:
        now = time.monotonic()
        if now - self._second >= 1.0:
            self._second, self._count = now, 0
        self._count += 1
        return self._count > MOST_MESSAGES
