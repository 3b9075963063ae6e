"""Time stamps of signed packets: those sent never repeat, not even after a restart; those received are taken once.

A stamp counts 10 us since 2015. What is stored beside the key lies ten seconds ahead, so that it is written seldom;
after a restart stamps go on from there. Time runs by the monotonic clock, so that a stepped wall clock changes nothing.

Refused as replayed: a stamp that was taken before from its stream (system, component, link); one that is 250 ms or more
behind the newest of its stream. What has to come in order is refused, too, where its stamp is not newer than that of
all before it that had to. Refused as stale: one that is not newer than this end's own stamp when it started; any that
is over a minute behind this end. Refused as leading: one that is over 40 s ahead of this end's clock; were it taken,
this end's own stamps, and those that it stores, would move up to it, and whoever has the right clock would be stale.
A peer whose clock lags by less than that is refused until it has heard this end once: every MAVLink implementation
moves its own stamp up to those that it accepts.
Source: https://mavlink.io/en/guide/message_signing.html, which lets a new stream start up to a minute back, so that
what was recorded in the minute before a restart could be sent again; here it can't. S. Kent, "IP encapsulating security
payload", RFC 4303 (2005), section 3.4.3: packets that overtake one another, each taken once.
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
except ImportError:  # no such locks on this system: two processes with one identity are not told apart
    fcntl = None

EPOCH = 1_420_070_400
"""1 January 2015, in seconds of Unix time."""
PER_SECOND = 100_000
MARGIN = 60 * PER_SECOND
"""How far behind a stamp may be."""
LONGEST_LATENESS = PER_SECOND // 4
"""How far behind the newest of its stream a stamp may be: a vehicle that hears nothing for so long stops by itself."""
STORE_MARGIN = 10 * PER_SECOND
"""How far ahead the stored stamp lies: after it was killed, a sender is ahead of its peers for so long."""
MOST_LEAD = MARGIN - 2 * STORE_MARGIN
"""How far a stamp may be ahead of this end's clock: with what is stored ahead, the right clock is still not stale."""
LARGEST = 2**48 - 1
DIGITS = 20


class Refusal(Enum):
    """Why a stamp is not taken."""

    REPLAYED = "replayed"
    STALE = "stale"
    LEADING = "leading"


def running_clock(clock: Clock = SYSTEM_CLOCK) -> Callable[[], float]:
    """Return a function for the Unix time (s): the wall clock now, continued by the monotonic clock."""
    began, start = clock.unix(), clock.monotonic_ns()
    return lambda: began + (clock.monotonic_ns() - start) / NS_PER_SECOND


class _Stream:
    """What was taken from one sender, as far back as it matters."""

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
    """The stamps of one sender, and the newest of each stream that it hears."""

    def __init__(
        self, store: Path | None = None, clock: Callable[[], float] | None = None, *, is_reset: bool = False
    ) -> None:
        """Start above what is stored and above now; `store` None keeps nothing. The file stays locked until close().

        is_reset: begin with now, whatever is stored: a clock that was wrong once has stored what is far ahead.
        """
        self._clock, self._shift = clock or running_clock(), 0
        self._file = None if store is None else _open_store(store)
        self._ceiling = 0
        if self._file is not None and store is not None and not is_reset:
            self._ceiling = _read_store(self._file, store)
        self.last = max(self._ceiling, self._current_stamp())
        self._floor = self.last
        self._streams: dict[tuple[int, int, int], _Stream] = {}
        self.unsaved = 0
        """How often the stamp ahead could not be written, e.g. because the disk is full."""

    def _current_stamp(self) -> int:
        return min(max(int((self._clock() - EPOCH) * PER_SECOND) + self._shift, 0), LARGEST)

    def next_stamp(self) -> int:
        """A stamp greater than all before."""
        self._raise_to(min(max(self.last + 1, self._current_stamp()), LARGEST))
        return self.last

    def store_ahead(self) -> None:
        """Store ahead of time if half the margin is used up: call it now and then where waiting does no harm."""
        if self._file is not None and self.last + STORE_MARGIN // 2 > self._ceiling:
            self._write_store()

    def find_refusal(self, stream: tuple[int, int, int], stamp: int, ordered: bool = True) -> Refusal | None:
        """Why a stamp of (system, component, link) may not be taken; nothing is remembered before `accept`.

        ordered: its packet must not come after a later one that must not either.
        """
        now = self._current_stamp()
        if stamp > max(now, self._floor) + MOST_LEAD:
            return Refusal.LEADING
        if stamp <= self._floor or stamp < max(self.last, now) - MARGIN:
            return Refusal.STALE
        heard = self._streams.get(stream)
        return None if heard is None or heard.is_new(stamp, ordered) else Refusal.REPLAYED

    @property
    def stored_lead(self) -> float:
        """By how much this end began ahead of its clock (s), because so much was stored."""
        return max(self._floor - self._current_stamp(), 0) / PER_SECOND

    def lead(self, stamp: int) -> float:
        """By how much a stamp is ahead of this end's own (s); negative behind it."""
        return (stamp - max(self.last, self._current_stamp())) / PER_SECOND

    def follow(self, stamp: int) -> None:
        """Go on from another end's stamp, ahead or behind, of which its answer has shown that it is of now.

        Nothing is stored any more: the clock that is followed is not this end's.
        """
        self._shift += stamp - self._current_stamp()
        self._floor = self.last = stamp
        self._streams.clear()
        self._close_file()

    def accept(self, stream: tuple[int, int, int], stamp: int, ordered: bool = True) -> None:
        """Remember the stamp of a packet whose signature was right; this end's own moves up to it."""
        if stream not in self._streams:
            self._streams[stream] = _Stream(self._floor)
        self._streams[stream].remember(stamp, ordered)
        self._raise_to(max(self.last, stamp))

    def close(self) -> None:
        """Store exactly where the stamps stand, and give the file back."""
        if self._file is not None:
            self._write_store(0)
        self._close_file()

    def abandon(self) -> None:
        """Give the file back and store nothing, as the system does when a process dies."""
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
            ceiling = self.last + PER_SECOND  # try again in a second
        self._ceiling = ceiling


def _open_store(store: Path) -> int:
    where = f"time stamps '{store}'"
    try:
        store.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        file = os.open(store, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except OSError as error:
        problem = f"cannot be written: {error.strerror or error}"
        raise InputError(where, problem, fix="keep the key file in a folder of yours") from None
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        problem = "another process sends with this key, system, component and link; each would refuse the other's"
        raise InputError(where, problem, fix="end the other one (Ctrl-C), then start this one again") from None
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
    problem = f"holds {text[:32]!r} and no stamp"
    raise InputError(f"time stamps '{store}'", problem, fix=f"rm '{store}'  on a machine whose clock is right")
