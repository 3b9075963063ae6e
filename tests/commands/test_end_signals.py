"""Signals that end a command: exit code and message, also where Python drops the exception or native code runs."""

import signal
import subprocess
import sys

import pytest

BEGIN = """
import signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # this test may run under nohup
signal.signal(signal.SIGINT, signal.default_int_handler)  # and in the background, where a shell has it ignored
"""
WAITS = """
import hashlib, os, time, click
from trimtab.cli import main

class Dropping:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass

def drop():
    Dropping()
    time.sleep(600)

def compute():
    hashlib.pbkdf2_hmac("sha256", b"a", b"b", 2**31 - 1)

@click.command()
def command():
    print("begun", flush=True)
    DOES()

sys.argv[1:] = ["wait"]
main.commands["wait"] = command
main.get_command = lambda ctx, name: command
main()
"""


def start_command(does, begin=BEGIN, before=()):
    script = (begin or "import signal, sys\n") + WAITS.replace("DOES()", does)
    command = [*before, sys.executable, "-c", script]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [
        (signal.SIGINT, 130, "stopped by Ctrl-C"),
        (signal.SIGTERM, 143, "stopped by SIGTERM"),
        (signal.SIGHUP, 129, "stopped by SIGHUP"),
    ],
)
def test_signal_ends_command_with_exit_code_and_message(number, code, said):
    process = start_command("time.sleep(600)")
    process.send_signal(number)
    _, text = process.communicate()
    assert (process.returncode, text.strip()) == (code, said)


def test_interrupt_dropped_by_python_is_repeated():
    _, text = (process := start_command("drop()")).communicate()
    assert (process.returncode, text.strip()) == (130, "stopped by Ctrl-C")


@pytest.mark.parametrize(("number", "code", "said"), [(signal.SIGINT, 130, "Ctrl-C"), (signal.SIGTERM, 143, "SIGTERM")])
def test_signal_ends_running_native_code(number, code, said):
    process = start_command("compute()")
    process.send_signal(number)
    _, text = process.communicate()
    assert (process.returncode, text.strip()) == (code, f"stopped by {said}")


def test_busy_second_thread_does_not_delay_exit():
    does = "import threading; threading.Thread(target=compute).start(); time.sleep(600)"
    process = start_command(does)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate()
    assert (process.returncode, text.strip()) == (130, "stopped by Ctrl-C")


def test_hangup_is_ignored_under_nohup():
    process = start_command("time.sleep(600)", begin="", before=("nohup",))
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)
    process.send_signal(signal.SIGTERM)
    assert process.wait() == 143
    process.stdout.close()
    process.stderr.close()
