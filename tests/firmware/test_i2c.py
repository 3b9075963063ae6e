"""The I2C bus between two STM32F405: both drivers on models of the registers, connected byte by byte."""

import ctypes

import numpy as np
import pytest
from firmware.i2c import CR1, PE, Device, Master
from firmware.test_slave import Piece
from firmware.test_stm32 import BOARD, FIRMWARE, compile_drivers

from trimtab.compiler.native.compiler import find_compiler

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
WORD = b"\xa5\x05\x01\x07\x12\x34"


@pytest.fixture(scope="module")
def drivers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("i2c")
    folders = [FIRMWARE / part for part in ("portable", "drives/fan", "slave", "boards/stm32f405")]
    ends = {"device": ["bus_device", "i2c", "time"], "master": ["slave/bus_master", "i2c"]}
    return [
        compile_drivers(folder / f"{name}.so", [BOARD / f"{s}.c" for s in sources], folders)
        for name, sources in ends.items()
    ]


@pytest.fixture
def ends(drivers, tmp_path):
    """Device and master, each with static variables of its own."""
    libraries = []
    for path in drivers:
        copy = tmp_path / path.name
        copy.write_bytes(path.read_bytes())
        libraries.append(ctypes.CDLL(str(copy)))
    there, here = libraries
    there.bus_take.restype = ctypes.c_bool
    here.slave_bus_write.restype = here.slave_bus_read.restype = ctypes.c_bool
    device = Device(there)
    master = Master(here, device)
    yield device, master
    device.check()
    master.check()


def send(master, data):
    return master.library.slave_bus_write(data, ctypes.c_size_t(len(data)))


def receive(master, n):
    to = (ctypes.c_uint8 * n)()
    good = master.library.slave_bus_read(to, ctypes.c_size_t(n))
    return bytes(to) if good else None


def taken(device):
    found, piece = [], Piece()
    while device.library.bus_take(ctypes.byref(piece)):
        found.append((bytes(piece.bytes[: piece.n]), piece.at))
    return found


def test_messages_arrive_intact_with_timestamps_and_replies_return(ends):
    device, master = ends
    rng = np.random.default_rng(1)
    for k in range(300):
        data = rng.integers(0, 256, rng.integers(1, 11), dtype=np.uint8).tobytes()
        device.plain[0x40000024] = k * 20_000  # timer 2, 2 MHz: 10 ms on
        assert send(master, data)
        word = rng.integers(0, 256, rng.integers(3, 11), dtype=np.uint8).tobytes()
        device.library.bus_answer(word, ctypes.c_size_t(len(word)))
        assert receive(master, len(word)) == word
        assert taken(device) == [(data, k * 100_000)]
    assert taken(device) == []


def test_slow_reader_loses_newest_messages(ends):
    device, master = ends
    for k in range(20):
        assert send(master, bytes([k]))
    assert [data for data, _ in taken(device)] == [bytes([k]) for k in range(16)]


def test_drops_too_long_message(ends):
    device, master = ends
    assert send(master, bytes(11))
    assert send(master, b"good")
    assert [data for data, _ in taken(device)] == [b"good"]


def test_unconnected_bus_fails_and_recovers_on_connection(ends):
    device, master = ends
    master.device = None
    assert not send(master, b"lost")
    assert receive(master, 6) is None
    master.device = device
    device.library.bus_answer(WORD, ctypes.c_size_t(len(WORD)))
    assert send(master, b"there")
    assert receive(master, 6) == WORD
    assert [data for data, _ in taken(device)] == [b"there"]


def test_disabled_device_does_not_acknowledge_its_address(ends):
    device, master = ends
    device.plain[CR1] = PE
    assert not send(master, b"lost")
    assert receive(master, 6) is None


def test_stuck_bus_is_reset_within_poll_limit(ends):
    device, master = ends
    master.device, master.hangs = None, True  # a clock held low: the stop does not come
    assert not send(master, b"lost")
    assert not master.hangs
    master.device = device
    assert send(master, b"there")
    assert [data for data, _ in taken(device)] == [b"there"]


def test_reply_does_not_change_while_being_read(ends):
    device, master = ends
    device.library.bus_answer(WORD, ctypes.c_size_t(len(WORD)))
    seen = []

    def change(byte):
        seen.append(byte)
        device.library.bus_answer(bytes(6), ctypes.c_size_t(6))
        return byte

    master.noise = change
    assert receive(master, 6) == WORD
    assert receive(master, 6) == bytes(6)


@pytest.mark.parametrize("stuck", [0, 0xFFFFFFFF])
def test_transfers_return_with_stuck_registers(ends, stuck):
    """All registers read a constant, so no transfer completes; each call must still return."""
    library = ends[1].library
    get = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32)(lambda address: stuck)
    put = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32)(lambda address, value: None)
    library.model_connect(get, put)
    library.bus_begin()
    assert not library.slave_bus_write(b"lost", ctypes.c_size_t(4))
    assert not library.slave_bus_read((ctypes.c_uint8 * 6)(), ctypes.c_size_t(6))
