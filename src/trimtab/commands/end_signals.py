"""Signals that end a command: Ctrl-C (SIGINT), SIGTERM and a lost terminal (SIGHUP). Exit code: 128 + signal number.

The handler raises an exception in the main thread. Two things can stop that exception. Python drops an exception in a
garbage-collection callback, and JAX has such a callback. Native code, such as a compiler, delays the handler. A thread
therefore watches each signal. The thread repeats a dropped signal, and ends the program if the handler does not run
in time.
"""

import contextlib
import os
import signal
import sys
import threading
import time
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from typing import Any

RETRY_PERIOD_S = 0.02
"""Time (s) after which a signal is repeated if Python dropped the exception that the signal raised."""
PATIENCE_S = 0.7
"""Longest time (s) for which native code may delay the signal handler. After this time the program is ended."""


class TerminatedError(KeyboardInterrupt):
    """Exception raised by a signal other than Ctrl-C to end the program."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


class EndSignals:
    """Handler of the signals that end a command, with a thread that watches these signals.

    asked: number of the last signal received, or 0.  raised: True after the handler has raised the exception, unless
    Python dropped it.
    """

    def __init__(self, end_program: Callable[[int], None]) -> None:
        self.asked = 0
        self.raised = False
        self._end_program = end_program
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._previous_hook = sys.unraisablehook
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def handle(self, number: int, _: object) -> None:
        """Raise KeyboardInterrupt for Ctrl-C, or TerminatedError for any other signal."""
        self.asked, self.raised = number, True
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise TerminatedError(number)

    def note_dropped(self, unraisable: Any) -> None:
        """Make the thread repeat a signal whose exception Python dropped; report other dropped exceptions as usual."""
        if self.asked and issubclass(unraisable.exc_type, KeyboardInterrupt):
            self.raised = False
            os.write(self._writer, bytes((self.asked,)))
        else:
            self._previous_hook(unraisable)

    def _watch(self) -> None:
        while number := os.read(self._reader, 1)[0]:
            since = time.monotonic()
            while signal.getsignal(number) == self.handle and not self.raised:
                time.sleep(RETRY_PERIOD_S)
                if not self.raised and time.monotonic() - since > PATIENCE_S:
                    self._end_program(number)
                    return
                if self.asked and not self.raised:
                    interrupt_main(signal.Signals(number))
        os.close(self._reader)

    @contextlib.contextmanager
    def watch(self, numbers: list[int]) -> Iterator[None]:
        """Handle the signals with these numbers until the block ends."""
        before = {number: signal.signal(number, self.handle) for number in numbers}
        wakeup = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        sys.unraisablehook = self.note_dropped
        self._thread.start()
        try:
            yield
        finally:
            sys.unraisablehook = self._previous_hook
            signal.set_wakeup_fd(wakeup)
            for number, handler in before.items():
                signal.signal(number, handler)
            os.write(self._writer, b"\0")
            os.close(self._writer)


@contextlib.contextmanager
def end_on_signals(is_program: bool = False) -> Iterator[None]:
    """End the command on Ctrl-C, SIGTERM and SIGHUP, except for signals that are ignored or have another handler.

    is_program: True if the process runs only this command. The process is then ended without waiting for other threads.
    """
    handlers = {"SIGINT": signal.default_int_handler, "SIGTERM": signal.SIG_DFL, "SIGHUP": signal.SIG_DFL}
    usual = {getattr(signal, name): handler for name, handler in handlers.items() if hasattr(signal, name)}
    is_main = threading.current_thread() is threading.main_thread()
    numbers = [number for number, handler in usual.items() if is_main and signal.getsignal(number) == handler]
    if not numbers:
        yield
        return
    signals = EndSignals(_end_program if is_program else lambda number: None)
    try:
        with signals.watch(numbers):
            yield
    except SystemExit as end:
        if is_program and signals.asked and end.code == 128 + signals.asked:
            _leave(128 + signals.asked)
        raise


def name_signal(number: int) -> str:
    """Return the name of a signal for messages."""
    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name


def _end_program(number: int) -> None:
    """End the program while native code runs. First print the message that the command would have printed."""
    with contextlib.suppress(OSError):
        os.write(2, f"stopped by {name_signal(number)}\n".encode())
    os._exit(128 + number)


def _leave(code: int) -> None:
    """End the process immediately, without waiting for other threads, which may compile for seconds."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
