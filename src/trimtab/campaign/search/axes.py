"""Axes of a stability map: what changes along it, in a scenario whose program stays the same.

Source: docs page, Axes.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.imperfections import without
from trimtab.core.record import Option, Quantity, children, leaves, replace, with_leaf, with_part_of
from trimtab.core.time import ms
from trimtab.links.fifo import required_slots
from trimtab.links.latency import NODES, MeasuredLatency, normal_scores
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.scenario import Scenario

LINKS = ("uplink", "downlink")
KINDS = ("delay", "jitter", "loss")


def _keep_scenario(scenario: Scenario) -> Scenario:
    return scenario


class Axis(NamedTuple):
    """One axis.

    name: to show.  values: of the coarse grid (k,), rising.  unit: of them.  change: (scenario, value) -> path of a
    quantity -> its new value; it gets the scenario as other axes have left it.  prepare: what is done once before.
    link, kind: which link's "delay", "jitter" or "loss" it is, or empty.
    """

    name: str
    values: Any
    unit: str
    change: Callable[[Scenario, float], Mapping[str, Any]]
    prepare: Callable[[Scenario], Scenario] = _keep_scenario
    link: str = ""
    kind: str = ""

    def check(self) -> None:
        """Refuse values that are no rising list of two or more."""
        values = np.asarray(self.values, float)
        if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            problem = f"{np.array2string(values, threshold=6)} is no rising list of two values or more"
            raise InputError(f"axis {self.name!r}", problem, fix="give e.g. np.linspace(0.0, 0.6, 7)")


def axis_of_path(path: str, values: Any, unit: str = "", *, name: str = "") -> Axis:
    """The quantity at a path takes the values themselves."""
    return Axis(
        name or path, values, unit, lambda scenario, value: {path: value}, lambda scenario: with_part_of(scenario, path)
    )


def axis_of_scale(path: str, factors: Any, *, name: str = "") -> Axis:
    """The quantity at a path, a number or an array, is the scenario's own times a factor."""

    def change(scenario: Scenario, factor: float) -> Mapping[str, Any]:
        return {path: np.asarray(find_quantity(scenario, path)[0], float) * factor}

    return Axis(name or path, factors, "× own", change)


def axis_of_link(kind: str, values: Any, link: str = "uplink") -> Axis:
    """Delay (s), jitter (s) or loss (probability) of a link, which becomes a `MeasuredLatency` where it is none.

    delay: takes the place of the link's own latency, constant.  jitter: an even spread from 0 to the value, on top of
    the delay axis, or of the link's mean latency where there is no such axis.  loss: each packet by itself.
    """
    for what, name, choices in (("axis", kind, KINDS), ("link", link, LINKS)):
        if name not in choices:
            raise InputError(what, f"there is no {name!r}", choices=choices, fix=f"write {choices[0]!r}")
    path = f"world.{link}." + ("loss" if kind == "loss" else "latency")

    def change(scenario: Scenario, value: float) -> Mapping[str, Any]:
        if kind == "loss":
            return {path: value}
        added = np.full(NODES, value) if kind == "delay" else value * even_latencies()
        return {path: np.asarray(find_quantity(scenario, path)[0]) + added}

    def prepare(scenario: Scenario) -> Scenario:
        channel = measured_latency(scenario, link)
        if kind == "delay":
            channel = replace(channel, latency=np.zeros(NODES))
        elif kind == "jitter":
            channel = without(channel, "jitter")
        return replace(scenario, world=replace(scenario.world, **{link: channel}))

    return Axis(f"{link} {kind}", values, "1" if kind == "loss" else "s", change, prepare, link, kind)


def even_latencies() -> Any:
    """Latencies (NODES,) spread evenly over [0, 1], as a table over the normal score."""
    from scipy.special import ndtr

    return ndtr(normal_scores())


def find_quantity(scenario: Scenario, path: str) -> tuple[Any, Quantity]:
    """Value and declaration of a quantity; InputError where there is none, or where it shapes the program."""
    value, declared = _find_leaf(scenario, path.split("."))
    if isinstance(declared, Quantity):
        return value, declared
    if declared is not None:
        problem = "is a choice that shapes the program, not a number that a map could change"
        raise InputError(f"axis {path!r}", problem, fix="fly one map for each choice: --set …")
    known = [where for where, _, declared in leaves(scenario) if isinstance(declared, Quantity)]
    near = closest(path, known, 6) or known[:6]
    raise InputError(f"axis {path!r}", "there is no such quantity", choices=near, fix=f"write {near[0]!r}")


def _find_leaf(value: Any, path: list[str]) -> tuple[Any, Any]:
    """Value and declaration of the leaf at a path, or None and None."""
    for name, child, declared in children(value):
        if name == path[0] and isinstance(declared, Quantity | Option):
            return (child, declared) if len(path) == 1 else (None, None)
        if name == path[0] and len(path) > 1:
            return _find_leaf(child, path[1:])
    return None, None


def with_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """The scenario with quantities changed, path -> value."""
    for path, value in values.items():
        find_quantity(scenario, path)
        scenario = with_leaf(scenario, path, lambda old, declared, value=value: value)
    return scenario


def measured_latency(scenario: Scenario, link: str) -> MeasuredLatency:
    """A link as a `MeasuredLatency` of the same delay and packets as often, or itself if it is one."""
    channel = getattr(scenario.world, link)
    if isinstance(channel, MeasuredLatency):
        return channel
    if not isinstance(channel, DelayChain | Wire):
        problem = f"{type(channel).__name__} has no latency that could change along an axis"
        raise InputError(f"world.{link}", problem, fix="fly a scenario whose link is one, or map a path of this link")
    delay = channel.delay() if isinstance(channel, DelayChain) else 0.0
    looks = min(channel.period, scenario.autopilot.period, ms(1))
    return MeasuredLatency(latency=np.full(NODES, delay), send_period=channel.period, period=looks)


def enlarge_rings(scenario: Scenario, last: Scenario) -> Scenario:
    """The scenario with rings long enough for the latencies that its links have in `last`."""
    for link in LINKS:
        channel, longest = getattr(scenario.world, link), getattr(last.world, link)
        if isinstance(channel, MeasuredLatency):
            table, capacity = np.asarray(longest.latency, float), channel.capacity
            if np.isfinite(table).all():
                capacity = max(capacity, required_slots(float(table[-1]), channel.send_period, channel.period))
            channel = replace(channel, capacity=capacity)
            scenario = replace(scenario, world=replace(scenario.world, **{link: channel}))
    return scenario
