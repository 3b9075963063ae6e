"""Standard output and standard error of the command line.

A character that the terminal cannot show is replaced. If output cannot be written, for example on a full disk, the
command prints a one-line error and ends with exit code 1.
"""

import contextlib
import errno
import io
import os
import sys


def replace_unprintable() -> None:
    """Make standard output and standard error replace characters that their encoding lacks."""
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
    """Report that output cannot be written, and stop writing output. A closed pipe is not reported."""
    if error.errno != errno.EPIPE:
        where = f" ({error.filename})" if error.filename else ""
        with contextlib.suppress(OSError):
            sys.stderr.write(f"error: cannot write{where}: {error.strerror or error}\n")
            sys.stderr.flush()
    with contextlib.suppress(OSError, ValueError):  # otherwise the interpreter would write again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
