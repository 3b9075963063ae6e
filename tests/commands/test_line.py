"""Links of the verbs that fly: which may be unsigned, which key signs them, and how they end."""

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
def test_unsigned_is_accepted_on_local_link(uri):
    assert is_local(uri)
    assert find_key("hovercraft/forward", None, True, uri, create=True) is None


@pytest.mark.parametrize("uri", FAR)
def test_unsigned_is_rejected_on_remote_link(uri):
    assert not is_local(uri)
    with pytest.raises(InputError, match=r"--unsigned.*could command the vehicle") as refused:
        find_key("hovercraft/forward", None, True, uri, create=True)
    assert "leave it out" in refused.value.fix


def test_vehicle_creates_key_and_autopilot_finds_the_same(keys, capsys):
    made = find_key("hovercraft/forward", None, False, "udp://0.0.0.0:14550", create=True)
    file = keys / "hovercraft.key"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert str(file) in capsys.readouterr().err
    found = find_key("hovercraft/spin", None, False, "udp://192.168.4.1:14550", create=False)
    assert found == made
    assert find_key("hovercraft/spin", None, False, "udp://:1", create=True) == made
    assert capsys.readouterr().err == ""
    assert find_key("hypersonic/noise", file, False, "udp://:1", create=False) == made


def test_missing_key_is_rejected_with_vehicle_command(keys):
    with pytest.raises(InputError, match="key not found") as refused:
        find_key("hovercraft/forward", None, False, "udp://:14550", create=False)
    assert refused.value.fix.startswith("trimtab vehicle hovercraft/forward --listen udp://:14550  ")
    assert "copy the key file" in refused.value.fix
    assert not keys.exists()


def test_invalid_link_uri_is_rejected_before_key_lookup(keys):
    with pytest.raises(InputError, match=r"127\.0\.0\.1:14550") as refused:
        find_key("hovercraft/forward", None, False, "127.0.0.1:14550", create=False)
    assert "key" not in refused.value.problem


def test_key_readable_by_others_is_rejected_with_chmod_command(keys):
    find_key("hovercraft/forward", None, False, "udp://:1", create=True)
    file = keys / "hovercraft.key"
    file.chmod(0o640)
    with pytest.raises(InputError, match="other users can read") as refused:
        find_key("hovercraft/forward", None, False, "udp://:1", create=False)
    assert refused.value.fix == f"chmod 600 '{file}'"


def test_rejects_key_combined_with_unsigned(keys):
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
        ("mein größtes Boot.py:scenario", "mein-gr--tes-Boot"),
        ("_.py:scenario", "vehicle"),
    ],
)
def test_each_vehicle_has_one_key(scenario, vehicle, keys):
    assert vehicle_name(scenario) == vehicle
    find_key(scenario, None, False, "udp://:1", create=True)
    assert [f.name for f in keys.glob("*.key")] == [f"{vehicle}.key"]


def test_time_stamps_are_locked_while_open_and_released_on_close(keys):
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


def test_first_interrupt_sets_flag_and_second_raises():
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


@pytest.fixture(params=[signal.SIG_DFL, signal.SIG_IGN])
def hangup(request):
    """Handler of SIGHUP before a flight. It is ignored under nohup."""
    before = signal.signal(signal.SIGHUP, request.param)
    yield request.param
    signal.signal(signal.SIGHUP, before)


def test_lost_terminal_sets_flag_unless_ignored_and_never_raises(hangup):
    """Shell and system both send SIGHUP, at any time one after the other. Only a user can ask to end at once."""
    clock = SimpleNamespace(now=0)
    clock.monotonic_ns = lambda: clock.now
    with catch_interrupts(clock) as stop:
        try:
            for _ in range(3):
                os.kill(os.getpid(), signal.SIGHUP)
                clock.now += 1_000_000_000
        except KeyboardInterrupt:
            pytest.fail("a second SIGHUP ends the program at once")
        assert stop() == (hangup is signal.SIG_DFL)
        if stop():
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGHUP) is hangup
