"""Conversion of a command to pulses for servos and speed controllers, on a microcontroller or another autopilot."""

from typing import NamedTuple

import numpy as np

from trimtab.actuators.failsafe import Failsafe
from trimtab.actuators.servo_pulse import ServoPulse, linear_pulse
from trimtab.core.errors import InputError, argument
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Quantity, leaves
from trimtab.core.signals import Command
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import UNLIMITED, choose_failsafe

MOST_OUTPUTS = 8
"""Number of servo outputs in a message for another autopilot."""


class PulseOutput(NamedTuple):
    """Pulse output of a board for one number of the command.

    path: path of the number in the command.  slot: index of the number in an array, or None for a scalar.  declared:
    declaration of the number.  pulse: table of the pulse width over the number's value.  safe: width of the pulse that
    is sent in the safe state (s).
    """

    path: str
    slot: int | None
    declared: Quantity
    pulse: ServoPulse
    safe: float

    @property
    def name(self) -> str:
        """Return the name of the output, e.g. rudder or speed[2]."""
        return self.path if self.slot is None else f"{self.path}[{self.slot}]"


def find_outputs(
    scenario: Scenario, command: Command, most: int = MOST_OUTPUTS, part: str = "firmware"
) -> list[PulseOutput]:
    """Return one pulse output for each number of a scenario's command, in the order of the numbers.

    Args:
        scenario: scenario with the actuators.
        command: example of a command of the scenario.
        most: number of outputs of the board.
        part: name of the caller, for error messages.

    The pulse table is the one that the actuators declare (`pulses`, ServoPulse, stops of an ActuatorBank). If they
    declare none, the pulse width is linear, from 1 ms at the lower limit of the number to 2 ms at the upper limit. The
    limits are those of the failsafe, else those of the vehicle (`input_limits`), else those of the command's record.
    The safe pulse corresponds to the failsafe's safe value. Without a failsafe, it corresponds to the value nearest to
    zero, at which a motor does not turn.

    Raises:
        InputError: the limits of a number are unknown, or the command has more numbers than the board has outputs.
    """
    at_rest = {path: value for path, value, _ in leaves(choose_failsafe(scenario, command).safe)}
    outputs = list[PulseOutput]()
    for path, like, declared in leaves(command.value):
        assert isinstance(declared, Quantity)
        pulse = _find_pulse(scenario, path, declared, part)
        pulse.check()
        safe = np.broadcast_to(np.asarray(at_rest[path], float), np.shape(like))
        for slot in np.ndindex(np.shape(like)):
            at = int(np.ravel_multi_index(slot, np.shape(like))) if slot else None
            outputs.append(PulseOutput(path, at, declared, pulse, float(pulse.width(safe[slot]))))
    if len(outputs) > most:
        names = ", ".join(o.name for o in outputs)
        problem = f"a command has {len(outputs)} numbers ({names}), but the board has only {most} outputs"
        fits = f"{argument('board', 'cortex-m7')}, which has 8"
        fix = fits if len(outputs) <= MOST_OUTPUTS else "use an allocation whose command has fewer numbers"
        raise InputError(f"scenario {scenario.name!r}", problem, fix=fix)
    return outputs


def _find_pulse(scenario: Scenario, path: str, declared: Quantity, part: str) -> ServoPulse:
    """Return the pulse table of the number at a path of the command."""
    known = optional_member(scenario.world.actuators, "pulses")()
    name = path.partition(".")[0]
    if name in known:
        return known[name]
    limits = [declared.low, declared.high] if declared.kind != "flag" else [0.0, 1.0]
    limits = optional_member(scenario.world.vehicle, "input_limits")().get(name, limits)
    if isinstance(scenario.failsafe, Failsafe):
        ends = [{p: v for p, v, _ in leaves(r)}[path] for r in (scenario.failsafe.low, scenario.failsafe.high)]
        limits = [np.min(ends[0]), np.max(ends[1])]
    low, high = (np.nan if end is None else float(end) for end in limits)
    if not (-UNLIMITED < low < high < UNLIMITED):
        kind = type(scenario.world.actuators).__name__
        problem = f"{kind} declares no limits for {path!r} ({declared.unit}), so the pulse table is unknown"
        fix = f'ActuatorBank(…, {{"{name}": ServoPulse(values=(low, high))}}) for actuators, or low= and high= where '
        raise InputError(part, problem, fix=f"{fix}the command's {name} is declared (docs, Servo pulses)")
    return linear_pulse(low, high)


def describe_outputs(outputs: list[PulseOutput]) -> list[str]:
    """Return one line of text for each output, as wiring instructions for the user."""
    lines = list[str]()
    for k, o in enumerate(outputs):
        values, widths = np.asarray(o.pulse.values), 1e3 * np.asarray(o.pulse.widths)
        unit = "" if o.declared.unit == "1" else f" {o.declared.unit}"
        told = f"{values[0]:g} to {values[-1]:g}{unit} by {widths[0]:.3f} to {widths[-1]:.3f} ms"
        lines.append(f"output {k + 1}: {o.name}, {told}, safe {1e3 * o.safe:.3f} ms")
    return lines
