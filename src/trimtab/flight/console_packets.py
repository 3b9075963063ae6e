"""Packets between a flight and its console: a letter for the kind of packet, then the content.

The letter ROW is followed by a row as the page receives it: HEAD, then a float32 for each signal. The letter TEXT is
followed by a JSON object.
Source: docs page, Protocol of the console.
"""

import struct

from trimtab.core.time import ms, seconds

ROW, TEXT = b"r", b"j"
ROW_PERIOD = ms(20)
HEAD = struct.Struct("<dd")
"""Header of a row: time of the flight and monotonic time of the sender (s)."""
LARGEST_PACKET = 65536
LONGEST_VECTOR = 12
"""Maximum number of elements of a signal that is shown. Longer signals, such as a covariance, are left out."""
END_SILENCE = seconds(3)
"""Time without data from the stick in use, after which the flight ends and another pilot may take the stick."""
