"""Packets between a flight and its console: one letter, and what it holds.

ROW and a row as the page gets it (HEAD, then a float32 for each signal), or TEXT and a JSON object.
Source: docs page, Protocol of the console.
"""

import struct

from trimtab.core.time import ms, seconds

ROW, TEXT = b"r", b"j"
ROW_PERIOD = ms(20)
HEAD = struct.Struct("<dd")
"""Of a row: time and clock (s)."""
LARGEST_PACKET = 65536
LONGEST_VECTOR = 12
"""A signal of more numbers, a covariance say, is not shown."""
END_SILENCE = seconds(3)
"""Of a stick that somebody has, after which the flight is ended, and nobody has it."""
