"""Small logs of PX4 and ArduPilot as bytes, written after the formats' own descriptions; and mappings to read them.

ULog: PX4 user guide, "ULog File Format". BIN: ArduPilot, "Logger" library, FMT messages.
"""

import struct

import numpy as np

from trimtab.logs.foreign.mapping import parse_mapping

DEG = np.pi / 180
RATES = "value.angular_rate"
ULOG_TYPES = {"uint64_t": "Q", "float": "f", "double": "d", "int32_t": "i", "uint8_t": "B"}


def ulog_record(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog_bytes(topics):
    """topics: name or (name, instance) -> (format, rows), a format as in "uint64_t timestamp;float[3] gyro;"."""
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), ulog_record("B", bytes(40))]
    names = {key if isinstance(key, str) else key[0]: form for key, (form, _) in topics.items()}
    out += [ulog_record("F", f"{name}:{form}".encode()) for name, form in names.items()]
    rows = []
    for i, (key, (form, values)) in enumerate(topics.items()):
        name, instance = (key, 0) if isinstance(key, str) else key
        out.append(ulog_record("A", struct.pack("<BH", instance, i) + name.encode()))
        packed = "<"
        for part in form.rstrip(";").split(";"):
            kind, _, size = part.split(" ")[0].partition("[")
            packed += size.rstrip("]") + ULOG_TYPES[kind]
        rows += [ulog_record("D", struct.pack("<H", i) + struct.pack(packed, *row)) for row in values]
    return b"".join(out + rows)


def bin_bytes(types):
    """types: name -> (format characters, columns, rows)."""
    head, sizes = b"\xa3\x95", {"Q": 8, "B": 1, "f": 4, "c": 2}
    codes = {"Q": "Q", "B": "B", "f": "f", "c": "h"}
    out = []

    def define(number, length, name, form, columns):
        words = name.encode(), form.encode(), ",".join(columns).encode()
        out.append(head + b"\x80" + struct.pack("<BB4s16s64s", number, length, *words))

    define(0x80, 89, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
    for i, (name, (form, columns, _)) in enumerate(types.items()):
        define(10 + i, 3 + sum(sizes[c] for c in form), name, form, columns)
    for i, (form, _, rows) in enumerate(types.values()):
        packed = "<" + "".join(codes[c] for c in form)
        out += [head + bytes([10 + i]) + struct.pack(packed, *row) for row in rows]
    return b"".join(out)


def mapping(topic="", truth=None, **fields):
    """Of a sensor imu; `topic` a name or the whole section."""
    section = {"topic": topic} if isinstance(topic, str) else dict(topic)
    return parse_mapping({"sensor": {"imu": section | {"fields": fields}}} | ({"truth": truth} if truth else {}))


def gyro(names, unit="rad/s", **more):
    return {"from": names, "unit": unit, **more}


GYRO = gyro(["gyro[0]", "gyro[1]", "gyro[2]"])
