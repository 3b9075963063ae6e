"""Number of lost frames of a sender, counted from the gaps in its sequence numbers.

A large gap counts as a loss once CONFIRMING consecutive frames have arrived after the gap, each with a number at most
SMALL_GAP above the previous number. If the sequence numbers of a sender jump all the time (at random, or because two
programs use the same ids), no gap is ever confirmed. Then gaps do not count as losses, and the frames count as
disordered. If a frame arrives late, the loss that was counted for this frame is cancelled. A program that restarts
numbers its frames from 0. So a large jump to one of the first numbers is a restart, not a loss.
Source: https://mavlink.io/en/guide/serialization.html, packet sequence.
"""

CONFIRMING = 6
SMALL_GAP = 32
"""Largest gap in the sequence numbers that counts as small.

With random sequence numbers, a gap is small in 1 of 8 cases, and 6 gaps in a row are small in 1 of 200 000 cases.
"""
MOST_JUMPS = 3
"""Number of unconfirmed large gaps after which these gaps no longer count as possible losses."""
NUMBERS = 256
FIRST_NUMBERS = 4
"""Limit of the sequence number. A number below this limit after a large jump counts as a restart of the sender. After a
real large gap, the number is below this limit in 1 of 64 cases."""


class SequenceGaps:
    """Counter of the lost frames of one sender, computed from the sequence numbers."""

    def __init__(self) -> None:
        """Start before the first frame of the sender."""
        self._last: int | None = None
        self._gathered = self._in_order = self._jumps = self._lost = 0
        self._late_run = self._late_start = self._late_last = self._late_gap = self._taken_back = 0

    def follow(self, sequence: int) -> tuple[int, int]:
        """Process the sequence number of the next frame.

        Return the change of the number of lost frames (-1 for a late frame), and the number of frames that now count as
        disordered.
        """
        last, self._last = self._last, sequence
        if last is None:
            return 0, 0
        missed = (sequence - last - 1) % NUMBERS
        is_restart = sequence < FIRST_NUMBERS and SMALL_GAP < missed < NUMBERS - SMALL_GAP
        if missed >= NUMBERS // 2 and not is_restart:  # a late frame
            self._last = last
            return self._handle_late_frame(sequence, missed)
        self._late_run = 0
        is_small = missed <= SMALL_GAP
        self._gathered += 0 if is_restart else missed
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
        """Cancel the loss that was counted for a late frame. If a large gap is still unconfirmed, the frame counts as
        disordered instead.

        If CONFIRMING consecutive frames in order all seem late, they are not late: at least half of all sequence
        numbers were lost before them.
        """
        if self._jumps:
            self._in_order = 0
            return 0, 1
        is_next = bool(self._late_run) and (sequence - self._late_last - 1) % NUMBERS <= SMALL_GAP
        self._late_run, self._late_last = (self._late_run + 1 if is_next else 1), sequence
        if self._late_run == 1:
            self._late_start, self._late_gap = sequence, missed
        if self._late_run >= CONFIRMING:
            self._last, self._late_run = sequence, 0
            if self._late_start < FIRST_NUMBERS:
                self._lost += self._taken_back
                return self._taken_back, 0
            self._lost += self._late_gap + self._taken_back
            return self._late_gap + self._taken_back, 0
        is_counted = missed != NUMBERS - 1 and self._lost > 0
        self._taken_back = (self._taken_back if is_next else 0) + is_counted
        self._lost -= is_counted
        return -is_counted, 0
