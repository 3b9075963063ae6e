"""Set-point schedules: parameters of a law that change during the flight, in steps or ramps.

    autopilot.law.reference = steps(0 s: 0, 5 s: 2 rad/s)

Any numeric parameter of a law can be scheduled. With steps, the parameter keeps its constant value until the first
scheduled time.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Quantity, leaves, option, quantity, record, replace, with_leaf
from trimtab.core.suggestions import closest
from trimtab.core.time import parse_time, to_seconds
from trimtab.core.units import parse_amount
from trimtab.loop.checks import check_part, check_values

L = TypeVar("L")
KINDS = ("steps", "ramps")
LAW = "autopilot.law."
SCHEDULE = re.compile(rf"\s*(?P<kind>{'|'.join(KINDS)})\s*\((?P<entries>.*)\)\s*", re.DOTALL)


def _example() -> str:
    return argument("settings", "steps(0 s: 1, 5 s: 2)", f"{LAW}PATH")


@record
class SetpointSchedule:
    """Schedule of one parameter of a law over the autopilot's time, which starts at 0 in a simulation.

    steps: each scheduled value is used from its time on. Before the first time, the parameter keeps the law's constant
    value. ramps: the value is interpolated linearly between the scheduled times. Before the first time, the first
    scheduled value is used, and after the last time the last one.

    Source: docs page, References from the command line.
    """

    path: str = option("Path of the scheduled parameter, relative to the law, e.g. reference.", default="k1")
    kind: str = option("Change from one scheduled value to the next: steps or ramps.", default="steps", choices=KINDS)
    times: Any = quantity("s", "Times of the scheduled values, in rising order.", default=np.zeros(1))
    values: Any = quantity(
        "as declared", "Values of the scheduled parameter at the times, in its unit.", default=np.zeros(1)
    )

    def check(self) -> None:
        """Raise InputError unless the scheduled times rise and each time has a value."""
        times, values = np.asarray(self.times), np.asarray(self.values)
        if times.ndim != 1 or times.shape != values.shape or not len(times) or not (np.diff(times) > 0).all():
            problem = (
                f"times must rise, and each time needs one value; got {np.size(times)} times, {np.size(values)} values"
            )
            raise InputError(
                f"schedule of {self.path}", problem, fix="write one value for each time, and the times in rising order"
            )

    def at(self, seconds: Any, before: Any) -> Any:
        """Return the scheduled value at a time (s). before: value before the first scheduled time, for `steps`."""
        times, values = jnp.asarray(self.times), jnp.asarray(self.values)
        if self.kind == "ramps":
            return jnp.interp(seconds, times, values)
        value = jnp.asarray(before, np.float64)
        for k in range(np.shape(self.times)[0]):
            value = jnp.where(seconds >= times[k], values[k], value)
        return value


def schedule_law(law: L, schedules: Iterable[SetpointSchedule], t: Any) -> L:
    """Return the law with each scheduled parameter set to its value at integer time t."""
    seconds = to_seconds(t)
    for one in schedules:
        law = with_leaf(law, one.path, lambda old, _, one=one: one.at(seconds, old))
    return law


def split_schedules(settings: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return two dictionaries: the settings with a constant value, and the settings with a schedule."""
    schedules = {path: text for path, text in settings.items() if SCHEDULE.fullmatch(text)}
    return {path: text for path, text in settings.items() if path not in schedules}, schedules


def with_schedules(scenario: Any, texts: Mapping[str, str]) -> Any:
    """Return the scenario with schedules for parameters of its law.

    texts: path of the parameter -> schedule as text.

    Raises: InputError for a path that is not a numeric parameter of the law, an invalid schedule, or a value out of
        range.
    """
    if not texts:
        return scenario
    schedules = tuple(_parse_schedule(scenario.autopilot.law, path, text) for path, text in texts.items())
    autopilot = scenario.autopilot
    return replace(scenario, autopilot=replace(autopilot, schedules=(*autopilot.schedules, *schedules)))


def _parse_schedule(law: Any, path: str, text: str) -> SetpointSchedule:
    part, match = argument_name("settings", path), SCHEDULE.fullmatch(text)
    if match is None:
        raise InputError(part, f"{text!r} is not a schedule", choices=KINDS, fix=_example())
    numbers = {p: d for p, v, d in leaves(law) if isinstance(d, Quantity) and not np.shape(v)}
    numbers = {p: d for p, d in numbers.items() if d.kind in ("real", "angle")}
    own = path.removeprefix(LAW)
    if not path.startswith(LAW) or own not in numbers:
        near = closest(path, [LAW + n for n in numbers], 6) or [LAW + n for n in numbers]
        problem = "a schedule can only set a numeric parameter of the law"
        raise InputError(part, problem, choices=near, fix=argument("settings", text, near[0]))
    entries = [_parse_entry(part, entry, numbers[own]) for entry in match["entries"].split(",")]
    times, values = (np.array(column) for column in zip(*entries, strict=True))
    schedule = SetpointSchedule(own, match["kind"], times, values)
    schedule.check()
    for one in values:
        changed = with_leaf(law, own, lambda old, _, one=one: one)
        check_values(changed, LAW.rstrip("."))
        check_part(LAW.rstrip("."), optional_member(changed, "check"))
    return schedule


def _parse_entry(part: str, entry: str, declared: Quantity) -> tuple[float, float]:
    """Return the time (s) and the value of an entry of a schedule, e.g. ``5 s: 2 rad/s``."""
    when, colon, what = entry.partition(":")
    if not colon or not what.strip():
        raise InputError(part, f"{entry.strip()!r} is not TIME: VALUE", fix=_example())
    try:
        time = float(to_seconds(parse_time(when)))
    except InputError:
        raise InputError(part, f"{when.strip()!r} is not a time", fix=_example()) from None
    return time, parse_amount(part, what.strip(), declared.unit)
