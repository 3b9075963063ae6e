"""The slave's program on this computer: bus messages, serial lines of the ranging units, failsafe of the lift fan.

Source: Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 5.
"""

import ctypes
import subprocess
from pathlib import Path

import jax
import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import new_sample
from trimtab.core.time import ms
from trimtab.links.slave_bus import SlaveBus

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")

FIRMWARE = Path(__file__).parents[2] / "firmware"
FLAGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
PING, LIFT = 2, 5
OFF, ON = 2000, 4000
SLOT, BYTE = 100_000, 900


class Piece(ctypes.Structure):
    _fields_ = (("n", ctypes.c_size_t), ("at", ctypes.c_int64), ("bytes", ctypes.c_uint8 * 10))


class Queue(ctypes.Structure):
    _fields_ = (
        ("waiting", Piece * 32),
        ("put", ctypes.c_uint32),
        ("taken", ctypes.c_uint32),
        ("due", ctypes.c_int64),
        ("free_at", ctypes.c_int64),
        ("dropped", ctypes.c_uint32),
    )


class Message(ctypes.Structure):
    _fields_ = (("id", ctypes.c_uint8), ("n", ctypes.c_size_t), ("data", ctypes.c_uint8 * 40), ("at", ctypes.c_int64))


class Assembler(ctypes.Structure):
    _fields_ = (("kept", Piece * 8), ("n", ctypes.c_size_t), ("broken", ctypes.c_uint32))


class Reply(ctypes.Structure):
    _fields_ = (("beacon", ctypes.c_uint8), ("us", ctypes.c_uint16))


class Ping(ctypes.Structure):
    _fields_ = (("at", ctypes.c_int64), ("unit", ctypes.c_uint8), ("n", ctypes.c_uint8), ("replies", Reply * 6))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    output = tmp_path_factory.mktemp("slave") / "slave.so"
    sources = [
        Path(__file__).with_name("slave_host.c"),
        FIRMWARE / "slave" / "slave.c",
        FIRMWARE / "slave" / "cricket.c",
    ]
    sources += [FIRMWARE / "portable" / f"{name}.c" for name in ("pieces", "ping", "pulse")]
    include = [f"-I{FIRMWARE / part}" for part in ("portable", "slave")]
    done = subprocess.run(
        ["cc", *FLAGS, *include, *map(str, sources), "-o", str(output)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(output))
    for name in ("pieces_offer", "pieces_next", "pieces_message", "ping_unpack", "cricket_take"):
        getattr(library, name).restype = ctypes.c_bool
    library.host_sent.restype = library.host_asked.restype = library.message_pack.restype = ctypes.c_size_t
    library.host_piece.restype = ctypes.POINTER(Piece)
    return library


def assembled(library, pieces):
    """Messages out of pieces, in their order."""
    assembler, message, found = Assembler(), Message(), []
    for piece in pieces:
        library.pieces_put(ctypes.byref(assembler), ctypes.byref(piece))
        while library.pieces_message(ctypes.byref(assembler), ctypes.byref(message)):
            found.append(Message.from_buffer_copy(message))
    return found


def content(message):
    return bytes(message.data[: message.n])


@pytest.mark.thorough
@pytest.mark.parametrize("size", [6, 10, 11, 23, 24, 45])
def test_messages_arrive_at_times_of_simulated_bus(library, size):
    """Arrival times and drops of messages offered at random times equal those of the simulated bus."""
    rng = np.random.default_rng(size)
    length = 3000
    offered = np.sort(rng.choice(length - 400, 90, replace=False))
    bus = to_arrays(SlaveBus(size=size))
    state, step = bus.init(key(0), new_sample(np.int64(0), np.float64(0))), jax.jit(bus.step)
    queue, piece, wanted, found, pieces = Queue(), Piece(), {}, {}, []
    for t in range(length):
        newest = max((m for m in offered if m <= t), default=-1)
        sample = new_sample(np.int64(ms(int(newest))), np.float64(newest), fresh=bool(t == newest))
        if newest >= 0:
            state, out = step(np.int64(ms(t)), state, sample)
            if out.fresh:
                wanted[int(out.t) // ms(1)] = t
        if t == newest:
            data = int(t).to_bytes(8, "little").ljust(size - 5, b"\0")[: size - 5]
            library.pieces_offer(ctypes.byref(queue), ctypes.c_int64(ms(t)), PING, data, ctypes.c_size_t(size - 5))
        if library.pieces_next(ctypes.byref(queue), ctypes.c_int64(ms(t)), ctypes.byref(piece)):
            pieces.append(Piece.from_buffer_copy(piece))
    for message, last in zip(assembled(library, pieces), _last_pieces(pieces, size), strict=True):
        found[message.at // SLOT] = -(-last.at // ms(1))  # the receiving end looks each millisecond
    assert sorted(found.values()) == sorted(wanted.values())
    assert queue.dropped == len(offered) - len(wanted)
    assert queue.dropped > 0 or size < 12


def _last_pieces(pieces, size):
    count = -(-size // 10)
    return pieces[count - 1 :: count]


def pack(library, name, data):
    to = (ctypes.c_uint8 * 45)()
    return bytes(to[: library.message_pack(name, data, ctypes.c_size_t(len(data)), to)])


def cut(message, begins):
    parts = [message[i : i + 10] for i in range(0, len(message), 10)]
    return [
        Piece(len(p), begins + k * SLOT + (len(p) + 1) * BYTE, (ctypes.c_uint8 * 10)(*p)) for k, p in enumerate(parts)
    ]


def test_only_intact_messages_survive_loss_corruption_and_insertion(library):
    """Pieces are lost, corrupted or inserted: exactly the untouched messages arrive."""
    rng = np.random.default_rng(7)
    pieces, whole, slot = [], [], 0
    for _ in range(2000):
        data = rng.integers(0, 256, rng.integers(0, 41), dtype=np.uint8).tobytes()
        own = cut(pack(library, PING, data), slot * SLOT)
        slot += len(own) + int(rng.integers(0, 3))
        kind = rng.integers(0, 4)
        if kind == 0:
            del own[rng.integers(len(own))]
        elif kind == 1:
            at = own[rng.integers(len(own))]
            at.bytes[rng.integers(at.n)] ^= int(rng.integers(1, 256))
        elif kind == 2:
            strange = bytes([0xA5, PING, 30]) + rng.integers(0, 256, 7, dtype=np.uint8).tobytes()
            own.insert(0, *cut(strange, slot * SLOT))
            slot += 1
            for k, p in enumerate(own[1:], 1):
                p.at = own[0].at + k * SLOT
            slot += len(own)
            whole.append(data)
        else:
            whole.append(data)
        pieces += own
    found = [content(m) for m in assembled(library, [*pieces, *cut(pack(library, PING, b"end"), (slot + 9) * SLOT)])]
    assert found == [*whole, b"end"]


def test_rejects_message_of_wrong_length(library):
    queue = Queue()
    for name, n in ((PING, 41), (LIFT, 1), (LIFT, 3)):
        assert not library.pieces_offer(ctypes.byref(queue), ctypes.c_int64(0), name, bytes(50), ctypes.c_size_t(n))
    assert (queue.put, queue.dropped) == (0, 0)


LINES = {
    "reply of a beacon": ("VR=2.0,ID=01:dc:8b:7c:0a:00:00:35,SP=MIT-6,DB=182,DR=5123,TM=5440,TS=24608", (6, 5123)),
    "a number for a name": ("SP=17,DR=1", (17, 1)),
    "the other order": ("DR=65535,SP=0", (0, 65535)),
    "no beacon": ("VR=2.0,DB=182,DR=5123,TS=1", None),
    "no time of flight": ("SP=6,DB=182", None),
    "no number": ("SP=MIT,DR=5123", None),
    "invalid beacon number": ("SP=256,DR=5123", None),
    "invalid time of flight": ("SP=6,DR=65536", None),
    "one that overflows": ("SP=6,DR=42949672965", None),
    "half a number": ("SP=6,DR=5x23", None),
    "a longer name": ("SSP=6,DR=5123", None),
    "too long": ("SP=6,DR=5123,TS=" + "1" * 200, None),
    "nothing": ("", None),
}


@pytest.mark.parametrize("name", LINES)
def test_parses_lines_of_cricket_unit(library, name):
    line, wanted = LINES[name]
    parser, reply = ctypes.create_string_buffer(64), Reply()
    found = [
        (reply.beacon, reply.us)
        for byte in f"{line}\r\nSP=3,DR=77\r\n".encode()  # whatever came before spoils its own line only
        if library.cricket_take(parser, ctypes.c_uint8(byte), ctypes.byref(reply))
    ]
    assert found == ([] if wanted is None else [wanted]) + [(3, 77)]


def test_parser_survives_garbage_on_serial_line(library):
    rng = np.random.default_rng(3)
    parser, reply = ctypes.create_string_buffer(64), Reply()
    alphabet = np.frombuffer(b"SPDR=,0123456789\r\n-x\xff\0", np.uint8)
    for byte in rng.choice(alphabet, 200_000):
        if library.cricket_take(parser, ctypes.c_uint8(byte), ctypes.byref(reply)):
            assert reply.us > 0


class Rig:
    """The slave at its units and its bus, by the millisecond; the other controller's words as the board gives them."""

    def __init__(self, library):
        self.library, self.t, self.count = library, 0, 0
        library.host_begin()

    def run(self, length, *, lift=None, replies=None):
        """lift: what the other controller says; None: it hangs.  replies: (unit, ms, text) at such a time."""
        for _ in range(length):
            if lift is not None:
                self.count = (self.count + 1) % 256
                word = pack(self.library, LIFT, bytes([lift, self.count]))
                self.library.host_word(word, ctypes.c_size_t(len(word)))
            for unit, at, text in replies or ():
                if at == self.t:
                    self.library.host_say(unit, text.encode(), ctypes.c_size_t(len(text)))
            self.library.host_work(ctypes.c_int64(ms(self.t)))
            self.t += 1

    def pings(self):
        """What has come through, on the other controller's clock: here the same."""
        pieces = [self.library.host_piece(ctypes.c_size_t(k))[0] for k in range(self.library.host_sent())]
        found, ping = [], Ping()
        for message in assembled(self.library, pieces):
            assert self.library.ping_unpack(ctypes.byref(message), ctypes.byref(ping))
            replies = {r.beacon: r.us for r in ping.replies[: ping.n]}
            found.append((ping.at / ms(1), ping.unit, replies))
        return found


@pytest.fixture
def rig(library):
    return Rig(library)


def test_units_are_polled_in_turn_and_replies_carry_ping_time(rig):
    replies = [
        (0, 40, "SP=B4,DR=5123\r\nSP=B7,DR=6001\r\n"),
        (0, 70, "SP=B4,DR=9999\r\nSP=B9,DR=8000\r\n"),  # an echo, and another one
        (1, 150, "SP=B2,DR=4000\r\n"),
        (0, 160, "SP=B1,DR=4000\r\n"),  # not asked now
        (0, 290, "".join(f"SP={b},DR={1000 + b}\r\n" for b in range(9))),
    ]
    rig.run(700, lift=0, replies=replies)
    wanted = [
        (0, 0, {4: 5123, 7: 6001, 9: 8000}),
        (100, 1, {2: 4000}),
        (200, 0, {b: 1000 + b for b in range(6)}),
    ]
    for (at, unit, heard), (t, one, replied) in zip(rig.pings(), wanted, strict=True):
        assert (unit, heard) == (one, replied)
        assert at == pytest.approx(t, abs=0.1)
    assert [rig.library.host_asked(u) for u in (0, 1)] == [3 * 4, 3 * 3]
    assert rig.library.host_kicks() == 700


def test_lift_fan_stops_250_ms_after_last_new_command(rig):
    rig.run(300, lift=0)
    assert rig.library.host_pulse() == OFF
    rig.run(40, lift=1)
    assert rig.library.host_pulse() == ON
    stopped = None
    for k in range(400):  # the other controller hangs: the same word again and again
        rig.run(1)
        if stopped is None and rig.library.host_pulse() == OFF:
            stopped = k
    assert 240 <= stopped <= 251
    rig.run(40, lift=1)
    assert rig.library.host_pulse() == ON
    rig.run(11, lift=0)  # a word to stop acts with its slot, not with the next frame
    assert rig.library.host_pulse() == OFF


def test_cut_bus_stops_lift_fan_and_is_counted(rig):
    rig.run(100, lift=1)
    rig.library.host_bus(0)
    rig.run(251, lift=1, replies=[(0, 210, "SP=1,DR=1000\r\n")])
    assert rig.library.host_pulse() == OFF
    assert rig.library.host_unacknowledged() > 0
    rig.library.host_bus(1)
    rig.run(40, lift=1)
    assert rig.library.host_pulse() == ON


def test_lift_fan_stays_off_until_first_valid_command(rig):
    rig.library.host_word(bytes([0xA5, LIFT, 1, 0, 0, 0]), ctypes.c_size_t(6))  # its check is wrong
    rig.run(500)
    assert rig.library.host_pulse() == OFF
