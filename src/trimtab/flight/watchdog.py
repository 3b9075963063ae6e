"""Watchdog of a vehicle's outputs. It selects the output row to apply, depending on the received rows and the time.

This module imports only the standard library, because it runs in the process of the outputs.
Source: docs page, Vehicle (Watchdog).
"""

from collections.abc import Sequence

from trimtab.flight.output_port import DRIVEN, LATCHED, SAFE, WAITING, OutputRow


class Watchdog:
    """Watchdog that selects the output row to apply, depending on the received rows and the time. All times are in ns,
    by the same clock."""

    def __init__(self, safe: Sequence[float], timeout: int, lift_delay: int, latch: int) -> None:
        """timeout: time without received rows after which the safe row is applied.  latch: time without received rows
        after which the safe row remains applied until the vehicle is disarmed.

        lift_delay: time for which the lift fan keeps turning after the safe row takes effect.
        """
        self._safe, self._timeout, self._lift_delay, self._latch = tuple(safe), timeout, lift_delay, latch
        self.row = OutputRow(WAITING, False, self._safe)
        self._stamp = self._lift_until = 0

    def take_row(self, stamp: int, is_commanded: bool, lift: bool, values: tuple[float, ...]) -> None:
        """Apply a row that the vehicle sent at time `stamp`, unless the safe row is latched.

        A latched safe row remains applied until the vehicle sends that it no longer obeys a command.
        """
        state, lift_now = self.row.state, self.row.lift and self.row.state != DRIVEN
        latched = state == LATCHED or (state != WAITING and stamp - self._stamp >= self._latch)
        self._stamp = stamp
        if latched and is_commanded:
            self.row = OutputRow(LATCHED, lift_now, self._safe)
            return
        self.row = OutputRow(DRIVEN, lift, values)

    def check(self, now: int, is_gone: bool = False) -> bool:
        """Advance the watchdog to time now. Return True if the safe row is applied from now on. is_gone: True if no
        more rows can arrive."""
        row = self.row
        if row.state == DRIVEN and (is_gone or now - self._stamp >= self._timeout):
            self._lift_until = now + (self._lift_delay if row.lift else 0)
            self.row = OutputRow(SAFE, row.lift and now < self._lift_until, self._safe)
            return True
        if row.lift and row.state != DRIVEN and now >= self._lift_until:
            self.row = row._replace(lift=False)
        if row.state == SAFE and (is_gone or now - self._stamp >= self._latch):
            self.row = self.row._replace(state=LATCHED)
        return False

    def next_check(self) -> int | None:
        """Return the next time at which the applied row changes if no row arrives, or None if it does not change."""
        if self.row.state == DRIVEN:
            return self._stamp + self._timeout
        times = [self._lift_until] if self.row.lift else []
        times += [self._stamp + self._latch] if self.row.state == SAFE else []
        return min(times, default=None)

    def silence(self, now: int) -> int:
        """Return the time since the last received row was sent."""
        return now - self._stamp
