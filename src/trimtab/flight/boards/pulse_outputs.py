"""Generator of C code for the outputs of a board: tables that convert the elements of a command to pulse widths, and
the safe pulses."""

from typing import Any

import numpy as np

from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.servo_frame import ServoFrame
from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.compiler.identifiers import identifier
from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.time import ms
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.loop.scenario import Scenario
from trimtab.run.command_pulses import PulseOutput, describe_outputs

COUNTS_PER_SECOND = 2e6
"""Counts per second of the servo timers (firmware/portable/pulse.h)."""
SHORTEST_FRAME, LONGEST_FRAME = ms(3), ms(20)


def frame_of(scenario: Scenario) -> int:
    """Return the time between two pulses of a servo (100 ns): the longest servo frame of the scenario, rounded up to
    whole milliseconds and limited to 3 to 20 ms.

    The board sends the pulses of all servos with one period, and an analogue servo overheats if this period is shorter
    than the servo's own frame. If no servo declares a frame, the period of the actuators is used.
    """
    actuators = scenario.world.actuators
    rows = actuators.stages.values() if isinstance(actuators, ActuatorBank) else ()
    frames = [int(stage.frame) for row in rows for stage in row if isinstance(stage, ServoFrame) and stage.frame]
    wanted = max(frames, default=optional_member(actuators, "frame") or actuators.period)
    return min(max(-(-wanted // ms(1)) * ms(1), SHORTEST_FRAME), LONGEST_FRAME)


def outputs_header(outputs: list[PulseOutput], frame: int) -> str:
    """Return the C header that declares the board's outputs."""
    safe = ", ".join(str(round(o.safe * COUNTS_PER_SECOND)) for o in outputs)
    names = "".join(f"\n   {line}" for line in describe_outputs(outputs))
    return f"""{LICENCE_NOTE}
/* Outputs of a vehicle whose command goes to pulses by tables.{names} */
#ifndef OUTPUTS_H
#define OUTPUTS_H
#include <stdint.h>

enum {{ CHANNELS = {len(outputs)}, FRAME = {frame} }}; /* FRAME: between pulses, in units of 100 ns */
enum {{ DRIVE_PARAMETERS = 0 }};

/* Pulses at rest, in counts: sent while no command is valid. */
static const uint16_t SAFE_PULSES[CHANNELS] = {{{safe}}};
#endif
"""


def outputs_source(outputs: list[PulseOutput]) -> str:
    """Return C code with the pulse tables, and with functions that read the failsafe's output command and set its safe
    command."""
    lines = [LICENCE_NOTE, '#include "output_table.h"\n']
    for k, o in enumerate(outputs):
        values, counts = np.asarray(o.pulse.values), np.asarray(o.pulse.widths) * COUNTS_PER_SECOND
        lines.append(
            f"static const double VALUES_{k}[] = {{{_numbers(values)}}}, COUNTS_{k}[] = {{{_numbers(counts)}}};"
        )
    tables = ", ".join(f"{{{np.size(o.pulse.values)}, VALUES_{k}, COUNTS_{k}}}" for k, o in enumerate(outputs))
    places = [f"command.value.{_place(o)}" for o in outputs]
    cases = [f"    if (channel == {k}) value = (double)out->{place};" for k, place in enumerate(places)]
    lines += [f"\nconst output_table output_tables[CHANNELS] = {{{tables}}};\n"]
    lines += ["double output_value(const failsafe_out *out, int channel) {", "    double value = 0;"]
    lines += [*cases, "    return value;", "}\n", "void output_rest(failsafe_in *in) {"]
    for o in outputs:
        rest = float(o.pulse.value(o.safe))
        lines.append(f"    in->input.manual.{_place(o)} = {_cast_text('failsafe_real', o, repr(rest))};")
    return "\n".join([*lines, "}\n"])


def world_source(outputs: list[PulseOutput]) -> str:
    """Return C code that converts pulse widths back to the command of the simulated vehicle."""
    lines = [LICENCE_NOTE, '#include "output_table.h"\n']
    lines += ["void output_tell(world_in *world, int channel, double value) {"]
    for k, o in enumerate(outputs):
        lines.append(
            f"    if (channel == {k}) world->command.value.{_place(o)} = {_cast_text('world_real', o, 'value')};"
        )
    return "\n".join([*lines, "}\n"])


COMMAND_HEADER = f"""{LICENCE_NOTE}
#ifndef COMMAND_H
#define COMMAND_H
#include "dialect.h"
#include "failsafe.h"

/* Take the newest command that was received from the link. */
void command_take(failsafe_in *in, const mavlink_command_t *c);
#endif
"""


def command_source(dialect: Dialect) -> str:
    """Return C code that copies the values of a received command message into the inputs of the failsafe.

    Raises:
        InputError: the command does not fit into one message.
    """
    name, *more = dialect.groups["command"]
    if more:
        problem = (
            f"a command of this scenario needs {len(more) + 1} messages, but the firmware accepts only commands of "
            "one message"
        )
        raise InputError("firmware", problem, fix="use an allocation whose command has 28 numbers at most")
    lines = [LICENCE_NOTE, '#include "command.h"\n', "void command_take(failsafe_in *in, const mavlink_command_t *c) {"]
    places = dialect.places[name]
    for f in dialect.definitions[name].fields:
        for k, place in enumerate(
            places[f.at : f.at + f.slots]
        ):  # leave out the session number, which is not part of the command
            if not place.path.startswith("command.value"):
                continue
            target = ".".join(map(identifier, place.path.split(".")[1:])) + (f"[{place.slot}]" if f.length else "")
            source = f"c->{f.name}" + (f"[{k}]" if f.length else "")
            told = {"double": f"(failsafe_real){source}", "uint8_t": f"{source} != 0"}.get(place.type, source)
            lines.append(f"    in->input.command.{target} = {told};")
    return "\n".join([*lines, "}\n"])


def _place(o: PulseOutput) -> str:
    return ".".join(map(identifier, o.path.split("."))) + ("" if o.slot is None else f"[{o.slot}]")


def _cast_text(real: str, o: PulseOutput, text: str) -> str:
    return f"{text} > 0.5" if o.declared.kind == "flag" else f"({real}){text}"


def _numbers(values: Any) -> str:
    return ", ".join(repr(float(v)) for v in values)
