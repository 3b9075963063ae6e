"""How many frames of a sender never came, by the gaps in its sequence numbers; none where the numbers mean nothing.

A gap counts once frames have come in order after it: CONFIRMING in a row, each at most SMALL_GAP numbers on. A sender
whose numbers jump about (at random, or two programs with one identity) never gives these; its gaps are no losses, and
its frames are counted as disordered. A frame that comes late takes back the loss that it was counted as.
Source: https://mavlink.io/en/guide/serialization.html, packet sequence.
"""

CONFIRMING = 6
SMALL_GAP = 32
"""One random number in eight follows the last within so many; six in a row do once in 200 000."""
MOST_JUMPS = 3
"""Jumps that are not confirmed, after which what was gathered is dropped."""
NUMBERS = 256


class SequenceGaps:
    """The numbers of one sender."""

    def __init__(self) -> None:
        """Nothing heard yet."""
        self._last: int | None = None
        self._gathered = self._in_order = self._jumps = self._lost = 0
        self._late_run = self._late_last = self._late_gap = self._taken_back = 0

    def follow(self, sequence: int) -> tuple[int, int]:
        """The number of the next frame: frames that are lost, less one that came late; and disordered frames."""
        last, self._last = self._last, sequence
        if last is None:
            return 0, 0
        missed = (sequence - last - 1) % NUMBERS
        if missed >= NUMBERS // 2:  # it is one of those before
            self._last = last
            return self._handle_late_frame(sequence, missed)
        self._late_run = 0
        is_small = missed <= SMALL_GAP
        self._gathered += missed
        self._in_order = self._in_order + 1 if is_small else 0
        self._jumps += not is_small
        if self._jumps == 0 or self._in_order >= CONFIRMING:
            lost, self._gathered, self._jumps = self._gathered, 0, 0
            self._lost += lost
            return lost, 0
        if self._jumps >= MOST_JUMPS:
            self._jumps, self._gathered = 1, 0
            return 0, MOST_JUMPS - 1
        return 0, 0

    def _handle_late_frame(self, sequence: int, missed: int) -> tuple[int, int]:
        """Take back the loss that a late frame was counted as; while the order is in doubt, it is one more doubt.

        Several in a row, in order among themselves, are not late: half of the numbers or more were lost before them.
        """
        if self._jumps:
            self._in_order = 0
            return 0, 1
        is_next = bool(self._late_run) and (sequence - self._late_last - 1) % NUMBERS <= SMALL_GAP
        self._late_run, self._late_last = (self._late_run + 1 if is_next else 1), sequence
        if self._late_run == 1:
            self._late_gap = missed
        if self._late_run >= CONFIRMING:
            self._last, self._late_run = sequence, 0
            self._lost += self._late_gap + self._taken_back
            return self._late_gap + self._taken_back, 0
        is_counted = missed != NUMBERS - 1 and self._lost > 0
        self._taken_back = (self._taken_back if is_next else 0) + is_counted
        self._lost -= is_counted
        return -is_counted, 0
