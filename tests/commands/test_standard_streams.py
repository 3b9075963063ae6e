"""Output that a terminal cannot show, a full disk, a reader that is gone, and signals that end a command."""

import os
import signal
import subprocess
import sys

import pytest

TRIMTAB = [sys.executable, "-m", "trimtab"]
WAITS = """
import sys, time, click
from trimtab.cli import main
@click.command()
def command():
    print("begun", flush=True)
    time.sleep(60)
main.commands["wait"] = command
main.get_command = lambda ctx, name: command
main(["wait"])
"""


@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_characters_that_the_terminal_lacks_are_replaced(encoding):
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run([*TRIMTAB, "list", "hovercraft/spin"], env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("verb", [["list"], ["list", "--json"], ["--help"]])
def test_a_full_disk_is_one_line_and_exit_code_1(verb):
    with open("/dev/full", "w") as full:
        done = subprocess.run([*TRIMTAB, *verb], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "error: cannot write: No space left on device\n"


def test_a_reader_that_is_gone_needs_no_words():
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as gone:
        done = subprocess.run([*TRIMTAB, "list"], stdout=gone, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("number", "code", "said"), [(signal.SIGTERM, 143, "stopped by SIGTERM"), (signal.SIGHUP, 129, "stopped by SIGHUP")]
)
def test_a_signal_ends_a_command_in_order(number, code, said):
    unignored = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # this test may run under nohup
    command = [sys.executable, "-c", unignored + WAITS]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    process.send_signal(number)
    _, text = process.communicate()
    assert (process.returncode, text.strip()) == (code, said)


def test_a_lost_terminal_is_ignored_under_nohup():
    process = subprocess.Popen(["nohup", sys.executable, "-c", WAITS], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == b"begun\n"
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)
    process.send_signal(signal.SIGTERM)
    assert process.wait() == 143
    process.stdout.close()
    process.stderr.close()
