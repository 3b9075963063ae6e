import struct

import pytest

from trimtab.flight.mavlink.definitions import read_definitions
from trimtab.flight.mavlink.dialect import STANDARD

common = pytest.importorskip("pymavlink.dialects.v20.common")
XML = """<mavlink><version>3</version><messages><message id="7" name="ODD"><description>x</description>
<field type="uint8_t" name="a"/><field type="double[2]" name="b"/><field type="char[5]" name="c"/>
<field type="uint16_t" name="d" units="cm"/><extensions/><field type="int64_t" name="e"/></message></messages>
</mavlink>"""


def test_standard_messages_match_pymavlinks_common_dialect():
    """Number, CRC_EXTRA, layout and field names, against pymavlink's own."""
    found = read_definitions(STANDARD.read_text("utf-8"))
    assert {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG", "PARAM_SET", "MANUAL_CONTROL", "STATUSTEXT"} <= found.keys()
    metadata = found.pop("COMPONENT_METADATA")  # which pymavlink's dialects lack
    assert (metadata.id, metadata.crc_extra, metadata.size) == (397, 182, 108)
    for name, definition in found.items():
        theirs = common.mavlink_map[definition.id]
        assert theirs.msgname == name
        assert theirs.crc_extra == definition.crc_extra, name
        assert theirs.unpacker.format.replace("c", "s") == definition.packing.format.replace("1s", "s"), name
        assert list(theirs.ordered_fieldnames) == [f.name for f in definition.fields], name


def test_heartbeat_definition_matches_published_numbers():
    """https://mavlink.io/en/messages/common.html: number 0, CRC_EXTRA 50, nine bytes, version 3."""
    heartbeat = read_definitions(STANDARD.read_text("utf-8"))["HEARTBEAT"]
    assert (heartbeat.id, heartbeat.crc_extra, heartbeat.size) == (0, 50, 9)
    assert heartbeat.where["mavlink_version"].default == 3
    assert heartbeat.fields[0].name == "custom_mode"


def test_field_order_sizes_and_ranges_follow_the_definition():
    odd = read_definitions(XML)["ODD"]
    assert [f.name for f in odd.fields] == ["b", "d", "a", "c", "e"]  # by size, as declared, extensions last
    assert odd.packing.format == "<2dHB5sq"
    assert (odd.size, odd.base) == (struct.calcsize("<2dHB5sq"), struct.calcsize("<2dHB5s"))
    assert odd.blank_values == [0, 0, 0, 0, b"", 0]
    assert odd.ranges == (None, None, (0, 65535), (0, 255), None, (-(2**63), 2**63 - 1))
    assert [f.at for f in odd.fields] == [0, 2, 3, 4, 5]


def test_crc_extra_depends_on_names_types_and_lengths():
    base = read_definitions(XML)["ODD"].crc_extra
    for old, new in (("ODD", "ODE"), ('"a"', '"z"'), ("double[2]", "double[3]"), ("uint16_t", "int16_t")):
        assert next(iter(read_definitions(XML.replace(old, new)).values())).crc_extra != base
    assert read_definitions(XML.replace('"int64_t" name="e"', '"int8_t" name="x"'))["ODD"].crc_extra == base
