"""Time stamps of signed packets. A program never sends the same time stamp twice, not even after a restart. A receiver
accepts each time stamp once.

A time stamp (short: stamp) is the time since 1 January 2015, in units of 10 us. The file beside the key stores a stamp
ten seconds ahead, so that it is rarely written. After a restart, stamps continue from the stored stamp. Stamps follow
the monotonic clock, so a step of the wall clock has no effect.

Refused as replayed: a stamp that was accepted before from the same stream (system, component, link), and a stamp that
is 250 ms or more behind the newest stamp of the stream. A packet that must arrive in order is also refused if its stamp
is not newer than the stamps of all earlier such packets of the stream.
Refused as stale: a stamp that is not newer than this end's first stamp, or that is over a minute behind this end.
Refused as leading: a stamp over 40 s ahead of this end's clock. If such a stamp were accepted, this end's own and
stored stamps would move up to it, and stamps of peers with a correct clock would be refused as stale. If the stored
stamp is further ahead when the program starts, the limit is the lead of the stored stamp plus 1 s, because peers have
followed this stamp. So a restart adds at most 1 s to a lead, or 11 s if the program was killed. A peer whose clock lags
by less than this lead is refused until it has received a packet of this end, because every MAVLink program moves its
own stamp up to the stamps that it accepts.
Source: https://mavlink.io/en/guide/message_signing.html, which lets a new stream start up to a minute in the past, so
that packets recorded in the minute before a restart could be replayed. Here they are refused. S. Kent, "IP
encapsulating security payload", RFC 4303 (2005), section 3.4.3: anti-replay window for packets that overtake one
another.
"""

import contextlib
import os
from collections import deque
from collections.abc import Callable
from enum import Enum
from pathlib import Path

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.errors import InputError

try:
    import fcntl
except ImportError:  # no file locks on this system: two processes with the same ids are not detected
    fcntl = None

EPOCH = 1_420_070_400
"""Start of the time stamps, 1 January 2015, in Unix time (s)."""
PER_SECOND = 100_000
MARGIN = 60 * PER_SECOND
"""Largest accepted age of a time stamp (10 us)."""
LONGEST_LATENESS = PER_SECOND // 4
"""Largest accepted lag (10 us) of a stamp behind the newest stamp of its stream. A vehicle that gets no data for this
time goes to a safe state."""
STORE_MARGIN = 10 * PER_SECOND
"""Lead (10 us) of the stored stamp over the last sent stamp. A program that was killed is ahead of its peers by up to
this time after its restart."""
MOST_LEAD = MARGIN - 2 * STORE_MARGIN
"""Largest accepted lead (10 us) of a stamp over this end's clock. The limit ensures that stamps of a correct clock
never become stale."""
RESTART_LEAD = PER_SECOND
"""Largest amount (10 us) by which a restart may increase the accepted lead."""
LARGEST = 2**48 - 1
DIGITS = 20
MOST_STREAMS = 256
"""Maximum number of streams whose stamps are remembered, so that a sender with the key cannot fill the memory."""


class Refusal(Enum):
    """Reason why a time stamp is not accepted."""

    REPLAYED = "replayed"
    STALE = "stale"
    LEADING = "leading"


def running_clock(clock: Clock = SYSTEM_CLOCK) -> Callable[[], float]:
    """Return a function that returns the Unix time (s): the wall clock is read once, then continued by the monotonic
    clock."""
    began, start = clock.unix(), clock.monotonic_ns()
    return lambda: began + (clock.monotonic_ns() - start) / NS_PER_SECOND


class _Stream:
    """Time stamps accepted from one stream. A stamp is kept as long as stamps of the same age could still be
    accepted."""

    def __init__(self, floor: int) -> None:
        self.newest = self.ordered = floor
        self._taken: set[int] = set()
        self._coming: deque[int] = deque()

    def is_new(self, stamp: int, ordered: bool) -> bool:
        if stamp > self.newest:
            return True
        late = stamp > self.newest - LONGEST_LATENESS and stamp not in self._taken
        return late and not (ordered and stamp <= self.ordered)

    def remember(self, stamp: int, ordered: bool) -> None:
        self.newest = max(self.newest, stamp)
        if ordered:
            self.ordered = max(self.ordered, stamp)
        self._taken.add(stamp)
        self._coming.append(stamp)
        while self._coming[0] <= self.newest - LONGEST_LATENESS:
            self._taken.remove(self._coming.popleft())


class Stamps:
    """Time stamps of one end of a link: stamps for sent packets, and checks of received stamps."""

    def __init__(
        self, store: Path | None = None, clock: Callable[[], float] | None = None, *, is_reset: bool = False
    ) -> None:
        """Start above the stored stamp and above the current time. store: file for the stamp, which stays locked until
        close(), or None to store no stamp.

        is_reset: True to start with the current time and ignore the stored stamp, e.g. if a program with a wrong clock
        stored a future stamp.
        """
        self._clock, self._shift = clock or running_clock(), 0
        self._file = None if store is None else _open_store(store)
        self._ceiling = 0
        if self._file is not None and store is not None and not is_reset:
            self._ceiling = _read_store(self._file, store)
        start = self._current_stamp()
        self._floor = self.last = max(self._ceiling, start)
        self._most_lead = max(MOST_LEAD, self.last - start + RESTART_LEAD)
        self._streams: dict[tuple[int, int, int], _Stream] = {}
        self.unsaved = 0
        """Number of times the stamp could not be stored, e.g. because the disk is full."""

    def _current_stamp(self) -> int:
        return min(max(int((self._clock() - EPOCH) * PER_SECOND) + self._shift, 0), LARGEST)

    def next_stamp(self) -> int:
        """Return a new time stamp, which is greater than all earlier time stamps of this end."""
        self._raise_to(min(max(self.last + 1, self._current_stamp()), LARGEST))
        return self.last

    def store_ahead(self) -> None:
        """Store a future stamp if less than half of the stored stamp's lead is left.

        Call this regularly, in a thread that may wait for the disk.
        """
        if self._file is not None and self.last + STORE_MARGIN // 2 > self._ceiling:
            self._write_store()

    def find_refusal(self, stream: tuple[int, int, int], stamp: int, ordered: bool = True) -> Refusal | None:
        """Return the reason to refuse a stamp of a stream (system, component, link), or None if the stamp is
        acceptable. Do not mark the stamp as accepted.

        ordered: True if the packet must not arrive after a newer ordered packet.
        """
        now = self._current_stamp()
        if stamp > now + self._most_lead:
            return Refusal.LEADING
        if stamp <= self._floor or stamp < max(self.last, now) - MARGIN:
            return Refusal.STALE
        heard = self._streams.get(stream)
        return None if heard is None or heard.is_new(stamp, ordered) else Refusal.REPLAYED

    @property
    def stored_lead(self) -> float:
        """Lead (s) of this end's first stamp over this end's clock, because of the stored stamp."""
        return max(self._floor - self._current_stamp(), 0) / PER_SECOND

    def lead(self, stamp: int) -> float:
        """Return the lead (s) of a received stamp over this end's own stamp. The lead is negative if the received stamp
        is behind."""
        return (stamp - max(self.last, self._current_stamp())) / PER_SECOND

    def follow(self, stamp: int) -> None:
        """Continue from a time stamp of the other end, even if it is behind this end's stamps. The stamp must be from a
        current answer, not a replayed one.

        After this call no stamp is stored, because the stamps do not follow this end's clock.
        """
        self._shift += stamp - self._current_stamp()
        self._floor = self.last = stamp
        self._most_lead = MOST_LEAD
        self._streams.clear()
        self._close_file()

    def accept(self, stream: tuple[int, int, int], stamp: int, ordered: bool = True) -> None:
        """Mark the stamp of a packet with a valid signature as accepted. If this end's own stamp is smaller, raise it
        to the accepted stamp."""
        if stream not in self._streams:
            if len(self._streams) >= MOST_STREAMS:
                self._forget_oldest()
            self._streams[stream] = _Stream(self._floor)
        self._streams[stream].remember(stamp, ordered)
        self._raise_to(max(self.last, stamp))

    def _forget_oldest(self) -> None:
        """Delete the record of the stream whose latest accepted stamp is smallest. Packets of any stream with this or a
        smaller stamp are refused as stale from then on, so the packets of the deleted stream cannot be replayed."""
        oldest = min(self._streams, key=lambda stream: self._streams[stream].newest)
        self._floor = max(self._floor, self._streams.pop(oldest).newest)

    def close(self) -> None:
        """Store the current stamp without a lead, and close the file."""
        if self._file is not None:
            self._write_store(0)
        self._close_file()

    def abandon(self) -> None:
        """Close the file without storing a stamp, as the system does when a process dies."""
        self._close_file()

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _raise_to(self, stamp: int) -> None:
        self.last = stamp
        if self._file is not None and stamp >= self._ceiling:
            self._write_store()

    def _write_store(self, margin: int = STORE_MARGIN) -> None:
        assert self._file is not None
        ceiling = min(self.last + margin, LARGEST)
        try:
            os.pwrite(self._file, f"{ceiling:0{DIGITS}d}\n".encode(), 0)
            os.fsync(self._file)
        except OSError:
            self.unsaved += 1
            ceiling = self.last + PER_SECOND  # after a failure, try again in a second
        self._ceiling = ceiling


def _open_store(store: Path) -> int:
    where = f"time stamps '{store}'"
    try:
        store.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        file = os.open(store, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except OSError as error:
        problem = f"the file cannot be written: {error.strerror or error}"
        raise InputError(where, problem, fix="keep the key file in a folder that you can write") from None
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        problem = "another process uses this key, system, component and link; each would refuse the other's packets"
        raise InputError(where, problem, fix="end the other process (Ctrl-C), then start this program again") from None
    return file


def _read_store(file: int, store: Path) -> int:
    text = os.pread(file, 64, 0).strip()
    if not text:
        return 0
    with contextlib.suppress(ValueError):
        stamp = int(text)
        if 0 <= stamp <= LARGEST:
            return stamp
    os.close(file)
    problem = f"the file contains {text[:32]!r} instead of a time stamp"
    raise InputError(f"time stamps '{store}'", problem, fix=f"rm '{store}'  on a machine whose clock is right")
