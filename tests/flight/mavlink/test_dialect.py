import numpy as np
import pytest
from flight.mavlink.line import every, sample

from trimtab.core.errors import InputError
from trimtab.core.signals import Command, Frame
from trimtab.flight.mavlink.definitions import MAX_PAYLOAD
from trimtab.flight.mavlink.dialect import FIRST_ID, derive_dialect


def test_each_field_is_carried_once_and_every_payload_fits(dialect):
    assert dialect.groups["samples.every"] == ("SAMPLE_EVERY",)
    assert dialect.groups["command"] == ("COMMAND",)
    assert dialect.groups["instant"] == ("INSTANT",)
    assert dialect.groups["samples.double-wide"] == (
        "SAMPLE_DOUBLE_WIDE_1",
        "SAMPLE_DOUBLE_WIDE_2",
        "SAMPLE_DOUBLE_WIDE_3",
    )
    places = [p for name in dialect.groups["samples.double-wide"] for p in dialect.places[name]]
    values = [(p.path, p.slot) for p in places if ".value." in p.path]
    assert len(values) == len(set(values)) == 72 + 5 + 9
    assert {slot for path, slot in values if path.endswith("covariance")} == set(range(72))
    for name, own in dialect.places.items():
        assert dialect.definitions[name].size <= MAX_PAYLOAD
        assert len(own) + (name == "COMMAND") == len(dialect.definitions[name].ranges)  # who sends it is no leaf
        if name != "INSTANT":
            assert {p.path.rsplit(".", 1)[-1] for p in own} >= {"t", "valid"}


def test_types_follow_the_kinds_of_the_quantities(dialect):
    kinds = {p.path.rsplit(".", 1)[-1]: p.type for p in dialect.places["SAMPLE_EVERY"]}
    reals = dict.fromkeys(("real", "angle", "vector"), "double")
    wholes = {"time": "int64_t", "t": "int64_t", "count": "int32_t", "word": "uint32_t"}
    assert kinds == reals | wholes | {"flag": "uint8_t", "valid": "uint8_t"}


def test_unit_and_doc_go_into_the_xml(dialect):
    assert 'name="real" units="m/s">' in dialect.text
    assert "A speed; it costs &lt; 5 &amp; 'more' * / '." in dialect.text


def test_message_ids_are_reserved_and_sorted_by_name(dialect):
    derived = sorted(dialect.places)
    assert [dialect.definitions[n].id for n in derived] == list(range(FIRST_ID, FIRST_ID + len(derived)))
    common = pytest.importorskip("pymavlink.dialects.v20.all")
    assert not set(range(FIRST_ID, FIRST_ID + 256)) & common.mavlink_map.keys()


def test_fingerprint_differs_between_dialects_and_is_reproducible(dialect):
    frame = Frame(t=np.int64(0), samples={"every": sample(every())})
    command = Command(t=np.int64(0), valid=False, value=every())
    a, b = derive_dialect(frame, command), derive_dialect(frame, command)
    assert a.fingerprint == b.fingerprint != dialect.fingerprint
    assert a.text == b.text
    assert len(a.fingerprint) == 8


def test_fingerprint_ignores_descriptions_and_covers_units(dialect):
    described = dialect.text.replace("A speed;", "A fast speed;", 1)
    measured = dialect.text.replace('"m/s"', '"cm/s"', 1)
    assert described != dialect.text != measured
    assert dialect._replace(text=described).fingerprint == dialect.fingerprint
    assert dialect._replace(text=measured).fingerprint != dialect.fingerprint


def test_sensors_with_similar_names_get_distinct_messages():
    frame = Frame(t=np.int64(0), samples={n: sample(every()) for n in ("a-b", "a_b", "A b", "9")})
    made = derive_dialect(frame, Command(t=np.int64(0), valid=False, value=every()))
    names = [made.groups[f"samples.{n}"][0] for n in ("a-b", "a_b", "A b", "9")]
    assert len(set(names)) == 4
    assert all(n.isascii() and n.isidentifier() and n == n.upper() for n in names)


def test_rejects_more_messages_than_available_ids():
    frame = Frame(t=np.int64(0), samples={f"s{k}": sample(every()) for k in range(255)})
    with pytest.raises(InputError, match="257 messages"):
        derive_dialect(frame, Command(t=np.int64(0), valid=False, value=every()))
