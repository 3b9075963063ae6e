from hypothesis import given
from hypothesis import strategies as st
from wire.line import bit_by_bit

from trimtab.wire.checksum import checksum, crc


def test_published_check_value():
    """The catalogue of parametrised CRC algorithms: CRC-16/MCRF4XX of "123456789" is 0x6F91."""
    assert crc(b"123456789") == 0x6F91 == bit_by_bit(b"123456789")


@given(st.binary(max_size=300), st.integers(0, 255))
def test_equals_the_definition_bit_by_bit(data, extra):
    assert crc(data) == bit_by_bit(data)
    assert checksum(data, extra) == bit_by_bit(data + bytes([extra])).to_bytes(2, "little")
