"""Functions that start and end the process of a console's server."""

import contextlib
import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from trimtab.console.address import ConsoleAddress, open_listener
from trimtab.core.errors import InputError, argument_name
from trimtab.flight.console_line import ConsoleLine

END_S = 5.0


class Console(NamedTuple):
    """Running console. url: URL for pilots.  observer: URL for observers."""

    line: ConsoleLine
    url: str
    observer: str


@contextlib.contextmanager
def open_console(address: ConsoleAddress, describe: Callable[[ConsoleLine], Mapping[str, Any]]) -> Iterator[Console]:
    """Run a console during a flight.

    Args:
        address: network address on which the console listens.
        describe: function that makes the first message to the pages, see `hello.describe_flight`.
    """
    address.check()
    own, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    line = ConsoleLine(own)
    with contextlib.ExitStack() as stack:
        stack.callback(line.close)
        with other:
            listener = stack.enter_context(open_listener(address))
            orders = {"hello": describe(line), "line": other.fileno()}
            process, said = start_server("trimtab.console.server", address, listener, orders, (other.fileno(),))
        stack.callback(end_server, process)
        yield Console(line, said["url"], said["observer"])


def start_server(
    module: str,
    address: ConsoleAddress,
    listener: socket.socket,
    orders: Mapping[str, Any],
    pass_fds: tuple[int, ...] = (),
) -> tuple["subprocess.Popen[bytes]", Mapping[str, str]]:
    """Start the process of a server. Return the process, and the first line that it prints."""
    about = {"host": address.host, "listener": listener.fileno(), **address.files, **orders}
    process = subprocess.Popen(
        [sys.executable, "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        pass_fds=(listener.fileno(), *pass_fds),
        start_new_session=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(about).encode() + b"\n")
    process.stdin.flush()
    said = process.stdout.readline()
    if not said:
        end_server(process)
        raise InputError(
            argument_name("console"),
            "the server of the console did not start",
            fix="read the output of the server above",
        )
    return process, json.loads(said)


def end_server(process: "subprocess.Popen[bytes]") -> None:
    """End the process of a server. If the process does not end in time, kill it."""
    assert process.stdin is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
    try:
        process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
