"""Packets between a flight and its console: one letter, and the content.

ROW and a row as the page gets it (HEAD, then a float32 for each signal), or TEXT and a JSON object.
Source: docs page, Protocol of the console.
"""

import struct

from trimtab.core.time import ms, seconds

ROW, TEXT = b"r", b"j"
ROW_PERIOD = ms(20)
HEAD = struct.Struct("<dd")
"""Head of a row: time and clock (s)."""
LARGEST_PACKET = 65536
LONGEST_VECTOR = 12
"""Longest signal that is shown. A longer one, such as a covariance, is not."""
END_SILENCE = seconds(3)
"""Silence of a stick that a pilot holds, after which the flight is ended and the stick is free."""
