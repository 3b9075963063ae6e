"""The far end of a link test: echoes requests with its timer appended, and makes the load it is asked for."""

import time
from collections.abc import Callable

from trimtab.core.interfaces import Link
from trimtab.live.clock_time import LOAD_DOWN, STATUS, UP, Hello, Parser, appended, hello_of, this_boot

MOST_LOAD = 125_000
"""Bytes per second that it will send, whoever asks."""
KEEPS = 3.0
"""Seconds for which it sends load after the last request for it."""
BURST = 4
"""Messages of load at once, at most, after a delay of the machine's own."""


def now() -> int:
    """The time of this machine's monotonic clock, which all its processes share, in 100 ns."""
    return time.monotonic_ns() // 100


class Pace:
    """Says when a message of load is due, so that all that is sent makes a rate (byte/s)."""

    def __init__(self, size: int) -> None:
        self._size, self._due, self.rate = size, 0.0, 0.0

    def wait(self, t: float) -> float:
        """Seconds from t (s) until the next message is due; an hour where there is no load."""
        return max(self._due - t, 0.0) if self.rate > 0 else 3600.0

    def due(self, t: float) -> bool:
        """Whether a message is due at t (s), which is then counted as sent."""
        if self.rate <= 0 or t < self._due:
            return False
        self.spent(self._size, t)
        return True

    def spent(self, size: int, t: float) -> None:
        """So many bytes were sent at t (s)."""
        if self.rate > 0:
            earliest = t - BURST * self._size / self.rate if self._due else t
            self._due = max(self._due, earliest) + size / self.rate


def echo(
    link: Link,
    *,
    stop: Callable[[], bool] = lambda: False,
    clock: Callable[[], int] = now,
    boot: bytes | None = None,
) -> int:
    """Answer until `stop`, looked at ten times a second. Returns the number of requests echoed.

    Args:
        link: to the measuring end.
        stop: whether to end.
        clock: in 100 ns.
        boot: what tells whose clock it is; None: this machine's.
    """
    parser, pace, boot = Parser(UP), Pace(len(LOAD_DOWN)), this_boot() if boot is None else boot
    session, heard, echoed, until = -1, 0, 0, 0.0
    while not stop():
        data = link.receive(min(0.1, pace.wait(time.monotonic())))
        arrived = clock()
        for message in parser.feed(data) if data else ():
            link.vouch()
            answer = appended(message, arrived)
            hello = hello_of(message.data) if message.id == STATUS else None
            if hello is not None:
                heard = heard if hello.session == session else 0
                session, pace.rate, until = hello.session, min(hello.number, MOST_LOAD), time.monotonic() + KEEPS
                answer = Hello(boot, session, heard).pack()
            elif answer:
                heard, echoed = heard + 1, echoed + 1
            if answer:
                link.send(answer)
                pace.spent(len(answer), time.monotonic())
        if time.monotonic() > until:
            pace.rate = 0.0
        if pace.due(time.monotonic()):
            link.send(LOAD_DOWN)
    return echoed
