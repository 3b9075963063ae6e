"""Reader of MCAP files with JSON or ROS 2 messages, and of ROS bags (rosbag2 folders, and .bag files of ROS 1).

Columns have the names of the message fields, e.g. ``angular_velocity.x``. Array elements have an index.
``header.stamp`` is a single number in ns. ``log_time`` is the time at which the message was recorded (ns).
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.core.errors import InputError
from trimtab.logs.foreign.tables import (
    LOG_TIME,
    Table,
    TopicSummary,
    flatten_message,
    import_package,
    name_file,
    refuse_damage,
    refuse_topic,
    stack_messages,
    summarise_rows,
)

Decode = Callable[[bytes], Any]
Message = tuple[str, int, Decode | None, bytes]
"""Message in a file: topic, time (ns), decoder of the message or None, and bytes of the message."""
LISTED = 20
"""Number of messages of a topic that are decoded to list the fields of the topic."""


def list_mcap(path: Path) -> list[TopicSummary]:
    """List every topic of an MCAP file. Topics in encodings that are not supported have no fields."""
    return _summarise_messages(_read_all(path, "MCAP", _mcap_messages(path, None), LISTED))


def read_mcap_topics(path: Path, topics: Iterable[str]) -> dict[str, Table]:
    """Read the tables of the named topics from an MCAP file.

    Raises:
        InputError: a topic is unknown, its messages are neither JSON nor CDR, or the file is damaged.
    """
    wanted = set(topics)
    grouped = _read_all(path, "MCAP", _mcap_messages(path, wanted))
    return _stack_topics(path, wanted, grouped, list_mcap)


def list_bag(path: Path) -> list[TopicSummary]:
    """List every topic of a ROS bag."""
    return _summarise_messages(_read_all(path, "a ROS bag", _bag_messages(path, None), LISTED))


def read_bag(path: Path, topics: Iterable[str]) -> dict[str, Table]:
    """Read the tables of the named topics from a ROS bag.

    Raises:
        InputError: a topic is unknown, its message type has no definition, or the bag is damaged.
    """
    wanted = set(topics)
    return _stack_topics(path, wanted, _read_all(path, "a ROS bag", _bag_messages(path, wanted)), list_bag)


def _read_all(
    path: Path, kind: str, messages: Iterator[Message], most: int | None = None
) -> dict[str, list[tuple[int, Any]]]:
    """Return the topic -> time and content of each message.

    The content is None for messages after the first `most` of a topic, and for a message that can't be decoded.
    """
    grouped: dict[str, list[tuple[int, Any]]] = {}
    try:
        for topic, time, decode, data in messages:
            several = grouped.setdefault(topic, [])
            if decode is None or (most is not None and len(several) >= most):
                several.append((time, None))
            else:
                several.append((time, dict(flatten_message(decode(data)))))
    except InputError:
        raise
    except Exception as error:  # damaged bytes may raise any error; the error must name the file
        refuse_damage(name_file(path), kind, error)
    return grouped


def _summarise_messages(grouped: Mapping[str, list[tuple[int, Any]]]) -> list[TopicSummary]:
    found = []
    for topic, messages in sorted(grouped.items()):
        names = list(dict.fromkeys(name for _, flat in messages if flat for name in flat))
        fields = [*names, LOG_TIME] if names else []
        first = messages[0][0]
        found.append(summarise_rows(topic, fields, [(time - first) * 1e-9 for time, _ in messages]))
    return found


def _stack_topics(
    path: Path, wanted: set[str], grouped: dict[str, list[tuple[int, Any]]], list_all: Callable[[Path], Any]
) -> dict[str, Table]:
    tables = {}
    for topic in wanted:
        if topic not in grouped:
            refuse_topic(name_file(path), topic, [summary.name for summary in list_all(path)])
        times = [time for time, _ in grouped[topic]]
        messages = [flat for _, flat in grouped[topic]]
        if any(flat is None for flat in messages):
            problem = "the messages are neither JSON nor ROS 2 CDR with a schema"
            fix = "convert the file, e.g. with  ros2 bag convert, or to CSV"
            raise InputError(f"{name_file(path)}, topic {topic!r}", problem, fix=fix)
        tables[topic] = stack_messages(name_file(path), topic, messages, times)
    return tables


def _mcap_messages(path: Path, topics: set[str] | None) -> Iterator[Message]:
    """Yield the messages of an MCAP file in the order of the file, so that no index is needed (e.g. after a crash)."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader

    decoders: dict[int, Decode | None] = {}
    with open(path, "rb") as stream:
        messages = NonSeekingReader(stream).iter_messages(topics=topics, log_time_order=False)
        while True:
            try:
                schema, channel, message = next(messages)
            except (StopIteration, EndOfFile):
                return
            if channel.id not in decoders:
                decoders[channel.id] = _find_decoder(path, channel.message_encoding, schema)
            yield channel.topic, message.log_time, decoders[channel.id], message.data


def _find_decoder(path: Path, encoding: str, schema: Any) -> Decode | None:
    if encoding == "json":
        return json.loads
    if encoding != "cdr" or schema is None or schema.encoding not in ("ros2msg", "ros2idl"):
        return None
    return _cdr_decoder(path, schema.name, schema.encoding, schema.data.decode("utf-8"))


def _cdr_decoder(path: Path, name: str, form: str, text: str) -> Decode | None:
    """Return a decoder for ROS 2 messages of a type, or None if the definition of the type is unknown.

    Args:
        path: path of the file, for errors.
        name: name of the message type.
        form: format of the definition, ``ros2msg`` or ``ros2idl``. Any other text: the file has no definition.
        text: text of the definition. If the file has no definition, the type of ROS 2 Humble is used.
    """
    typesys = import_package(name_file(path), "rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    try:
        if form == "ros2msg":
            types = typesys.get_types_from_msg(text, name)
        else:
            types = typesys.get_types_from_idl(text) if form == "ros2idl" else {}
        store.register({n: t for n, t in types.items() if n == name or n not in store.types})
    except typesys.TypesysError:
        return None
    return (lambda data: store.deserialize_cdr(data, name)) if name in store.types else None


def _bag_messages(path: Path, topics: set[str] | None) -> Iterator[Message]:
    """Yield the messages of a rosbag2 folder, or of a .bag file of ROS 1."""
    if path.is_dir():
        rosbag2 = import_package(name_file(path), "rosbags.rosbag2")
        with rosbag2.Reader(path) as reader:
            decoders: dict[int, Decode | None] = {}
            for c in reader.connections:
                form = {"MSG": "ros2msg", "IDL": "ros2idl"}.get(c.msgdef.format.name, "")
                decoders[c.id] = _cdr_decoder(path, c.msgtype, form, c.msgdef.data)
            for connection, time, data in _choose_messages(reader, topics):
                yield connection.topic, time, decoders[connection.id], data
        return
    highlevel = import_package(name_file(path), "rosbags.highlevel")
    with highlevel.AnyReader([path]) as reader:
        for connection, time, data in _choose_messages(reader, topics):
            yield connection.topic, time, partial(reader.deserialize, typ=connection.msgtype), data


def _choose_messages(reader: Any, topics: set[str] | None) -> Iterator[tuple[Any, int, bytes]]:
    chosen = [c for c in reader.connections if topics is None or c.topic in topics]
    return reader.messages(connections=chosen) if chosen else iter(())
