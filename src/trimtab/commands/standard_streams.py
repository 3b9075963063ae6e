"""Standard output and error of the command line, and the signals that end a command.

A character that the terminal cannot show is replaced. Output that cannot be written, on a full disk for example, is one
line and exit code 1. SIGTERM and a lost terminal (SIGHUP) end a command as Ctrl-C does, so that it cleans up.
"""

import contextlib
import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator


class TerminatedError(KeyboardInterrupt):
    """A signal asked the program to end."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


def replace_unprintable() -> None:
    """Replace characters that the encoding of standard output or error lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


@contextlib.contextmanager
def end_on_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into TerminatedError, except where they are ignored or handled already."""

    def end(number: int, _: object) -> None:
        raise TerminatedError(number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    is_main = threading.current_thread() is threading.main_thread()
    ours = [number for number in numbers if is_main and signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def flush_output() -> bool:
    """Write what is left of the output. Return False, after a line on standard error, if that is impossible."""
    try:
        sys.stdout.flush()
    except OSError as error:
        report_failure(error)
        return False
    return True


def report_failure(error: OSError) -> None:
    """Report output that cannot be written, and stop writing to it. A reader that is gone needs no words."""
    if error.errno != errno.EPIPE:
        where = f" ({error.filename})" if error.filename else ""
        with contextlib.suppress(OSError):
            sys.stderr.write(f"error: cannot write{where}: {error.strerror or error}\n")
            sys.stderr.flush()
    with contextlib.suppress(OSError, ValueError):  # the interpreter would try to write it again at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
