"""Program of `trimtab …` in virtual time: the same command, with separate output."""

import contextlib
import io
import json
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from studies.live_faults.process import NotReady
from trimtab.cli import main
from trimtab.flight.machine import Machine
from trimtab.flight.virtual_machine import VirtualMachine
from trimtab.flight.virtual_terminal import VirtualTerminal
from trimtab.flight.virtual_time import KilledError, VirtualProgram, VirtualTime
from trimtab.logs.log import Log

LOOK_S = 0.02
START_S, END_S = 240.0, 120.0
"""Longest virtual time until a program is ready, and until it ends after a request (s)."""
REFUSED, CRASHED = 2, 1
OUTPUTS, WRITER = "outputs", "writer"
"""Words in the command lines of a program's child processes."""
_STREAMS = threading.local()
Pause = Callable[[float], None]


class _OwnStream(io.TextIOBase):
    """Standard output or error, separate for each thread of virtual time, the usual one for other threads."""

    encoding, errors = "utf-8", "replace"

    def __init__(self, name: str, usual: Any) -> None:
        self._name, self._usual = name, usual

    def write(self, text: str, /) -> int:
        return getattr(_STREAMS, self._name, self._usual).write(text)

    def flush(self) -> None:
        getattr(_STREAMS, self._name, self._usual).flush()

    def fileno(self) -> int:
        return self._usual.fileno()


class _TerminalStream(NamedTuple):
    """Standard error of a program. Writing waits while the terminal hangs."""

    text: io.StringIO
    terminal: VirtualTerminal

    def write(self, text: str) -> int:
        self.terminal.wait_for_room()
        return self.text.write(text)

    def flush(self) -> None:
        self.text.flush()


@contextlib.contextmanager
def own_streams() -> Iterator[None]:
    """Give each program of virtual time its own standard output and error, within this context."""
    usual = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _OwnStream("out", usual[0]), _OwnStream("said", usual[1])
    try:
        yield
    finally:
        sys.stdout, sys.stderr = usual


class VirtualProcess:
    """Program that runs a command of trimtab. It has the methods of `process.Process`."""

    def __init__(self, *words: str, name: str, machine: VirtualMachine, pause: Pause) -> None:
        """Start the program.

        Args:
            words: words of the command line.
            name: name of the process.
            machine: the computer of the program.
            pause: function that lets virtual time pass for the caller.
        """
        self.name, self.machine, self._pause = name, machine, pause
        self._said, self._out = io.StringIO(), io.StringIO()
        self._signal = 0
        machine.tell = machine.terminal.open_queue(lambda line: self._said.write(f"{line}\n")).put
        self._program = machine.start(lambda own: self._run([*words, "--json"], own), [*words, "--json"])
        self.disk = machine.disk
        """Disk of this program. A program that starts later on the same machine has another disk."""

    def _run(self, words: list[str], machine: Machine) -> int:
        _STREAMS.out, _STREAMS.said = self._out, _TerminalStream(self._said, self.machine.terminal)
        try:
            main.main(words, prog_name="trimtab", obj=machine)
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else CRASHED
        except KilledError:
            raise
        except BaseException:
            self._said.write(traceback.format_exc())
            return CRASHED
        return 0

    @property
    def status(self) -> int | None:
        """Exit status, or None while the process runs."""
        if self._program.is_killed:
            return -self._signal
        return self._program.result if self._program.has_ended else None

    @property
    def output_text(self) -> str:
        """Output for the user so far."""
        return self._said.getvalue()

    @property
    def result(self) -> dict[str, Any] | None:
        """JSON result that the program prints at its end, else None."""
        lines = self._out.getvalue().strip().splitlines()
        with contextlib.suppress(ValueError, IndexError):
            return json.loads(lines[-1])
        return None

    def wait_for(self, text: str, count: int = 1, patience: float = START_S) -> None:
        """Wait until the program has printed a text. Raise NotReady if it ends or stays silent."""
        time = self.machine.time
        given_up = time.seconds + patience
        while self.output_text.count(text) < count:
            if self.status is not None or time.seconds > given_up:
                raise NotReady(f"{self.name} did not print {text!r}: {self.output_text.strip()[-300:]}", False)
            self._pause(LOOK_S)

    def send(self, number: int) -> None:
        """Send a signal to the process."""
        if self._program.has_ended:
            return
        if number in (signal.SIGINT, signal.SIGTERM):
            self.machine.interrupt()
        elif number == signal.SIGKILL:
            self._signal = number
            self.machine.kill()
        else:
            self._signal_program(self._program, number)

    def send_child(self, word: str, number: int) -> None:
        """Send a signal to its child processes whose command line contains a word."""
        if OUTPUTS in word:
            self._signal_program(self.machine.outputs[-1], number)
        elif WRITER in word:
            self.disk.is_writer_dead = True

    def _signal_program(self, program: VirtualProgram, number: int) -> None:
        act = {signal.SIGSTOP: VirtualTime.freeze, signal.SIGCONT: VirtualTime.thaw, signal.SIGKILL: VirtualTime.kill}
        act[signal.Signals(number)](self.machine.time, program)

    def finish(self, patience: float = END_S) -> None:
        """Wait for the end. Raise NotReady and kill the program if it does not end."""
        time = self.machine.time
        given_up = time.seconds + patience
        while self.status is None:
            if time.seconds > given_up:
                self.kill()
                raise NotReady(f"{self.name} did not end: {self.output_text.strip()[-300:]}", False)
            self._pause(LOOK_S)

    def kill(self) -> None:
        """Kill the program."""
        self.send(signal.SIGKILL)

    def read_log(self) -> Log:
        """Return the log of the program. Raise FileNotFoundError if it has none."""
        if not self.disk.logs:
            raise FileNotFoundError(f"{self.name} has no log")
        return self.disk.logs[-1].read()
