"""The STM32F405's drivers on a model of its registers: clocks, DMA, flash, watchdog, captures, SPI.

The emulator has none of these, or not all of them. At the end the whole program that flies runs on the same model."""

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest
from firmware.chip import Chip

FIRMWARE = Path(__file__).parents[2] / "firmware"
BOARD = FIRMWARE / "boards" / "stm32f405"
DRIVERS = ["board", "bus_device", "clock", "encoder", "flash", "i2c", "program", "receiver", "servo", "spi", "storage"]
DRIVERS += ["time", "usart", "watchdog"]
MS = 10_000


class IcmSample(ctypes.Structure):
    _fields_ = (
        ("force", ctypes.c_float * 3),
        ("rate", ctypes.c_float * 3),
        ("temperature", ctypes.c_float),
        ("saturated", ctypes.c_bool * 2),
    )


def compile_drivers(output, sources, folders, *flags):
    """A library of this computer out of a board's sources, all registers behind two functions."""
    flags = ["-std=gnu99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-DREGISTER_MODEL", *flags]
    flags += ["-DHSE_HZ=8000000", "-DBAUD=921600", "-DBOX_SIZE=0x20000", "-DAPB1_TIMER_HZ=84000000"]
    flags += ["-Wno-pointer-to-int-cast", "-ffp-contract=off", "-fwrapv", *(f"-I{folder}" for folder in folders)]
    sources = [*sources, Path(__file__).parent / "model.c"]
    done = subprocess.run(["cc", *flags, *map(str, sources), "-lm", "-o", str(output)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return output


@pytest.fixture(scope="session")
def drivers(tmp_path_factory):
    sources = [BOARD / f"{name}.c" for name in DRIVERS]
    sources += [FIRMWARE / "drivers" / "icm42688.c", FIRMWARE / "portable" / "journal.c"]
    folders = [FIRMWARE / part for part in ("portable", "drives/fan", "drivers", "boards/stm32f405")]
    return compile_drivers(tmp_path_factory.mktemp("stm32") / "drivers.so", sources, folders)


@pytest.fixture
def library(drivers, tmp_path):
    """A library of its own for each test: its static variables are those of a board that has just started."""
    copy = tmp_path / "drivers.so"
    copy.write_bytes(drivers.read_bytes())
    library = ctypes.CDLL(str(copy))
    library.board_now.restype = ctypes.c_int64
    library.board_recall.restype = ctypes.c_uint64
    library.usart_write.restype = library.usart_read.restype = ctypes.c_bool
    library.receiver_read.restype = library.clock_begin.restype = ctypes.c_bool
    library.icm_work.restype = library.icm_good.restype = ctypes.c_bool
    library.encoder_count.restype = ctypes.c_uint16
    library.board_refusal.restype = library.board_cause.restype = library.reset_cause.restype = ctypes.c_char_p
    return library


@pytest.fixture
def chip(library):
    chip = Chip(library)
    yield chip
    chip.check()


@pytest.mark.parametrize("crystal", [True, False])
def test_clocks_run_at_168_mhz_with_or_without_crystal(library, crystal):
    chip = Chip(library, crystal=crystal)
    assert library.clock_begin() == crystal
    assert chip.frequencies() == (168e6, 42e6, 84e6)
    assert bool(chip.plain[0x40023804] & 1 << 22) == crystal
    assert bool(chip.plain[0x40023800] & 1 << 19) == crystal  # clock security: only for a crystal
    chip.check()


def test_board_without_crystal_cannot_be_armed(library):
    chip = Chip(library, crystal=False)
    library.board_begin(library.clock_begin())
    assert library.board_refusal() == b"no crystal"
    chip.check()


def test_board_can_be_armed_after_clean_start(library, chip):
    library.board_begin(library.clock_begin())
    assert library.board_refusal() is None
    assert chip.pulses() == (pytest.approx(50.0), pytest.approx([1.5e-3, 1.5e-3, 1.0e-3]))
    assert chip.watchdog["on"]
    assert chip.plain[0x40011008] == pytest.approx(84e6 / 921600, rel=0.005)  # receivers take 2 %
    assert not chip.watchdog["reset"]  # whatever was erased


def test_servo_pins_are_outputs_only_while_pulses_are_valid(library, chip):
    library.servo_begin()
    last = {address: k for k, (address, _) in enumerate(chip.order)}
    assert last[0x40020800] == max(last.values())
    for channel, counts in enumerate((3600, 4000, 2000)):
        library.servo_set(channel, counts)
    library.servo_set(3, 1)
    assert chip.pulses()[1] == pytest.approx([1.8e-3, 2.0e-3, 1.0e-3])
    library.servo_silence()
    assert chip.pulses()[1] == [None, None, None]
    assert chip.plain[0x4002080C] >> 12 & 0x3F == 0b101010  # pulled to ground


@pytest.mark.parametrize("slow_clock", [17_000.0, 32_000.0, 47_000.0])
def test_watchdog_resets_between_34_and_100_ms_after_last_kick(library, slow_clock):
    chip = Chip(library, slow_clock=slow_clock)
    library.watchdog_begin()
    for _ in range(300):  # 10 ms late is late enough for any tick
        chip.pass_time(0.010)
        library.board_kick()
    assert not chip.watchdog["reset"]
    chip.pass_time(0.034)
    assert not chip.watchdog["reset"]
    chip.pass_time(0.066 - 0.005)
    assert chip.watchdog["reset"]
    chip.check()


def test_earlier_flash_error_does_not_affect_next_write(library, chip):
    library.watchdog_begin()
    chip.plain[0x40023C0C] = 0xF2  # as after a write that a reset cut short
    assert library.flash_program(0x08008000, 0x12345678)
    chip.plain[0x40023C0C] = 0xF2
    assert library.flash_erase(0x08008000)
    assert library.flash_word(0x08008000) & 0xFFFFFFFF == 0xFFFFFFFF


@pytest.mark.parametrize("slow_clock", [17_000.0, 47_000.0])
def test_flash_erase_does_not_trigger_watchdog_or_extend_it(library, slow_clock):
    chip = Chip(library, slow_clock=slow_clock)
    library.watchdog_begin()
    assert library.flash_erase(0x080C0000)
    assert chip.now == pytest.approx(2.0)
    assert not chip.watchdog["reset"]
    chip.pass_time(0.1)
    assert chip.watchdog["reset"]
    chip.check()


@pytest.mark.parametrize(
    ("flags", "cause"),
    [(0x0E, b"power on"), (0x24, b"watchdog"), (0x06, b"brown-out"), (0x14, b"fault"), (0x04, b"reset pin")],
)
def test_reset_cause_is_read_and_cleared(library, chip, flags, cause):
    chip.plain[0x40023874] = flags << 24
    assert library.reset_cause() == cause
    assert chip.plain[0x40023874] == 0  # else the next one is not told from it


def test_brown_out_level_is_set_once_without_changing_other_options(library, chip):
    before = chip.plain[0x40023C14]
    library.brown_out_begin()
    assert chip.plain[0x40023C14] == before & ~0xC
    writes = len(chip.order)
    library.brown_out_begin()
    assert len(chip.order) == writes


def take(library):
    byte, taken = ctypes.c_uint8(), bytearray()
    while library.usart_read(ctypes.byref(byte)):
        taken.append(byte.value)
    return bytes(taken)


def test_dma_reception_keeps_bytes_complete_and_in_order(library, chip):
    library.usart_begin()
    rng = np.random.default_rng(1)
    sent = taken = b""
    for _ in range(40):
        piece = rng.bytes(int(rng.integers(1, 4000)))
        chip.receive(piece)
        assert library.usart_waiting()
        sent += piece
        if rng.random() < 0.5:
            library.usart_lapped()  # the interrupt may come before the reader or after it
        taken += take(library)
    assert taken == sent
    assert library.usart_lost() == 0


def test_late_reader_loses_oldest_bytes_and_counts_them(library, chip):
    library.usart_begin()
    data = bytes(np.random.default_rng(2).integers(0, 256, 6000, dtype=np.uint8))
    chip.receive(data[:3000])
    library.usart_lapped()
    chip.receive(data[3000:])
    library.usart_lapped()
    taken = take(library)
    assert data.endswith(taken)
    assert len(taken) + library.usart_lost() == len(data)
    assert len(taken) >= 2048


def test_dma_transmission_sends_messages_whole_and_in_order(library, chip):
    library.usart_begin()
    rng = np.random.default_rng(3)
    accepted, refusals = b"", 0
    for _ in range(2000):
        message = rng.bytes(int(rng.integers(1, 300)))
        if library.usart_write(message, ctypes.c_size_t(len(message))):
            accepted += message
        else:
            refusals += 1
        if rng.random() < 0.02:
            chip.finish_sending()
    while len(chip.sent) < len(accepted):
        chip.finish_sending()
    assert chip.sent == accepted
    assert refusals > 0


def test_receiver_pulses_are_measured_and_expire_after_100_ms(library, chip):
    library.receiver_begin()
    us = (ctypes.c_uint16 * 3)()
    assert not library.receiver_read(us)
    at = 0xFFFFFF00  # the counter runs over in the middle
    for width in ((1200, 1500, 1900), (1234, 1501, 1100)):
        for channel in range(3):
            chip.edge(channel, at, True)
            chip.edge(channel, at + width[channel], False)
            at += 3000
        assert library.receiver_read(us)
        assert tuple(us) == width
    for wrong in (700, 2300, 20_000):  # noise, and a lost edge
        chip.edge(0, at, True)
        chip.edge(0, at + wrong, False)
        at += 30_000
    assert us[0] == 1234
    for _ in range(99):
        library.receiver_tick()
    assert library.receiver_read(us)
    library.receiver_tick()
    assert not library.receiver_read(us)
    chip.edge(0, at, True)
    chip.edge(0, at + 1300, False)
    assert not library.receiver_read(us)  # one channel alone is no receiver


def test_encoder_returns_count_at_requested_tick(library, chip):
    library.encoder_begin()
    assert chip.plain[0x40000808] & 7 == 3  # both edges of both inputs
    counts = [(ms * 977) % 65536 for ms in range(400)]
    for ms, count in enumerate(counts):
        chip.plain[0x40000824] = count
        library.encoder_catch(ctypes.c_int64(ms * MS + 37))
    for ms in (399, 390, 300, 150):
        assert library.encoder_count(ctypes.c_int64(ms * MS)) == counts[ms]
    assert library.encoder_count(ctypes.c_int64(1000 * MS)) == counts[399]
    assert library.encoder_count(ctypes.c_int64(5 * MS)) == counts[144]  # older than what is kept: the oldest


def test_time_is_continuous_over_timer_overflow(library, chip):
    library.board_begin(library.clock_begin())
    assert (chip.plain[0x40000028] + 1) * 2_000_000 == 84_000_000
    start = library.board_now()
    chip.plain[0x40000024] = 0xFFFFFFF0
    assert library.board_now() - start == 0xFFFFFFF0 * 5
    chip.plain[0x40000024] = 0x10
    assert library.board_now() - start == (2**32 + 0x10) * 5


def test_stamp_parameters_and_black_box_survive_power_loss(library, chip, drivers, tmp_path):
    library.board_begin(library.clock_begin())
    for number in (2**40 + 5, 2**41 + 7):
        library.board_remember(ctypes.c_uint64(number))
    library.board_store(3, ctypes.c_float(0.625))
    library.board_record((ctypes.c_uint32 * 6)(*range(6)))
    chip.check()
    (tmp_path / "again.so").write_bytes(drivers.read_bytes())
    again = ctypes.CDLL(str(tmp_path / "again.so"))
    again.board_recall.restype = ctypes.c_uint64
    again.board_load.restype = ctypes.c_bool
    later = Chip(again)
    later.flash = chip.flash
    erased = later.now
    again.board_begin(again.clock_begin())
    assert again.board_recall() == 2**41 + 7
    value = ctypes.c_float()
    assert again.board_load(3, ctypes.byref(value))
    assert value.value == 0.625
    assert not again.board_load(2, ctypes.byref(value))
    assert later.now - erased < 0.01  # nothing was erased
    later.check()


def running(library, chip):
    """The inertial sensor, started: it, and a function that goes on by a millisecond and gives the sample, if any."""
    sensor, sample, now = ctypes.create_string_buffer(256), IcmSample(), [0]
    library.spi_begin()
    library.icm_begin(sensor, ctypes.c_int64(0))

    def go(force=(0.0, 0.0, 9.8), rate=(0.0, 0.0, 0.0), degrees=25.0):
        now[0] += MS
        chip.icm.measure(np.add(force, np.sin(now[0]) * 0.01), rate, degrees)
        return sample if library.icm_work(sensor, ctypes.c_int64(now[0]), ctypes.byref(sample)) else None

    for _ in range(70):
        go()
    return sensor, go


def test_inertial_sensor_is_started_and_read_in_si_units(library, chip):
    sensor, go = running(library, chip)
    assert library.icm_good(sensor)
    force, rate = (1.5, -20.25, 9.8), (0.5, -8.0, 2.25)
    sample = go(force, rate, 31.5)
    np.testing.assert_allclose(sample.force, force, atol=0.011)  # a hundredth of it was added
    np.testing.assert_allclose(sample.rate, rate, atol=3e-4)  # a count is 2.7e-4
    assert sample.temperature == pytest.approx(31.5, abs=0.01)
    assert tuple(sample.saturated) == (False, False)
    assert tuple(go((0, 0, 45.0)).saturated) == (True, False)
    assert tuple(go(rate=(0, -9.0, 0)).saturated) == (False, True)


def test_each_inertial_sample_is_delivered_once(library, chip):
    sensor, go = running(library, chip)
    assert all(go() is not None for _ in range(20))
    assert not library.icm_work(sensor, ctypes.c_int64(90 * MS + 1), ctypes.byref(IcmSample()))


@pytest.mark.thorough("dead", "frozen", "reset")
@pytest.mark.parametrize("fault", ["another", "dead", "frozen", "reset"])
def test_failed_inertial_sensor_is_detected_and_restarted(library, chip, fault):
    """Faults: another chip, an open line, identical samples, a reset that lost the settings."""
    sensor, go = running(library, chip)
    if fault == "another":
        chip.icm.identity = 0x12
        chip.icm.reset()
    elif fault == "reset":
        chip.icm.reset()
    else:
        setattr(chip.icm, fault, True)
    for _ in range(60):
        go()
    assert not library.icm_good(sensor)
    chip.icm.identity, chip.icm.dead, chip.icm.frozen = 0x47, False, False
    for _ in range(2300):
        go()
    assert library.icm_good(sensor)
    assert go() is not None


@pytest.mark.parametrize("stuck", [0, 0xFFFFFFFF])
def test_drivers_return_with_stuck_registers(library, stuck):
    """All registers read a constant, so no operation completes; each call must still return."""
    get = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32)(lambda address: stuck)
    put = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32)(lambda address, value: None)
    library.model_connect(get, put)
    assert library.clock_begin() == bool(stuck)
    library.watchdog_begin()
    library.usart_begin()
    library.usart_write(b"x" * 100, ctypes.c_size_t(100))
    library.spi_begin()
    sensor, sample = ctypes.create_string_buffer(256), IcmSample()
    library.icm_begin(sensor, ctypes.c_int64(0))
    for ms in range(100):
        assert not library.icm_work(sensor, ctypes.c_int64(ms * MS), ctypes.byref(sample))
    assert not library.icm_good(sensor)
    assert not library.flash_program(0x08008000, 0x12345678)
