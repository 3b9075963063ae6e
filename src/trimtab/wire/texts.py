"""Lines for people: long ones in several messages, and no more of them than can be sent.

Source: https://mavlink.io/en/messages/common.html, STATUSTEXT.
"""

from collections import deque

from trimtab.wire.mavlink import Endpoint
from trimtab.wire.protocol import Severity

PIECE = 50
MOST = 20


class Texts:
    """Lines that wait to be sent; `dropped` counts those that found no room."""

    def __init__(self, endpoint: Endpoint) -> None:
        """Nothing to say."""
        self._endpoint = endpoint
        self._waiting: deque[tuple[Severity, bytes, int, int]] = deque()
        self._number = 0
        self.dropped = 0

    def say(self, severity: Severity, text: str) -> None:
        """Put a line at the end."""
        pieces = _pieces(text.encode())
        if len(self._waiting) + len(pieces) > MOST:
            self.dropped += 1
            return
        self._number = self._number % 0xFFFF + 1
        number = self._number if len(pieces) > 1 else 0
        self._waiting.extend((severity, piece, number, k) for k, piece in enumerate(pieces))

    def take(self) -> list[bytes]:
        """All that waits, packed."""
        found = [
            self._endpoint.pack("STATUSTEXT", {"severity": severity, "text": piece, "id": number, "chunk_seq": k})
            for severity, piece, number, k in self._waiting
        ]
        self._waiting.clear()
        return found


def _pieces(text: bytes) -> list[bytes]:
    """A text in as many messages as it needs; where the last is full, an empty one says that it ends."""
    pieces = [text[k : k + PIECE] for k in range(0, len(text), PIECE)] or [b""]
    return [*pieces, b""] if len(pieces) > 1 and len(pieces[-1]) == PIECE else pieces
