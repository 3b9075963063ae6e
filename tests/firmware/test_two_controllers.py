"""Two boards on one bus, each with its whole program on a model of its registers: from a unit's line to the radio, and
from the failsafe to the lift fan."""

import ctypes

import pytest
from firmware.chip import Chip
from firmware.i2c import Device, Master
from firmware.test_stm32 import BOARD, FIRMWARE, compile_drivers
from firmware.test_stm32_flight import MS, Craft, program  # noqa: F401

pytestmark = pytest.mark.thorough

USART = 0x40004400, 0x40004800
RXNE, TXE = 1 << 5, 1 << 7
SOUND = 343.99


class BusChip(Chip):
    """A chip with I2C 2: `bus` is its end of it."""

    def __init__(self, library, bus):
        self.bus = bus
        super().__init__(library)

    def read(self, address):
        return self.bus.read(address) if address >> 8 == 0x400058 else super().read(address)

    def write(self, address, value):
        if address >> 8 == 0x400058:
            self.bus.write(address, value)
        else:
            super().write(address, value)


class Slave:
    """The second board: units' lines in, pulses of the lift fan out, by the millisecond."""

    def __init__(self, library, device):
        self.library, self.state, self.asked = library, ctypes.create_string_buffer(1 << 14), [b"", b""]
        self.bus = Master(library, device, joins=False)
        self.chip = BusChip(library, self.bus)
        self.now = 0
        library.board_begin(True)
        library.slave_begin(self.state)

    def say(self, unit, text):
        """Bytes on a unit's line, each of which interrupts."""
        at = USART[unit]
        for byte in text.encode():
            self.chip.plain[at], self.chip.plain[at + 4] = RXNE, byte
            self.library[f"unit_interrupt_{unit}"]()
        self.chip.plain[at] = 0

    def run(self):
        self.now += MS
        self.chip.plain[0x40000024] = self.now // 5
        self.chip.pass_time(1e-3)
        self.library.board_ticked()
        self.library.slave_work(self.state)
        for unit, at in enumerate(USART):  # what waits goes out
            while self.chip.plain[at + 0x0C] & 1 << 7:
                self.chip.plain[at], self.chip.plain[at + 4] = TXE, None
                self.library[f"unit_interrupt_{unit}"]()
                sent = self.chip.plain[at + 4]
                self.asked[unit] += b"" if sent is None else bytes([sent])
            self.chip.plain[at] = 0
        self.chip.check()

    def lift(self):
        return self.chip.pulses()[1][2]


class Pair(Craft):
    """A craft whose board has the second one on its bus."""

    def __init__(self, program, slave, folder):  # noqa: F811
        super().__init__(program, folder, lambda library: BusChip(library, Device(library, joins=False)))
        self.slave, self.lines = Slave(slave, self.chip.bus), []

    def run(self, ms, data=b""):
        heard = []
        for _ in range(ms):
            heard += super().run(1, data)
            data = b""
            for unit, at, text in self.lines:
                if at == self.slave.now // MS:
                    self.slave.say(unit, text)
            self.slave.run()
        return heard


@pytest.fixture
def pair(program, tmp_path):  # noqa: F811
    names = [
        *("clock", "i2c", "program", "servo", "time", "watchdog"),
        "slave/board",
        "slave/bus_master",
        "slave/units",
    ]
    sources = [BOARD / f"{name}.c" for name in names]
    sources += [FIRMWARE / "slave" / f"{name}.c" for name in ("slave", "cricket")]
    sources += [FIRMWARE / "portable" / f"{name}.c" for name in ("pieces", "ping", "pulse")]
    folders = [FIRMWARE / part for part in ("portable", "drives/fan", "slave", "boards/stm32f405")]
    library = ctypes.CDLL(str(compile_drivers(tmp_path / "slave.so", sources, folders, "-DROLE_SLAVE")))
    pair = Pair(program, library, tmp_path)
    yield pair
    pair.chip.check()
    pair.slave.chip.check()
    pair.slave.bus.check()
    pair.chip.bus.check()


def test_unit_replies_reach_autopilot_as_sample_of_their_ping(pair):
    pair.lines = [(1, 150, "SP=B1,DR=6000\r\n"), (0, 240, "VR=2.0,SP=B3,DR=9000\r\nVR=2.0,SP=B5,DR=12000\r\n")]
    pair.lines += [(0, 320, "SP=B3,DR=9100\r\n"), (1, 550, "SP=B27,DR=5000\r\nSP=B28,DR=5000\r\n")]  # there are 28
    pair.run(50, pair.pack("HEARTBEAT", type=6))
    said = pair.run(700)
    ranges = [m for m in said if m.name == "SAMPLE_RANGING_1"]
    others = [m for m in said if m.name == "SAMPLE_RANGING_2"]
    found = []
    for m, other in zip(ranges, others, strict=True):
        arrived = [k for k, came in enumerate(other.get("arrived")) if came]
        assert m.get("t") == other.get("t")
        assert [k for k, r in enumerate(m.get("range_")) if r] == arrived
        found.append((m.get("t") / MS, other.get("unit"), {k: m.get("range_")[k] for k in arrived}))
    assert [(unit, sorted(heard)) for _, unit, heard in found] == [(1, [1]), (0, [3, 5]), (1, [27])]
    assert [t for t, _, _ in found] == pytest.approx([99, 199, 499], abs=0.15)  # the model's bus takes no millisecond
    assert found[1][2][3] == pytest.approx(9.0e-3 * SOUND, rel=1e-6)
    assert pair.slave.asked[0][:6] == b"P\r\nP\r\n"


def test_lift_fan_of_second_board_follows_failsafe_of_first(pair):
    pair.run(100, pair.pack("HEARTBEAT", type=6))
    assert pair.slave.lift() == pytest.approx(1e-3)
    pair.arm()
    for _ in range(20):
        pair.run(20, pair.command())
    assert pair.slave.lift() == pytest.approx(2e-3)
    pair.run(1300)  # no commands: failsafe after 0.25 s, and a second later the lift fan
    assert pair.slave.lift() == pytest.approx(1e-3)


@pytest.mark.parametrize("dies", ["cut", "hangs"])
def test_lift_fan_stops_when_first_board_is_lost(pair, dies):
    """The bus is cut, or the first program is stuck while its interrupts repeat the last command."""
    pair.run(100, pair.pack("HEARTBEAT", type=6))
    pair.arm()
    for _ in range(20):
        pair.run(20, pair.command())
    if dies == "cut":
        pair.slave.bus.device = None
    for _ in range(230):
        pair.slave.run()
    assert pair.slave.lift() == pytest.approx(2e-3)
    for _ in range(31):
        pair.slave.run()
    assert pair.slave.lift() == pytest.approx(1e-3)
    assert not pair.slave.chip.watchdog["reset"]
