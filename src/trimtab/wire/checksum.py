"""The checksum of MAVLink's frames: CRC-16/MCRF4XX, at the speed of the C library's CRC.

The standard library has the same polynomial without reflection (`binascii.crc_hqx`): bytes go in with their bits
reversed, and the result is reversed again.
Source: https://mavlink.io/en/guide/serialization.html, "Checksum"; R. N. Williams, "A painless guide to CRC error
detection algorithms", 1993, for reflection.
"""

from binascii import crc_hqx

START = 0xFFFF
REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(data: bytes, extra: int) -> bytes:
    """The two bytes that end a frame.

    Args:
        data: everything between the frame's first byte and the checksum.
        extra: CRC_EXTRA of the message, 0 to 255, which refuses a sender with another definition of it.
    """
    return crc_hqx((data + bytes((extra,))).translate(REVERSED), START).to_bytes(2, "big").translate(REVERSED)


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX of data, 0 to 65535."""
    return int.from_bytes(crc_hqx(data.translate(REVERSED), START).to_bytes(2, "big").translate(REVERSED), "little")
