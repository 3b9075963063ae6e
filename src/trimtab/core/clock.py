"""Clocks. Code that waits or reads the time receives a Clock as an argument, so that the code also runs in virtual
time.

The system's clock is `SYSTEM_CLOCK`. The virtual clock is `trimtab.flight.virtual_time`.
Source: docs page, Testing.
"""

import select
import time
from typing import Protocol

NS_PER_SECOND = 1_000_000_000
SELECTABLE = 1024
"""Smallest file descriptor that is too large for select()."""


class Waitable(Protocol):
    """An object that can become ready to read, such as a socket."""

    def fileno(self) -> int:
        """Return the file descriptor of the object, or -1 after it is closed."""
        ...


class Clock(Protocol):
    """Clock of a process, with functions that read the time and a function that waits."""

    def monotonic_ns(self) -> int:
        """Return the monotonic time (ns)."""
        ...

    def unix(self) -> float:
        """Return the wall clock's time (s since 1970). A wall clock may jump when it is set."""
        ...

    def thread_ns(self) -> int:
        """Return the processor time of the calling thread (ns)."""
        ...

    def wait(self, ready: Waitable | None, timeout: float) -> bool:
        """Wait until an object is ready to read. Return False if it is not ready after `timeout` seconds.

        Args:
            ready: object to wait for. None: wait for the timeout only.
            timeout: maximum waiting time (s); infinity means no limit.
        """
        ...


class SystemClock:
    """Clock of this machine, read from the operating system."""

    def monotonic_ns(self) -> int:
        """Return the monotonic time (ns)."""
        return time.monotonic_ns()

    def unix(self) -> float:
        """Return the wall clock's time (s since 1970)."""
        return time.time()

    def thread_ns(self) -> int:
        """Return the processor time of the calling thread (ns)."""
        return time.thread_time_ns()

    def wait(self, ready: Waitable | None, timeout: float) -> bool:
        """Wait until an object is ready to read. Return False if it is not ready after `timeout` seconds."""
        if ready is None:
            time.sleep(max(timeout, 0.0))
            return False
        return wait_until_ready(ready.fileno(), select.POLLIN, max(timeout, 0.0))


SYSTEM_CLOCK = SystemClock()


def wait_until_ready(fd: int, mask: int, timeout: float) -> bool:
    """Wait for a file descriptor. Return False after `timeout` seconds without an event. An error counts as an event.

    select() is used if possible, because it is accurate to a microsecond. poll() accepts any descriptor, but counts in
    milliseconds, and a millisecond may be a whole control period.

    Args:
        fd: file descriptor.
        mask: select.POLLIN, select.POLLOUT, or both.
        timeout: maximum waiting time (s), not negative; infinity means no limit.
    """
    is_limited = timeout != float("inf")
    try:
        if fd < SELECTABLE:
            reads, writes = [fd] if mask & select.POLLIN else [], [fd] if mask & select.POLLOUT else []
            return any(select.select(reads, writes, [], timeout if is_limited else None))
        poll = select.poll()
        poll.register(fd, mask)
        return bool(poll.poll(timeout * 1e3 if is_limited else None))
    except (OSError, ValueError):
        return True
