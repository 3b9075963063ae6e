"""Waiting for a descriptor, to the microsecond: poll() counts in milliseconds, which is a whole control period."""

import select

SELECTABLE = 1024
"""Descriptors from here on are beyond what select() can take."""


def ready(fd: int, mask: int, timeout: float) -> bool:
    """Whether something happens to a descriptor within `timeout` seconds; an error is something.

    Args:
        fd: the descriptor.
        mask: select.POLLIN, select.POLLOUT, or both.
        timeout: seconds, not negative.
    """
    try:
        if fd < SELECTABLE:
            reads, writes = [fd] if mask & select.POLLIN else [], [fd] if mask & select.POLLOUT else []
            return any(select.select(reads, writes, [], timeout))
        poll = select.poll()
        poll.register(fd, mask)
        return bool(poll.poll(timeout * 1e3))
    except (OSError, ValueError):
        return True
