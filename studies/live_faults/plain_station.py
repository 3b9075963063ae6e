"""Test of a vehicle with a ground station without trimtab: MAVLink's own library and a socket."""

import importlib.util
import socket
from collections import Counter
from pathlib import Path
from time import monotonic
from typing import Any

from studies.live_faults.flight import NAME
from studies.live_faults.process import Process

LISTEN_S, ASK_S = 6.0, 0.7
BEAT_S = 0.5
STATION, PLANNER = 255, 190
REQUEST_MESSAGE, HOME = 512, 242
LIST_DIRECTORY = 3
WANTED = {
    "global position": ("GLOBAL_POSITION_INT",),
    "home": ("HOME_POSITION",),
    "battery": ("BATTERY_STATUS",),
    "missions": ("MISSION_COUNT", "MISSION_ACK"),
    "logs": ("LOG_ENTRY",),
    "files": ("FILE_TRANSFER_PROTOCOL",),
    "hash of parameters": ("_HASH_CHECK",),
}
"""Features the station looks for, and the messages that provide them."""
YEAR_2020_NS = 1_577_836_800 * 10**9


def explain_no_station() -> str:
    """Return the reason why this station cannot run on this machine, or an empty text."""
    return "" if importlib.util.find_spec("pymavlink") else "pymavlink is not installed"


class PlainStation:
    """Station over datagrams, unsigned, that counts the received messages."""

    def __init__(self, port: int) -> None:
        from pymavlink.dialects.v20 import common

        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(0.05)
        self.mavlink: Any = common.MAVLink(self, srcSystem=STATION, srcComponent=PLANNER)
        self.mavlink.robust_parsing = True
        self.heard: Counter[str] = Counter()

    def write(self, packet: bytes) -> None:
        """Send a packet. MAVLink's library calls this method."""
        self._socket.send(packet)

    def listen(self, seconds: float) -> None:
        """Count messages and parameters by name, and ask repeatedly."""
        end, ask, beat = monotonic() + seconds, 0.0, 0.0
        while monotonic() < end:
            if monotonic() > beat:
                beat = monotonic() + BEAT_S
                self.mavlink.heartbeat_send(6, 8, 0, 0, 0)
            if monotonic() > ask:
                ask = monotonic() + ASK_S
                self._ask()
            try:
                packet = self._socket.recv(65535)
            except TimeoutError:
                continue
            for message in self.mavlink.parse_buffer(packet) or []:
                kind = message.get_type()
                self.heard[message.param_id if kind == "PARAM_VALUE" else kind] += 1

    def _ask(self) -> None:
        to = 1, 1
        self.mavlink.mission_request_list_send(*to)
        self.mavlink.log_request_list_send(*to, 0, 0xFFFF)
        payload = bytes([0, 0, 0, LIST_DIRECTORY, 1, 0, 0, 0, 0, 0, 0, 0]) + b"/"
        self.mavlink.file_transfer_protocol_send(0, *to, payload.ljust(251, b"\0"))
        self.mavlink.param_request_read_send(*to, b"_HASH_CHECK", -1)
        self.mavlink.command_long_send(*to, REQUEST_MESSAGE, 0, HOME, 0, 0, 0, 0, 0, 0)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def join_as_station(folder: Path) -> tuple[list[str], list[str]]:
    """Join a held vehicle as a station, ask for all known features, and count messages that are not meant for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    line = ("--listen", f"udp://127.0.0.1:{port}", "--unsigned", "--origin", "38.9897,-76.9378,20")
    words = ("vehicle", NAME, *line, "--out", str(folder / "log"))
    vehicle = Process(*words, folder=folder, name="vehicle", environment={"TRIMTAB_CONFIG": str(folder / "config")})
    try:
        vehicle.wait_for("listens on")
        station = PlainStation(port)
        station.listen(LISTEN_S)
        station.close()
        vehicle.send(2)
        vehicle.finish()
    finally:
        if vehicle.status is None:
            vehicle.kill()
    heard = station.heard
    problems = [f"no {what}" for what, names in WANTED.items() if not any(heard[name] for name in names)]
    private = sum(n for name, n in heard.items() if name.startswith("UNKNOWN_"))
    if private > 2 * LISTEN_S:
        problems.append(f"{private / LISTEN_S:.0f} private messages a second")
    seen = [what for what, names in WANTED.items() if any(heard[name] for name in names)]
    first, frames = _read_log_time(folder / "log" / "vehicle.mcap")
    if first < YEAR_2020_NS:
        problems.append(f"the log begins at {first * 1e-9:.1f} s")
    if not frames:
        problems.append("the log has no frames")
    return [f"there is {', '.join(seen) or 'nothing'}; {private / LISTEN_S:.1f} private messages a second"], problems


def _read_log_time(file: Path) -> tuple[int, list[str]]:
    """Return the time of the first message of a log (ns), and its topics of positions and frames."""
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        schemas = [] if summary is None else [s.name for s in summary.schemas.values()]
        first = next((message.log_time for _, _, message in reader.iter_messages()), 0)
    return first, [s for s in schemas if s.startswith("foxglove.")]
