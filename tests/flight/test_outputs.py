"""The outputs' process: safe outputs after the vehicle's process is killed or stopped."""

import contextlib
import os
import resource
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path
from time import monotonic_ns

import pytest
from flight.pair import Program, make_key
from flight.transports.ends import free_port

from trimtab.flight.output_port import DRIVEN, LATCHED, SAFE, STALE, OutputReader, OutputRow
from trimtab.flight.outputs import END, FROZEN, HEAD, TRIPPED, Outputs, OutputsOrders, OutputsProcess
from trimtab.flight.outputs_process import OutputsLoop
from trimtab.flight.watchdog import Watchdog

MS = 1_000_000
BUSY_BOUND = 2_000 * MS
"""What a test demands on a busy machine; for what is promised on a quiet one: benchmarks/watchdog.py."""
FEEDER = """
import sys, time
from pathlib import Path
from trimtab.flight.outputs import FROZEN, Outputs
outputs = Outputs([0.0, 1.5], timeout=50_000_000, lift_delay=300_000_000, latch=250_000_000, folder=Path(sys.argv[1]))
print("fed", flush=True)
while outputs.is_alive:
    outputs.hand_over(True, True, [0.95, 1.7])
    time.sleep(0.001)
"""


@pytest.fixture
def feeder(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", FEEDER, str(tmp_path)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"fed\n"
    port = OutputReader(tmp_path / "outputs.bin")
    await_row(port, lambda row: row.state == DRIVEN)
    yield process, port, tmp_path / "outputs.txt"
    process.kill()
    process.wait()
    process.stdout.close()


def await_row(port, holds):
    end = monotonic_ns() + 20_000 * MS
    while not holds(port.read()[1]):
        assert monotonic_ns() < end, port.read()
        time.sleep(0.002)
    return port.read()


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("number", "cause"), [(signal.SIGKILL, "process is gone"), (signal.SIGSTOP, "process is stopped")]
)
def test_outputs_go_safe_when_the_vehicle_is_killed_or_stopped(feeder, number, cause):
    process, port, log = feeder
    assert port.read()[1] == OutputRow(DRIVEN, True, (0.95, 1.7))
    began = monotonic_ns()
    os.kill(process.pid, number)
    at, row = await_row(port, lambda row: row.state != DRIVEN)
    assert row.values == (0.0, 1.5)
    assert at - began < BUSY_BOUND
    later, row = await_row(port, lambda row: not row.lift)
    assert later - began >= 300 * MS
    await_row(port, lambda row: row.state == LATCHED)
    assert cause in log.read_text()


@pytest.mark.real_time
def test_outputs_go_safe_even_if_their_log_fails(feeder):
    process, port, log = feeder
    outputs = int(Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()[0])
    resource.prlimit(outputs, resource.RLIMIT_FSIZE, (0, 0))  # each write to a file fails, as on a full disk
    process.kill()
    await_row(port, lambda row: row.state != DRIVEN)
    _, row = await_row(port, lambda row: not row.lift)
    assert row.values == (0.0, 1.5)
    assert log.read_text() == ""


@pytest.mark.real_time
def test_outputs_of_a_resumed_vehicle_stay_latched_until_disarmed(feeder):
    process, port, log = feeder
    os.kill(process.pid, signal.SIGSTOP)
    await_row(port, lambda row: row.state == LATCHED)
    os.kill(process.pid, signal.SIGCONT)
    time.sleep(0.2)
    assert port.read()[1].values == (0.0, 1.5)
    assert "latched until the vehicle is disarmed" in log.read_text()


def test_watchdog_recovers_from_short_silence_and_latches_long_one():
    watchdog = Watchdog([0.0], timeout=50, lift_delay=1000, latch=250)
    watchdog.take_row(0, True, True, (9.0,))
    assert not watchdog.check(49)
    assert watchdog.next_check() == 50
    assert watchdog.check(50)
    assert watchdog.row == OutputRow(SAFE, True, (0.0,))
    watchdog.take_row(100, True, True, (9.0,))
    assert watchdog.row == OutputRow(DRIVEN, True, (9.0,))
    assert watchdog.check(150)
    watchdog.take_row(351, True, True, (9.0,))
    assert watchdog.row == OutputRow(LATCHED, True, (0.0,))
    assert not watchdog.check(1150)
    assert watchdog.row == OutputRow(LATCHED, False, (0.0,))
    watchdog.take_row(1200, False, False, (0.0,))
    watchdog.take_row(1201, True, True, (8.0,))
    assert watchdog.row == OutputRow(DRIVEN, True, (8.0,))


class FullLine:
    """Full socket from the outputs' process to a vehicle that was stopped for long."""

    def __init__(self, rows):
        self.rows, self.has_room, self.sent = list(rows), True, []

    def recv(self, size):
        if not self.rows:
            raise BlockingIOError
        return self.rows.pop(0)

    def send(self, data):
        if not self.has_room:
            raise BlockingIOError
        self.sent.append(data)


class StandingClock:
    def __init__(self):
        self.now = 0

    def monotonic_ns(self):
        return self.now

    def unix(self):
        return 0.0


class ResetLine(FullLine):
    """Socket whose other end closed with unread packets: the system reports one reset, then the last packets."""

    def recv(self, size):
        if self.rows and self.rows[0] == "reset":
            self.rows.pop(0)
            raise ConnectionResetError
        return super().recv(size) if self.rows else b""


def row_packet(stamp, value):
    return HEAD.pack(stamp, True, False) + struct.pack("<d", value)


def test_silence_report_waits_until_the_link_has_room():
    line, clock = FullLine([row_packet(0, 1.0)]), StandingClock()
    orders = OutputsOrders((0.0,), 50 * MS, 0, 250 * MS, None, False, 1)
    loop = OutputsLoop(line, orders, clock)
    loop.step()
    clock.now, line.has_room = 400 * MS, False
    loop.step()
    line.rows.append(row_packet(400 * MS, 1.0))
    loop.step()
    assert not [p for p in line.sent if p.startswith(TRIPPED)]
    clock.now, line.has_room = 401 * MS, True
    loop.step()
    loop.step()
    assert [p for p in line.sent if p.startswith(TRIPPED)] == [TRIPPED + b"400000000"]


@pytest.mark.parametrize(("last", "cause"), [([END], "the vehicle has ended"), ([], "the vehicle's process is gone")])
def test_connection_reset_still_reports_the_cause_of_end(last, cause):
    line, clock, told = ResetLine([row_packet(0, 1.0), "reset", *last]), StandingClock(), []
    orders = OutputsOrders((0.0,), 50 * MS, 0, 250 * MS, None, False, 1)
    OutputsLoop(line, orders, clock, tells=[told.append]).serve()
    assert told[-1].endswith(f"at rest; {cause}")


def test_machine_pause_is_not_a_frozen_outputs_process():
    """After a pause of both processes the vehicle checks first. The outputs' process has had no time to answer."""
    line, clock = FullLine([]), StandingClock()
    process = OutputsProcess(line, 1, lambda: None)
    outputs = Outputs([0.0], timeout=50 * MS, lift_delay=0, latch=250 * MS, clock=clock, start=lambda orders: process)
    outputs.hand_over(True, False, [1.0])
    clock.now = 500 * MS
    outputs.hand_over(True, False, [1.0])
    assert outputs.is_alive
    for clock.now in range(510 * MS, 590 * MS, 10 * MS):
        outputs.hand_over(True, False, [1.0])
        assert outputs.is_alive
    clock.now = 600 * MS
    outputs.hand_over(True, False, [1.0])
    assert outputs.problem == "the outputs' process is frozen"


@pytest.mark.real_time
def test_vehicle_learns_of_latched_silence_and_dead_outputs():
    outputs = Outputs([0.0], timeout=30 * MS, lift_delay=0, latch=60 * MS)
    try:
        outputs.hand_over(True, False, [1.0])
        time.sleep(0.2)
        silences = []
        end = monotonic_ns() + 20_000 * MS
        while not any(silences) and monotonic_ns() < end:
            silences.append(outputs.hand_over(True, False, [1.0]))
            time.sleep(0.006)
        assert max(silences) >= 150 * MS
        os.kill(outputs.process.pid, signal.SIGKILL)
        time.sleep(0.01)
        outputs.hand_over(True, False, [0.0])
        assert not outputs.is_alive
    finally:
        outputs.close()


@pytest.mark.real_time
def test_frozen_outputs_process_is_detected_and_driver_goes_safe(tmp_path):
    outputs = Outputs([0.0], timeout=50 * MS, lift_delay=100 * MS, latch=250 * MS, folder=tmp_path)
    try:
        port = OutputReader(tmp_path / "outputs.bin")
        while port.read()[1].state != DRIVEN:
            outputs.hand_over(True, True, [0.7])
            time.sleep(0.005)
        os.kill(outputs.process.pid, signal.SIGSTOP)
        began = monotonic_ns()
        while outputs.is_alive:
            outputs.hand_over(True, True, [0.7])
            assert monotonic_ns() - began < BUSY_BOUND
            time.sleep(0.005)
        assert outputs.problem == FROZEN
        assert port.row_to_apply(monotonic_ns()) == OutputRow(STALE, True, (0.0,))
        time.sleep(0.2)
        assert port.row_to_apply(monotonic_ns()) == OutputRow(STALE, False, (0.0,))
        assert port.read()[1] == OutputRow(DRIVEN, True, (0.7,))
    finally:
        os.kill(outputs.process.pid, signal.SIGCONT)
        outputs.close()
    assert not (tmp_path / "outputs.bin").exists()


@pytest.mark.real_time
def test_blocked_terminal_does_not_delay_the_outputs(tmp_path):
    """Standard error is a full pipe without a reader. The outputs still go safe, stop the lift and end."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(writer, b"x" * 65536):
            pass
    os.set_blocking(writer, True)
    process = subprocess.Popen([sys.executable, "-c", FEEDER, str(tmp_path)], stdout=subprocess.PIPE, stderr=writer)
    try:
        assert process.stdout.readline() == b"fed\n"
        port = OutputReader(tmp_path / "outputs.bin")
        await_row(port, lambda row: row.state == DRIVEN and row.lift)
        process.kill()
        await_row(port, lambda row: row.state != DRIVEN)
        await_row(port, lambda row: not row.lift)
        end = monotonic_ns() + 20_000 * MS
        while (tmp_path / "outputs.bin").is_symlink():
            assert monotonic_ns() < end, "the outputs' process did not end"
            time.sleep(0.01)
        assert "at rest" in (tmp_path / "outputs.txt").read_text()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        os.close(reader)
        os.close(writer)


@pytest.mark.real_time
def test_outputs_go_safe_and_log_why_after_vehicle_is_killed(tmp_path):
    make_key(tmp_path)
    scenario, out = "hovercraft/zero-velocity", tmp_path / "there"
    words = ("vehicle", scenario, "--listen", "udp://127.0.0.1:14671", "--out", str(out), "--json")
    there = Program(*words, folder=tmp_path)
    rest, here = ("--duration", "3 s", "--json"), None
    try:
        there.wait_for("listens on")
        here = Program("fly", scenario, "--link", "udp://127.0.0.1:14671", *rest, folder=tmp_path)
        there.wait_for("computer: arm request", "ended")
        port = OutputReader(out / "outputs.bin")
        await_row(port, lambda row: row.state == DRIVEN and row.lift)
        there.process.kill()
        await_row(port, lambda row: row.state != DRIVEN and not row.lift)
        assert "the vehicle's process is gone" in (out / "outputs.txt").read_text()
        ended = here.finished()
        assert ended.status == 1
        assert "no data from the vehicle at the end" in ended.result["problems"]
    finally:
        for program in (there, here):
            if program is not None:
                program.process.kill()
                program.process.communicate()


@pytest.mark.real_time
def test_normal_vehicle_end_is_not_reported_as_hang(tmp_path):
    make_key(tmp_path)
    out = tmp_path / "there"
    words = ("--listen", f"udp://127.0.0.1:{free_port()}", "--out", str(out), "--json")
    there = Program("vehicle", "hovercraft/zero-velocity", *words, folder=tmp_path)
    try:
        there.wait_for("listens on")
        end = time.monotonic() + 60
        while not (out / "outputs.bin").exists():
            assert time.monotonic() < end
            time.sleep(0.05)
        await_row(OutputReader(out / "outputs.bin"), lambda row: row.state == DRIVEN)
        there.process.send_signal(signal.SIGTERM)
        assert there.finished().status == 0
    finally:
        there.process.kill()
        there.process.communicate()
    said = (out / "outputs.txt").read_text()
    assert "the vehicle has ended" in said
    assert "hangs" not in said
