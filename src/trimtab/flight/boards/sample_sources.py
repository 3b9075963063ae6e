"""Generator of C code that sends a vehicle's sensor samples as messages, and computes speed and rate of turn from the
samples."""

from collections.abc import Mapping
from itertools import chain

from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.compiler.identifiers import identifier
from trimtab.core.signals import Frame
from trimtab.core.time import ms
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.sensed_motion import QUANTITIES
from trimtab.loop.vehicle_limits import VehicleLimits


def samples_header(sensors: Mapping[str, int]) -> str:
    """Return the C header for sending samples. The header also defines the period of each sensor."""
    periods = "\n".join(f"#define SAMPLES_{identifier(name).upper()} {period}" for name, period in sensors.items())
    return f"""{LICENCE_NOTE}
#ifndef SAMPLES_H
#define SAMPLES_H
#include "link.h"
#include "rearm.h"
#include "world.h"

/* Period of each sensor of the scenario, in units of 100 ns. */
{periods}

/* Send the samples that were measured at this instant. Return their number. */
int samples_send(link *l, const world_out *out);

/* Return the newest measured speed and rate of turn. */
motion samples_motion(const world_out *out);

/* Keep the newest sample of each sensor until it is sent. now = NULL: all kept samples have been sent. */
void samples_merge(world_out *kept, const world_out *now);
#endif
"""


def samples_source(frame: Frame, dialect: Dialect) -> str:
    """Return C code that sends each new sensor sample as MAVLink messages."""
    lines = [
        LICENCE_NOTE,
        '#include "samples.h"\n',
        "#include <math.h>",
        "#include <string.h>\n",
        "int samples_send(link *l, const world_out *out)",
    ]
    lines += ["{", "    mavlink_message_t message;", "    int sent = 0;"]
    for sensor in frame.samples:
        here = f"out->sensors.{identifier(sensor)}"
        lines.append(f"    if ({here}.fresh) {{")
        for name in dialect.groups[f"samples.{sensor}"]:
            lines += _sending_lines(name, dialect)
        lines += ["        ++sent;", "    }"]
    lines += ["    (void)l; (void)out; (void)message;", "    return sent;", "}\n"]
    return "\n".join([*lines, *_motion_lines(dialect), *_merging_lines(frame)])


def rest_header(limits: VehicleLimits) -> str:
    """Return the C header with the limits of speed, turn rate and time by which a vehicle counts as at rest."""
    return f"""{LICENCE_NOTE}
#ifndef REST_H
#define REST_H
#define REST_SPEED {float(limits.rest_speed)!r}f /* m/s */
#define REST_RATE {float(limits.rest_rate)!r}f /* rad/s */
#define REST_MOMENTS {max(round(limits.rest_time / ms(100)), 1)} /* averaging time in steps of 100 ms */
#endif
"""


def _motion_lines(dialect: Dialect) -> list[str]:
    """Return C code that computes speed and rate of turn, from the same sensors as the command `trimtab vehicle`."""
    lines = ["motion samples_motion(const world_out *out)", "{", "    motion m = {NAN, NAN};"]
    for name in ("speed", "rate"):
        sensor, slots = _find_measured(name, dialect)
        if slots:
            squares = " + ".join(f"(float)({slot} * {slot})" for slot in slots)
            lines.append(f"    m.{name} = out->sensors.{sensor}.valid ? sqrtf({squares}) : INFINITY;")
    return [*lines, "    (void)out;", "    return m;", "}\n"]


def _find_measured(name: str, dialect: Dialect) -> tuple[str, list[str]]:
    """Return the sensor that measures the speed or the turn rate, and C expressions for the components of the measured
    vector."""
    slots: dict[str, list[int]] = {}
    for place in chain.from_iterable(dialect.places.values()):
        slots.setdefault(place.path, []).append(place.slot)
    sensors = dict.fromkeys(path.split(".")[1] for path in slots if path.startswith("samples."))
    for fields in QUANTITIES[name].fields:
        for sensor in sensors:
            paths = {f"samples.{sensor}.value.{field}": f"{sensor}.value.{field}" for field in fields}
            if paths.keys() <= slots.keys():
                return identifier(sensor), [
                    ".".join(["out->sensors", *map(identifier, field.split("."))])
                    + (f"[{k}]" if len(slots[path]) > 1 else "")
                    for path, field in paths.items()
                    for k in slots[path]
                ]
    return "", []


def _merging_lines(frame: Frame) -> list[str]:
    """Return the C function that keeps the newest sample of each sensor, for a link that is too slow to send every
    sample when it is measured."""
    lines = ["void samples_merge(world_out *kept, const world_out *now)", "{"]
    for sensor in map(identifier, frame.samples):
        old, new = f"kept->sensors.{sensor}", f"now->sensors.{sensor}"
        lines.append(f"    if (now == NULL) {old}.fresh = false;")
        lines.append(f"    else if ({new}.fresh) {old} = {new};")
    return [*lines, "    (void)kept; (void)now;", "}\n"]


def _sending_lines(name: str, dialect: Dialect) -> list[str]:
    """Return C code that sets the fields of a message and sends the message."""
    low, pad = name.lower(), " " * 8
    lines = [f"{pad}mavlink_{low}_t {low};", f"{pad}memset(&{low}, 0, sizeof {low});"]
    for f in dialect.definitions[name].fields:
        for k in range(f.slots):
            place = dialect.places[name][f.at + k]
            _, sensor, *rest = place.path.split(".")
            source = ".".join(["out->sensors", identifier(sensor), *map(identifier, rest)])
            source += f"[{place.slot}]" if f.length else ""
            target = f"{low}.{f.name}" + (f"[{k}]" if f.length else "")
            lines.append(f"{pad}{target} = ({f.type}){source};")
    lines.append(f"{pad}mavlink_msg_{low}_encode_status(SYSTEM, COMPONENT, &l->status, &message, &{low});")
    return [*lines, f"{pad}link_send(l, &message);"]
