"""Read-only file transfer over MAVLink: listing, opening, reading, reading in bursts. Other operations are refused.

A request and its answer are 251 bytes in FILE_TRANSFER_PROTOCOL:

    number (2)  session (1)  operation (1)  size (1)  requested operation (1)  end of burst (1)  0 (1)  offset (4)  data

If an answer was lost and the request is repeated, the service sends the same answer again. Logs can be read only while
the vehicle is disarmed, because a disk may delay the vehicle's program, and the flight needs the link.
Source: https://mavlink.io/en/services/ftp.html.
"""

import struct
from collections.abc import Collection
from enum import IntEnum
from typing import NamedTuple

from trimtab.core.time import seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.served_files import OpenFile, Pace, ServedFiles

FILE_TRANSFER = "FILE_TRANSFER_PROTOCOL"
HEAD, PAYLOAD = struct.Struct("<HBBBBBBI"), 251
MOST_DATA = PAYLOAD - HEAD.size
MOST_SESSIONS = 4
IDLE_TIME = seconds(30)
"""Time (100 ns) without a request after which a new session may replace an open session."""
LONGEST_BURST = 200
"""Maximum number of packets in a burst. The reader must then send a new request, so that a burst ends if the reader is
gone."""


class Operation(IntEnum):
    """Codes of requested operations, and of the answers ACK (done) and NAK (refused)."""

    NONE = 0
    TERMINATE = 1
    RESET = 2
    LIST = 3
    OPEN_READ = 4
    READ = 5
    BURST_READ = 15
    ACK = 128
    NAK = 129


WRITING = range(6, 15)
"""Codes of refused operations, which would write, remove or rename files, or read a complete file for its checksum."""


class FileError(IntEnum):
    """Error codes of a refused file request."""

    FAIL = 1
    INVALID_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSION = 5
    END_OF_FILE = 6
    UNKNOWN = 7
    PROTECTED = 9
    NOT_FOUND = 10


class _Request(NamedTuple):
    number: int
    session: int
    operation: int
    size: int
    offset: int
    data: bytes


class _Session(NamedTuple):
    owner: tuple[int, int]
    file: OpenFile
    time: int


class _Burst(NamedTuple):
    """State of a burst of file data that is being sent.

    number: sequence number of the next packet.  left: number of packets that are still to be sent.
    """

    owner: tuple[int, int]
    session: int
    number: int
    offset: int
    size: int
    left: int


class _RefusedError(Exception):
    """Exception for a file request that is refused."""

    def __init__(self, why: FileError) -> None:
        super().__init__(why.name)
        self.why = why


class FileTransferService:
    """File transfer service of a vehicle. Times `now` are by the vehicle's clock, in 100 ns."""

    names: Collection[str] = (FILE_TRANSFER,)

    def __init__(self, endpoint: Endpoint, files: ServedFiles, rate: float) -> None:
        """rate: maximum rate of the transfer (byte/s)."""
        self._endpoint, self._files, self._pace = endpoint, files, Pace(rate)
        self._sessions: dict[int, _Session] = {}
        self._burst: _Burst | None = None
        self._answers: dict[tuple[int, int], tuple[bytes, list[bytes]]] = {}

    def answer(self, message: Message, now: int, *, is_armed: bool) -> list[bytes]:
        """Return the packets that answer a request. The method `due` returns the packets of a burst later."""
        owner, payload = (message.system, message.component), bytes(message.get("payload"))
        last_payload, last_answer = self._answers.get(owner, (b"", []))
        if payload == last_payload:
            return [self._pack(owner, answer) for answer in last_answer]
        number, session, operation, size, _, _, _, offset = HEAD.unpack_from(payload)
        request = _Request(number, session, operation, size, offset, payload[HEAD.size : HEAD.size + size])
        try:
            data = self._follow(request, owner, now, is_armed)
            answers = [] if data is None else [_make_answer(request, Operation.ACK, data)]
            if operation == Operation.OPEN_READ and data is not None:
                opened = request._replace(session=data[0])
                answers = [_make_answer(opened, Operation.ACK, data[1:])]
        except _RefusedError as refused:
            answers = [_make_answer(request, Operation.NAK, bytes((refused.why,)))]
        if len(self._answers) >= MOST_SESSIONS:
            del self._answers[next(iter(self._answers))]
        self._answers[owner] = (b"" if operation == Operation.BURST_READ else payload), answers
        return [self._pack(owner, answer) for answer in answers]

    def due(self, now: int, *, is_armed: bool) -> list[bytes]:
        """Return the next packet of a burst if it is due, otherwise an empty list."""
        burst = self._burst
        if burst is None or not self._pace.is_due(now):
            return []
        session = self._sessions.get(burst.session)
        if session is None or (is_armed and session.file.is_log):
            self._burst = None
            return []
        self._sessions[burst.session] = session._replace(time=now)
        asked = _Request(burst.number, burst.session, Operation.BURST_READ, burst.size, burst.offset, b"")
        data = session.file.read(burst.offset, burst.size)
        end = burst.offset + len(data)
        is_last = burst.left == 1 or len(data) < burst.size or end >= session.file.size
        after = burst._replace(number=(burst.number + 1) & 0xFFFF, offset=end, left=burst.left - 1)
        self._burst = None if is_last else after
        if data:
            packet = self._pack(burst.owner, _make_answer(asked, Operation.ACK, data, is_last))
        else:
            packet = self._pack(burst.owner, _make_answer(asked, Operation.NAK, bytes((FileError.END_OF_FILE,))))
        self._pace.count(len(packet), now, is_armed=is_armed)
        return [packet]

    def _follow(self, request: _Request, owner: tuple[int, int], now: int, is_armed: bool) -> bytes | None:
        """Perform a file request. Return the data of the answer, or None if a burst of packets is the answer."""
        operation = request.operation
        if operation == Operation.NONE:
            return b""
        if operation == Operation.LIST:
            return self._list(request, is_armed)
        if operation == Operation.OPEN_READ:
            return self._open(request, owner, now, is_armed)
        if operation in (Operation.TERMINATE, Operation.RESET):
            is_all = operation == Operation.RESET
            for number, session in list(self._sessions.items()):
                if session.owner == owner and (is_all or number == request.session):
                    self._close(number)
            return b""
        if operation in WRITING:
            raise _RefusedError(FileError.PROTECTED)
        if operation not in (Operation.READ, Operation.BURST_READ):
            raise _RefusedError(FileError.UNKNOWN)
        return self._read(request, owner, now, is_armed)

    def _list(self, request: _Request, is_armed: bool) -> bytes:
        contents = self._files.list_folder(_path(request), is_armed=is_armed)
        if contents is None:
            raise _RefusedError(FileError.NOT_FOUND)
        folders, files = contents
        lines = [f"D{name}" for name in folders] + [f"F{file.name}\t{file.size}" for file in files]
        data = b""
        for line in lines[request.offset :]:
            entry = line.encode() + b"\0"
            if len(data) + len(entry) > MOST_DATA:
                break
            data += entry
        if not data:
            raise _RefusedError(FileError.END_OF_FILE)
        return data

    def _open(self, request: _Request, owner: tuple[int, int], now: int, is_armed: bool) -> bytes:
        free = next((n for n in range(MOST_SESSIONS) if n not in self._sessions), None)
        if free is None:
            free = min(self._sessions, key=lambda n: self._sessions[n].time)
            if now - self._sessions[free].time < IDLE_TIME:
                raise _RefusedError(FileError.NO_SESSION)
            self._close(free)
        if is_armed and not self._files.has_document(_path(request)):
            raise _RefusedError(FileError.FAIL)
        file = self._files.open(_path(request))
        if file is None:
            raise _RefusedError(FileError.NOT_FOUND)
        self._sessions[free] = _Session(owner, file, now)
        return bytes((free,)) + file.size.to_bytes(8, "little")[:4]

    def _read(self, request: _Request, owner: tuple[int, int], now: int, is_armed: bool) -> bytes | None:
        session = self._sessions.get(request.session)
        if session is None or session.owner != owner:
            raise _RefusedError(FileError.INVALID_SESSION)
        if is_armed and session.file.is_log:
            raise _RefusedError(FileError.FAIL)
        size = min(request.size or MOST_DATA, MOST_DATA)
        self._sessions[request.session] = session._replace(time=now)
        if request.operation == Operation.BURST_READ:
            self._burst = _Burst(owner, request.session, request.number, request.offset, size, LONGEST_BURST)
            return None
        data = session.file.read(request.offset, size)
        if not data:
            raise _RefusedError(FileError.END_OF_FILE)
        return data

    def _close(self, number: int) -> None:
        self._sessions.pop(number).file.close()
        if self._burst is not None and self._burst.session == number:
            self._burst = None

    def _pack(self, to: tuple[int, int], payload: bytes) -> bytes:
        fields = {"target_system": to[0], "target_component": to[1], "payload": tuple(payload)}
        return self._endpoint.pack(FILE_TRANSFER, fields)


def _make_answer(request: _Request, operation: Operation, data: bytes, is_last: bool = False) -> bytes:
    """Return the payload of a message that answers a file request."""
    asked, number = request.operation, (request.number + 1) & 0xFFFF
    head = HEAD.pack(number, request.session, operation, len(data), asked, is_last, 0, request.offset)
    return (head + data).ljust(PAYLOAD, b"\0")


def _path(request: _Request) -> str:
    return request.data.partition(b"\0")[0].decode("utf-8", "replace")
