"""Safety pilot of a vehicle: stick positions from a radio receiver or a joystick, and the conditions under which the
vehicle obeys them.

Source: docs page, Vehicle.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trimtab.actuators.failsafe import Failsafe
from trimtab.core.record import leaves
from trimtab.core.time import ms
from trimtab.flight.exchange import slot_indices
from trimtab.flight.mavlink.protocol import JoystickAxes, ModeRequest, ReceiverChannels, VehicleEvent

MANUAL_MODE = 0
"""Number of the mode in which the vehicle obeys the pilot's sticks. It equals the number of MANUAL of ArduPilot's
rovers and boats."""
SWITCH = 4
"""Index of the radio channel of the mode switch (the fifth channel). Above a pulse width of 1.5 ms the vehicle obeys
the sticks."""
RADIO_TIMEOUT = ms(500)
WIDEST_RANGE = 1e30
"""Smallest range (high - low) at which an element of a command counts as unlimited. Sticks cannot set such a
command."""
LOW_PULSE, HIGH_PULSE = 1e-3, 2e-3


class ManualControl:
    """Writer of the safety pilot's data into the inputs of the compiled failsafe.

    Times are by the vehicle's clock, in 100 ns.
    """

    def __init__(self, failsafe: Failsafe, inputs: Any, slots: Mapping[str, Any]) -> None:
        """Start without data from a pilot.

        Args:
            failsafe: failsafe of the vehicle. At full deflection of a stick, the command is at the failsafe's limit.
            inputs: input vector of the compiled failsafe.
            slots: index of each input in this vector, by the input's name.
        """
        self._inputs, self._slots = inputs, slots
        self._low, self._range = command_ranges(failsafe)
        paths = [f"manual.{p}" for p, _, _ in leaves(failsafe.safe)]
        self._manual = slot_indices(slots, paths, len(inputs))
        self._has_sticks = bool(np.isfinite(self._range).all())
        self._radio_at: int | None = None
        self._is_released = self._is_mode = self._is_switched = False

    @property
    def wants_control(self) -> bool:
        """True while the vehicle's mode or the pilot's mode switch selects the pilot's sticks."""
        return self._is_mode or self._is_switched

    def radio_silence(self, now: int) -> int | None:
        """Return the time since the last data from the safety pilot's sticks, or None if no data were ever received."""
        return None if self._radio_at is None else now - self._radio_at

    def handle_event(self, event: VehicleEvent, now: int) -> None:
        """Store the safety pilot's data in an event for the next call of the failsafe. Other events have no effect."""
        if isinstance(event, ModeRequest):
            self._is_mode = event.mode == MANUAL_MODE
        elif isinstance(event, ReceiverChannels) and event.is_release:
            self._is_released, self._is_mode, self._is_switched = True, False, False
        elif isinstance(event, ReceiverChannels):
            self._is_released = False
            self._apply_pulses(np.array(event.pulses), now)
        elif isinstance(event, JoystickAxes):
            self._apply_joystick(np.array([event.yaw, event.surge, event.sway, event.heave]), now)

    def _apply_pulses(self, pulses: Any, now: int) -> None:
        share = (pulses[: len(self._manual)] - LOW_PULSE) / (HIGH_PULSE - LOW_PULSE)
        self._apply_command(share, now)
        if len(pulses) > SWITCH and np.isfinite(pulses[SWITCH]):
            self._is_switched = bool(pulses[SWITCH] > (LOW_PULSE + HIGH_PULSE) / 2)

    def _apply_joystick(self, sticks: Any, now: int) -> None:
        self._apply_command((sticks[: len(self._manual)] + 1) / 2, now)

    def _apply_command(self, share: Any, now: int) -> None:
        if self._has_sticks and len(share) == len(self._manual) and np.isfinite(share).all():
            self._inputs[self._manual] = self._low + np.clip(share, 0, 1) * self._range
            self._radio_at = now

    def set_inputs(self, t: int) -> None:
        """Set the failsafe's inputs that depend on the safety pilot, at integer time t."""
        is_received = self._radio_at is not None and t - self._radio_at <= RADIO_TIMEOUT
        self._inputs[self._slots["radio"]] = is_received or self._is_released
        self._inputs[self._slots["takeover"]] = self.wants_control

    def end_step(self) -> None:
        """Forget the radio receiver if a ground station has released it. Call this after each call of the failsafe."""
        if self._is_released:
            self._radio_at, self._is_released = None, False


def command_ranges(failsafe: Failsafe) -> tuple[Any, Any]:
    """Return the lowest value and the range (high - low) of each element of a command. The range of an element without
    limits is NaN."""
    low, high = (
        np.concatenate([np.zeros(0), *(np.ravel(np.asarray(v, float)) for _, v, _ in leaves(r))])
        for r in (failsafe.low, failsafe.high)
    )
    return low, np.where(high - low < WIDEST_RANGE, high - low, np.nan)
