"""Standard output and error of the command line.

A character that the terminal cannot show is replaced. If output cannot be written, for example on a full disk, the
command prints one line and ends with exit code 1.
"""

import contextlib
import errno
import io
import os
import sys


def replace_unprintable() -> None:
    """Replace characters that the encoding of standard output or standard error does not have."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def flush_output() -> bool:
    """Write the buffered standard output. If this fails, report the error on standard error and return False."""
    try:
        sys.stdout.flush()
    except OSError as error:
        report_failure(error)
        return False
    return True


def report_failure(error: OSError) -> None:
    """Report that output cannot be written, and stop writing to it. A closed pipe is not reported."""
    if error.errno != errno.EPIPE:
        where = f" ({error.filename})" if error.filename else ""
        with contextlib.suppress(OSError):
            sys.stderr.write(f"error: cannot write{where}: {error.strerror or error}\n")
            sys.stderr.flush()
    with contextlib.suppress(OSError, ValueError):  # otherwise the interpreter would write again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
