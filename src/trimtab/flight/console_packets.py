"""Format of the packets between a flight and its console: a letter for the type of packet, then the content.

After the letter ROW follow the header HEAD and a float32 for each signal. The console passes them to the page
unchanged. After the letter TEXT follows a JSON object.
Source: docs page, Protocol of the console.
"""

import struct

from trimtab.core.time import ms, seconds

ROW, TEXT = b"r", b"j"
ROW_PERIOD = ms(20)
HEAD = struct.Struct("<dd")
"""Format of the header of a row: time of the flight (s) and monotonic time of the sender (s)."""
LARGEST_PACKET = 65536
LONGEST_VECTOR = 12
"""Maximum number of elements of a signal that the page shows. Longer signals, e.g. a covariance, are left out."""
END_SILENCE = seconds(3)
"""Time without data from the stick in use after which the flight ends and another pilot may take the stick."""
