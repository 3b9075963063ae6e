"""Lines of the verbs that fly: which may be unsigned, whose key signs them, and how they end."""

import os
import signal
import stat
from types import SimpleNamespace

import pytest

from trimtab.commands.line import endpoint_factory, find_key, is_local, vehicle_name
from trimtab.core.errors import InputError
from trimtab.flight.machine import catch_interrupts, store_stamps_ahead


@pytest.fixture(autouse=True)
def keys(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path))
    return tmp_path / "keys"


LOCAL = ["udp://:14550", "udp://127.0.0.1:14550", "udp://127.8.8.8:1", "udp://[::1]:14550", "udp://localhost:14550"]
LOCAL += ["loopback://hovercraft", "tcp://127.0.0.1:5760"]
FAR = ["udp://0.0.0.0:14550", "udp://192.168.4.1:14550", "udp://[::]:14550", "udp://example.org:1", "tcp://10.0.0.1:1"]
FAR += ["serial:///dev/ttyUSB0?baud=115200", "rfcomm://00:11:22:AA:BB:CC/1", "udp://127.0.0.1.example.org:1"]


@pytest.mark.parametrize("uri", LOCAL)
def test_unsigned_on_a_line_within_this_machine(uri):
    assert is_local(uri)
    assert find_key("hovercraft/forward", None, True, uri, create=True) is None


@pytest.mark.parametrize("uri", FAR)
def test_unsigned_is_refused_on_all_others(uri):
    assert not is_local(uri)
    with pytest.raises(InputError, match=r"--unsigned.*could command the vehicle") as refused:
        find_key("hovercraft/forward", None, True, uri, create=True)
    assert "leave it out" in refused.value.fix


def test_the_vehicle_makes_a_key_and_the_autopilot_finds_it(keys, capsys):
    made = find_key("hovercraft/forward", None, False, "udp://0.0.0.0:14550", create=True)
    file = keys / "hovercraft.key"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert str(file) in capsys.readouterr().err
    found = find_key("hovercraft/spin", None, False, "udp://192.168.4.1:14550", create=False)
    assert found == made
    assert find_key("hovercraft/spin", None, False, "udp://:1", create=True) == made
    assert capsys.readouterr().err == ""
    assert find_key("hypersonic/noise", file, False, "udp://:1", create=False) == made


def test_without_a_key_the_autopilot_is_told_what_to_do(keys):
    with pytest.raises(InputError, match="key not found") as refused:
        find_key("hovercraft/forward", None, False, "udp://:14550", create=False)
    assert refused.value.fix.startswith("trimtab vehicle hovercraft/forward --listen udp://:14550  ")
    assert "copy the file" in refused.value.fix
    assert not keys.exists()


def test_a_line_that_is_none_is_refused_before_its_key(keys):
    with pytest.raises(InputError, match=r"127\.0\.0\.1:14550") as refused:
        find_key("hovercraft/forward", None, False, "127.0.0.1:14550", create=False)
    assert "key" not in refused.value.problem


def test_a_key_that_others_can_read_is_refused_with_what_to_type(keys):
    find_key("hovercraft/forward", None, False, "udp://:1", create=True)
    file = keys / "hovercraft.key"
    file.chmod(0o640)
    with pytest.raises(InputError, match="other users can read") as refused:
        find_key("hovercraft/forward", None, False, "udp://:1", create=False)
    assert refused.value.fix == f"chmod 600 '{file}'"


def test_a_key_with_unsigned_is_refused(keys):
    with pytest.raises(InputError, match="cannot be combined with --key"):
        find_key("hovercraft/forward", keys / "a.key", True, "udp://:1", create=False)


@pytest.mark.parametrize(
    ("scenario", "vehicle"),
    [
        ("hovercraft/forward", "hovercraft"),
        ("my_boat:scenario", "my_boat"),
        ("my_boat.py:scenario", "my_boat"),
        ("boats/my_boat.py:scenario", "my_boat"),
        ("/home/me/boats/my_boat.py:scenario", "my_boat"),
    ],
)
def test_there_is_one_key_a_vehicle(scenario, vehicle, keys):
    assert vehicle_name(scenario) == vehicle
    find_key(scenario, None, False, "udp://:1", create=True)
    assert [f.name for f in keys.glob("*.key")] == [f"{vehicle}.key"]


def test_stamps_are_kept_and_given_back(keys):
    from flight.mavlink.line import every
    from run.stand_ins import dialect

    key = find_key("hovercraft/forward", None, False, "udp://:1", create=True)
    _, messages = dialect({"compass": every()}, every())
    make = endpoint_factory("udp://:1", (1, 191), key)
    one = make(messages)
    with pytest.raises(InputError, match="another process uses this key"):
        make(messages)
    with store_stamps_ahead(one):
        one.pack("HEARTBEAT")
    make(messages).close()


def test_an_interrupt_raises_a_flag_and_a_second_one_ends_it():
    before, clock = signal.getsignal(signal.SIGTERM), SimpleNamespace(now=0)
    clock.monotonic_ns = lambda: clock.now
    with catch_interrupts(clock) as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop()
        clock.now = 3_000_000
        os.kill(os.getpid(), signal.SIGINT)  # the same key press: some wrappers send two signals
        clock.now = 1_000_000_000
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before
