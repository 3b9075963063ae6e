"""Log download by MAVLink's log messages, which most ground stations use: first the list of logs, then a log in
messages of 90 bytes.

Logs are never erased over a link. While the vehicle is armed, no log can be read, as in `file_transfer`.
Source: https://mavlink.io/en/messages/common.html, LOG_REQUEST_LIST and after.
"""

from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.served_files import LOGS, FileEntry, OpenFile, Pace, ServedFiles

PIECE = 90
MOST_LOGS = 1000


class _Download(NamedTuple):
    log: int
    file: OpenFile
    offset: int
    end: int


class LogService:
    """Log download service of a vehicle. Times `now` are by the vehicle's clock, in 100 ns."""

    names: Collection[str] = ("LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_ERASE", "LOG_REQUEST_END")

    def __init__(self, endpoint: Endpoint, files: ServedFiles, rate: float) -> None:
        """rate: maximum rate of the download (byte/s)."""
        self._endpoint, self._files, self._pace = endpoint, files, Pace(rate)
        self._entries: deque[tuple[int, FileEntry]] = deque()
        self._count = 0
        self._names: dict[int, str] = {}
        self._download: _Download | None = None

    def answer(self, message: Message, now: int, *, is_armed: bool) -> list[bytes]:
        """Return the immediate answer to a message. The method `due` returns the entries of a list and the bytes of a
        log later."""
        if message.name == "LOG_REQUEST_LIST":
            return self._start_list(message.get("start"), message.get("end"), is_armed)
        if message.name == "LOG_REQUEST_DATA":
            return self._start_download(message, is_armed)
        if message.name == "LOG_ERASE":
            fields = {"severity": 4, "text": "Logs are not erased over the link"}
            return [self._endpoint.pack("STATUSTEXT", fields)]
        self._close()
        return []

    def due(self, now: int, *, is_armed: bool) -> list[bytes]:
        """Return a packet with the next entry of a list or the next bytes of a log if it is due, otherwise an empty
        list."""
        if not self._pace.is_due(now):
            return []
        if self._entries:
            packet = self._entry_packet(*self._entries.popleft())
        elif self._download is not None:
            if is_armed:
                self._close()
                return []
            packet = self._next_piece(self._download)
        else:
            return []
        self._pace.count(len(packet), now, is_armed=is_armed)
        return [packet]

    def _list_logs(self, is_armed: bool) -> list[tuple[int, FileEntry]]:
        logs = list(enumerate(self._files.list_logs(is_armed=is_armed)[:MOST_LOGS], 1))
        self._names, self._count = {number: entry.name for number, entry in logs}, len(logs)
        return logs

    def _start_list(self, first: int, last: int, is_armed: bool) -> list[bytes]:
        logs = self._list_logs(is_armed)
        self._entries = deque((n, entry) for n, entry in logs if first <= n <= last)
        return [] if self._entries else [self._entry_packet(0, FileEntry("", 0))]

    def _entry_packet(self, number: int, entry: FileEntry) -> bytes:
        fields = {"id": number, "num_logs": self._count, "last_log_num": self._count}
        return self._endpoint.pack("LOG_ENTRY", fields | {"time_utc": entry.time, "size": entry.size})

    def _start_download(self, message: Message, is_armed: bool) -> list[bytes]:
        log, offset, count = (message.get(name) for name in ("id", "ofs", "count"))
        if self._download is None or self._download.log != log:
            self._close()
            if log not in self._names:  # some stations request a log without a list, or after a restart of the vehicle
                self._list_logs(is_armed)
            file = None if is_armed else self._files.open(f"{LOGS}/{self._names.get(log, '')}")
            if file is None:
                return [self._endpoint.pack("LOG_DATA", {"id": log, "ofs": offset})]
            self._download = _Download(log, file, 0, 0)
        self._download = self._download._replace(offset=offset, end=offset + count)
        return []

    def _next_piece(self, download: _Download) -> bytes:
        """Return the next packet of a download. A packet with fewer than 90 bytes marks the end of the log."""
        data = download.file.read(download.offset, min(PIECE, download.end - download.offset))
        end = download.offset + len(data)
        if len(data) < PIECE or end >= download.end:
            self._close()
        else:
            self._download = download._replace(offset=end)
        fields = {"id": download.log, "ofs": download.offset, "count": len(data)}
        return self._endpoint.pack("LOG_DATA", fields | {"data": tuple(data.ljust(PIECE, b"\0"))})

    def _close(self) -> None:
        if self._download is not None:
            self._download.file.close()
            self._download = None
