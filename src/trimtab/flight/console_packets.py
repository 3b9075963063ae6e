"""Packets between a flight and its console: a letter for the kind of packet, then the content.

A packet is ROW and a row as sent to the page (HEAD, then a float32 for each signal), or TEXT and a JSON object.
Source: docs page, Protocol of the console.
"""

import struct

from trimtab.core.time import ms, seconds

ROW, TEXT = b"r", b"j"
ROW_PERIOD = ms(20)
HEAD = struct.Struct("<dd")
"""Head of a row: time of the flight and monotonic time of the sender (s)."""
LARGEST_PACKET = 65536
LONGEST_VECTOR = 12
"""Maximum number of elements of a signal that is shown. Longer signals, such as a covariance, are left out."""
END_SILENCE = seconds(3)
"""Time without data from a stick in use, after which the flight is ended and another pilot may take the stick."""
