"""Output to a terminal without the characters, to a full disk, and to a closed pipe."""

import os
import subprocess
import sys

import pytest

TRIMTAB = [sys.executable, "-m", "trimtab"]


@pytest.mark.thorough("latin-1")
@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_characters_missing_in_terminal_encoding_are_replaced(encoding):
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run([*TRIMTAB, "list", "hovercraft/spin"], env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("verb", [["list"], ["list", "--json"], ["--help"]])
def test_full_disk_prints_one_line_and_exits_with_1(verb):
    with open("/dev/full", "w") as full:
        done = subprocess.run([*TRIMTAB, *verb], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "error: cannot write: No space left on device\n"


def test_closed_pipe_exits_with_1_without_message():
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as gone:
        done = subprocess.run([*TRIMTAB, "list"], stdout=gone, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (1, "")
