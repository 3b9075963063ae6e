"""pymavlink, an independent implementation of MAVLink and its signatures, as ground station of a running vehicle."""

import hashlib
import json
import socket
import time

import pytest
from ground.serving import served

pytestmark = pytest.mark.real_time

common = pytest.importorskip("pymavlink.dialects.v20.common", reason="pip install pymavlink")

PATIENCE = 30.0
"""Seconds; only a failure takes this long."""
SIGNING_EPOCH = 1_420_070_400
ARM, SET_MODE, SET_INTERVAL = 400, 176, 511
REBOOT, STORAGE, TAKEOFF, UNSUPPORTED = 246, 245, 22, 3
GUIDED, MANUAL = 15, 0


class Peer:
    """A ground station made with pymavlink and a socket."""

    def __init__(self, port, passphrase=None, link=0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self.mav = common.MAVLink(self, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.sent, self.bytes_heard, self._beat = [], 0, 0.0
        self.gaps = self.unknown = 0
        self._numbers = {}
        if passphrase:
            signing = self.mav.signing
            signing.secret_key = hashlib.sha256(passphrase.encode()).digest()
            signing.timestamp = int((time.time() - SIGNING_EPOCH) * 1e5)
            signing.sign_outgoing, signing.link_id = True, link

    def write(self, packet):
        self.sent.append(bytes(packet))
        self.send(packet)

    def send(self, packet):
        self._socket.send(packet)

    def hear(self, wait):
        """The messages of the next packet."""
        if time.monotonic() > self._beat:
            self._beat = time.monotonic() + 0.5
            self.mav.heartbeat_send(6, 8, 0, 0, 0)
        self._socket.settimeout(wait)
        try:
            packet = self._socket.recv(65535)
        except TimeoutError:
            return []
        self.bytes_heard += len(packet)
        messages = self.mav.parse_buffer(packet) or []
        for message in messages:
            sender = message.get_srcSystem(), message.get_srcComponent()
            self.gaps += sender in self._numbers and message.get_seq() != (self._numbers[sender] + 1) & 0xFF
            self._numbers[sender] = message.get_seq()
            self.unknown += message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN")
        return messages

    def await_(self, name, good=lambda message: True, ask=lambda: None):
        """Return the first message of a name that satisfies `good`. Calls `ask` twice a second."""
        end, again = time.monotonic() + PATIENCE, 0.0
        while time.monotonic() < end:
            if time.monotonic() > again:
                again = time.monotonic() + 0.5
                ask()
            for message in self.hear(0.1):
                if message.get_type() == name and good(message):
                    return message
        raise AssertionError(f"no {name}")

    def command(self, number, *params):
        params = [*params, *[0.0] * (7 - len(params))]
        return self.await_(
            "COMMAND_ACK",
            lambda m: m.command == number,
            lambda: self.mav.command_long_send(1, 1, number, 0, *params),
        ).result

    def attack(self):
        """Send an attacker's requests for a second."""
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            self.mav.command_long_send(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
            self.mav.command_long_send(1, 1, SET_MODE, 0, 1, MANUAL, 0, 0, 0, 0, 0)
            self.mav.param_set_send(1, 1, b"WV_MASS", 5.0, 9)
            self.mav.param_request_list_send(1, 1)
            self.mav.ping_send(0, 1, 0, 0)
            self.hear(0.05)

    def is_armed(self):
        return bool(self.await_("HEARTBEAT").base_mode & 128)

    def close(self):
        self._socket.close()


def test_station_with_the_key_reads_arms_and_sets_parameters(tmp_path):
    with served(tmp_path, "--origin", "38.9897,-76.9378,20") as vehicle:
        peer = Peer(vehicle.port, vehicle.passphrase)
        beat = peer.await_("HEARTBEAT")
        assert (beat.type, beat.custom_mode, beat.base_mode & 128) == (11, GUIDED, 0)
        for name in ("ATTITUDE", "LOCAL_POSITION_NED", "VFR_HUD", "SERVO_OUTPUT_RAW", "SYS_STATUS", "SYSTEM_TIME"):
            peer.await_(name)
        assert peer.await_("EXTENDED_SYS_STATE").landed_state == 1
        seen, home = peer.await_("GLOBAL_POSITION_INT"), peer.await_("HOME_POSITION")
        assert (seen.lat, seen.lon, seen.alt) == (home.latitude, home.longitude, home.altitude)
        assert abs(seen.lat - 389_897_000) < 1000  # it begins within a few metres of its world's origin
        battery = peer.await_("BATTERY_STATUS")
        assert (set(battery.voltages), battery.battery_remaining) == ({0xFFFF}, -1)

        def read():
            peer.mav.param_request_read_send(1, 1, b"WV_MASS", -1)

        assert peer.await_("PARAM_VALUE", ask=read).param_value == pytest.approx(2.6)
        changed = peer.await_("PARAM_VALUE", ask=lambda: peer.mav.param_set_send(1, 1, b"WV_MASS", 2.8, 9))
        assert changed.param_value == pytest.approx(2.8)
        assert peer.command(SET_INTERVAL, 30, 100_000) == 0
        times = [peer.await_("ATTITUDE").time_boot_ms for _ in range(6)]
        assert times[-1] - times[0] < 6 * 250  # the vehicle's own clock: a loaded machine makes it no longer

        assert peer.command(SET_MODE, 1, MANUAL) == 0
        assert peer.await_("HEARTBEAT", lambda m: m.custom_mode == MANUAL)
        assert peer.command(SET_MODE, 1, GUIDED) == 0
        assert peer.command(ARM, 1) == 0
        assert peer.await_("HEARTBEAT", lambda m: m.base_mode & 128)
        assert peer.command(ARM, 0) == 0
        assert peer.await_("HEARTBEAT", lambda m: not m.base_mode & 128)
        report = vehicle.stop()
        assert report["released_s"] is not None
        assert report["wire"]["wrong_signature"] == report["wire"]["unsigned"] == 0
        peer.close()


def test_unsupported_requests_are_refused_and_log_is_readable(tmp_path, monkeypatch):
    """The log of the running vehicle is read with pymavlink's client over the signed link."""
    mavftp, mavutil = (pytest.importorskip(f"pymavlink.{name}") for name in ("mavftp", "mavutil"))
    monkeypatch.setenv("MAVLINK20", "1")
    out = tmp_path / "out"
    kept = tmp_path / "kept.json"
    with served(tmp_path, "--out", str(out), "--parameters", str(kept)) as vehicle:
        peer = Peer(vehicle.port, vehicle.passphrase)
        peer.await_("HEARTBEAT")
        for kind in (0, 1, 2):
            count = peer.await_("MISSION_COUNT", ask=lambda kind=kind: peer.mav.mission_request_list_send(1, 1, kind))
            assert (count.count, count.mission_type) == (0, kind)
        for number in (REBOOT, TAKEOFF):
            assert peer.command(number, 1) == UNSUPPORTED
        mass = peer.await_("PARAM_VALUE", ask=lambda: peer.mav.param_set_send(1, 1, b"WV_MASS", 2.75, 9))
        assert mass.param_value == 2.75
        assert peer.command(STORAGE, 1) == 0
        assert json.loads(kept.read_text())["parameters"] == {"world.vehicle.mass": 2.75}
        entry = peer.await_("LOG_ENTRY", ask=lambda: peer.mav.log_request_list_send(1, 1, 0, 0xFFFF))
        assert entry.num_logs == 2  # vehicle.mcap, outputs.txt
        peer.close()
        master = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{vehicle.port}", source_system=254, source_component=190, dialect="common"
        )
        master.setup_signing(hashlib.sha256(vehicle.passphrase.encode()).digest(), sign_outgoing=True)
        got = mavftp.MAVFTP(master, 1, 1).read("/logs/vehicle.mcap", 1 << 30)
        master.close()
        report = vehicle.stop()
    whole = (out / "vehicle.mcap").read_bytes()
    assert len(got) > 10_000
    assert whole.startswith(got)
    assert report["wire"]["wrong_signature"] == report["wire"]["unsigned"] == 0


def test_station_without_the_key_is_ignored_and_unanswered(tmp_path):
    with served(tmp_path) as vehicle:
        port = vehicle.port
        for passphrase in (None, "a-passphrase-that-is-another"):
            stranger = Peer(port, passphrase)
            stranger.attack()
            assert stranger.bytes_heard == 0
            stranger.close()
        friend = Peer(port, vehicle.passphrase)
        assert friend.command(ARM, 1) == 0
        assert friend.command(ARM, 0) == 0
        captured = list(friend.sent)
        replayer = Peer(port)
        for packet in captured:
            replayer.send(packet)
        replayer.attack()
        assert replayer.bytes_heard == 0
        assert not friend.await_("HEARTBEAT", ask=lambda: None).base_mode & 128
        assert friend.await_("HEARTBEAT").custom_mode == GUIDED
        read = friend.await_("PARAM_VALUE", ask=lambda: friend.mav.param_request_read_send(1, 1, b"WV_MASS", -1))
        assert read.param_value == pytest.approx(2.6)
        for peer in (replayer, friend):
            peer.close()
        refused = vehicle.stop()["wire"]
        assert refused["unsigned"] > 20
        assert refused["wrong_signature"] > 20
        assert refused["replayed"] >= len(captured)
