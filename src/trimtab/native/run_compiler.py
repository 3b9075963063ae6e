"""Running a compiler so that it can do no harm: bounded in time, its files in a folder that goes, its end known."""

import errno
import os
from pathlib import Path
from typing import NamedTuple

NO_ROOM = (
    "No space left on device",
    "Disk quota exceeded",
    "Read-only file system",
    "File too large",
    "File size limit exceeded",
)
KILLED = ("Killed signal terminated", "Terminated signal terminated", "unable to execute command: Killed")
"""What gcc's and clang's drivers say, with an exit status of their own, when a program that they started was killed."""


class Outcome(NamedTuple):
    """How a run ended.

    Attributes:
        status: the exit status; negative, the signal that killed it; None, it had to be stopped.
        text: all that it said.
    """

    status: int | None
    text: str

    @property
    def interrupted(self) -> str:
        """How it was kept from judging the program, or nothing where it did judge."""
        if self.status is None:
            return self.text
        if self.status < 0:
            return f"it was killed by signal {-self.status}"
        killed = self.status and any(words in self.text for words in KILLED)
        return "a program that it started was killed" if killed else ""


def run_compiler(command: tuple[str, ...], work: Path, limit: float) -> Outcome:
    """Run a command in a work folder, where its own intermediate files go too; it ends after limit seconds.

    Raises OSError where the folder takes no more: another one may.
    """
    outcome = _run(command, work, limit)
    for words in NO_ROOM if outcome.status else ():
        if words in outcome.text:
            raise OSError(errno.ENOSPC, f"the compiler said '{words}'", str(work.parent))
    return outcome


def _run(command: tuple[str, ...], work: Path, limit: float) -> Outcome:
    import signal
    import subprocess

    surroundings = {**os.environ, "LC_ALL": "C", "TMPDIR": str(work)}
    try:
        started = subprocess.Popen(
            command,
            cwd=work,
            env=surroundings,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as reason:
        return Outcome(127, f"it could not be started: {reason}")
    try:
        said, _ = started.communicate(timeout=limit)
        return Outcome(started.returncode, said.decode("utf-8", "replace"))
    except subprocess.TimeoutExpired:
        return Outcome(None, f"it had no end after {limit:g} s")
    finally:
        if started.returncode is None:  # stopped with all that it started, also when this process is interrupted
            os.killpg(started.pid, signal.SIGKILL)
            started.wait()
        if started.stdout:
            started.stdout.close()
