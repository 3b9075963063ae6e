"""What a vehicle's firmware does besides flying: who may command it, and what it does when nobody does.

Source: docs page, Vehicle.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.failsafe import CAUSES, MODES, Failsafe
from trimtab.core.record import leaves
from trimtab.core.signals import Command
from trimtab.core.time import SECONDS_PER_UNIT, ms
from trimtab.live.exchange import Taken
from trimtab.live.failsafe_step import failsafe_step
from trimtab.run.fast_step import FastStep
from trimtab.wire.events import ArmAsked, Channels, Event, ModeAsked, Sticks
from trimtab.wire.protocol import State
from trimtab.wire.station import Status

COMPUTER_MODE, MANUAL_MODE, HOLD_MODE = 15, 0, 4
STATION_MODES = {COMPUTER_MODE: "computer", MANUAL_MODE: "manual", HOLD_MODE: "hold"}
"""What a ground station can ask for: obey the autopilot's link, or the pilot's sticks; hold: the link, and it holds.

The numbers are those of ArduPilot's GUIDED, MANUAL and HOLD of rovers and boats, by which ground stations name them.
"""
SWITCH = 4
"""The pilot's fifth channel is the mode switch: above 1.5 ms the sticks rule."""
RADIO_TIMEOUT = ms(500)
WIDEST = 1e100
"""Between limits that are further apart there is no place for a stick: such a vehicle can't be flown by hand."""
LOW_PULSE, HIGH_PULSE = 1e-3, 2e-3


class Mode(NamedTuple):
    """Who commands, and why."""

    mode: str
    cause: str


class Duties:
    """The failsafe of a vehicle between a line and its actuators, with the requests that have come in."""

    def __init__(self, failsafe: Failsafe, command: Command, world: FastStep, uplink: FastStep | None = None) -> None:
        """A vehicle's failsafe, disarmed.

        Args:
            failsafe: which.
            command: of the structure that the autopilot sends.
            world: whose inputs get what the failsafe decides.
            uplink: what commands pass before the failsafe sees them, e.g. one with a fault.
        """
        self.step = FastStep(failsafe_step(failsafe, command))
        reads, writes = self.step.reads, self.step.writes
        self._inputs: dict[str, Any] = {p.removeprefix("given."): at for p, at in reads.items()}
        shared = [p for p in writes if p.startswith("command.") and p in world.reads]
        self._out = _slots(writes, shared, len(self.step.outputs))
        self._in = _slots(world.reads, shared, len(world.inputs))
        self._world, self.uplink = world, uplink
        self._first = self.step if uplink is None else uplink
        self._first_at = self._inputs if uplink is None else uplink.reads
        if uplink is not None:
            passed = [p for p in uplink.writes if p in self._inputs]
            self._passed = _slots(uplink.writes, passed, len(uplink.outputs))
            self._given = _slots(self._inputs, passed, len(self.step.inputs))
        self._low, self._high = (
            np.concatenate([np.ravel(np.asarray(v, float)) for _, v, _ in leaves(r)])
            for r in (failsafe.low, failsafe.high)
        )
        paths = [f"manual.{p}" for p, _, _ in leaves(failsafe.safe)]
        self._manual = _slots(self._inputs, paths, len(self.step.inputs))
        self._by_hand = bool((self._high - self._low < WIDEST).all())
        self._radio_at: int | None = None
        self._arm = self._disarm = self._asked_manual = self._switch = False
        self.mode = Mode(MODES[0], CAUSES[0])

    def slot(self, path: str) -> Any:
        """Where a number of the newest command stands in the inputs of what it comes to first."""
        return self._first_at[path]

    def ask(self, event: Event, now: int) -> None:
        """Keep a request for the next step."""
        if isinstance(event, ArmAsked):
            self._arm, self._disarm = event.armed, not event.armed
        elif isinstance(event, ModeAsked):
            self._asked_manual = event.mode == MANUAL_MODE
        elif isinstance(event, Channels):
            self._pulses(np.array(event.pulses), now)
        elif isinstance(event, Sticks):
            self._stick(np.array([event.yaw, event.surge, event.sway, event.heave]), now)

    def _pulses(self, pulses: Any, now: int) -> None:
        share = (pulses[: len(self._manual)] - LOW_PULSE) / (HIGH_PULSE - LOW_PULSE)
        self._sticks(share, now)
        if len(pulses) > SWITCH and np.isfinite(pulses[SWITCH]):
            self._switch = bool(pulses[SWITCH] > (LOW_PULSE + HIGH_PULSE) / 2)

    def _stick(self, sticks: Any, now: int) -> None:
        self._sticks((sticks[: len(self._manual)] + 1) / 2, now)

    def _sticks(self, share: Any, now: int) -> None:
        if self._by_hand and len(share) == len(self._manual) and np.isfinite(share).all():
            wanted = self._low + np.clip(share, 0, 1) * (self._high - self._low)
            self.step.inputs[self._manual] = wanted
            self._radio_at = now

    def act(self, t: int, taken: Taken | None) -> bool:
        """Decide at integer time t, with the newest command if a new one came; returns whether the mode is another."""
        self._receive(t, taken)
        inputs, at = self.step.inputs, self._inputs
        inputs[at["t"]] = t
        inputs[at["radio"]] = self._radio_at is not None and t - self._radio_at <= RADIO_TIMEOUT
        inputs[at["takeover"]] = self._asked_manual or self._switch
        inputs[at["arm"]], inputs[at["disarm"]] = self._arm, self._disarm
        self._arm = self._disarm = False
        self.step.step()
        self._world.inputs[self._in] = self.step.outputs[self._out]
        before = self.mode
        self.mode = Mode(MODES[int(self.step.result("mode"))], CAUSES[int(self.step.result("cause"))])
        return self.mode != before

    def _receive(self, t: int, taken: Taken | None) -> None:
        """The newest command into the failsafe's inputs, through the uplink if there is one."""
        inputs, at = self._first.inputs, self._first_at
        if taken is not None:
            taken.write(inputs)
        inputs[at["t"]] = t
        inputs[at["command.fresh"]] = taken is not None
        inputs[at["command.age"]] = (t - inputs[at["command.t"]]) * SECONDS_PER_UNIT
        if self.uplink is not None:
            self.uplink.step()
            self.step.inputs[self._given] = self.uplink.outputs[self._passed]

    @property
    def flying(self) -> bool:
        """Whether somebody commands."""
        return self.mode.mode in ("computer", "manual")

    @property
    def status(self) -> Status:
        """As the vehicle tells it."""
        state = {"failsafe": State.CRITICAL, "disarmed": State.STANDBY}.get(self.mode.mode, State.ACTIVE)
        mode = MANUAL_MODE if self._asked_manual or self._switch else COMPUTER_MODE
        return Status(mode=mode, armed=self.flying, state=state)


def _slots(where: Any, paths: list[str], size: int) -> Any:
    every = np.arange(size)
    return np.concatenate([np.zeros(0, np.intp), *(np.atleast_1d(every[where[p]]) for p in paths)])
