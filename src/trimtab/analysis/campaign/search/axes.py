"""Axes of a stability map. An axis varies a quantity of the scenario, without a new compilation of the program.

Source: docs page, Axes.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.imperfections import without
from trimtab.core.quantity import first_number, has_index, split_index
from trimtab.core.record import Option, Quantity, children, leaves, replace, with_leaf, with_part_of
from trimtab.core.suggestions import closest
from trimtab.core.time import seconds
from trimtab.links.fifo import required_slots
from trimtab.links.latency import NODES, MeasuredLatency, mean_latency
from trimtab.loop.link_latency import EXPECTED, KINDS, LINKS, even_latencies, extend_horizon, measured_latency
from trimtab.loop.scenario import Scenario


def _keep_scenario(scenario: Scenario) -> Scenario:
    return scenario


class Axis(NamedTuple):
    """Axis of a stability map.

    name: name of the axis, as shown.  values: increasing values of the coarse grid (k,).  unit: unit of the values.
    change: function (scenario, value) -> {path of a quantity: new value}. If both axes change the same quantity, the
    scenario passed to the second axis includes the change by the first axis.  prepare: function that is applied once to
    the scenario.  link, kind: for an axis of a radio link, name of the link, and "delay", "jitter" or "loss"; otherwise
    empty.
    """

    name: str
    values: Any
    unit: str
    change: Callable[[Scenario, float], Mapping[str, Any]]
    prepare: Callable[[Scenario], Scenario] = _keep_scenario
    link: str = ""
    kind: str = ""

    def check(self) -> None:
        """Raise InputError unless the values are an increasing list of two or more numbers."""
        values = np.asarray(self.values, float)
        if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            problem = f"an axis needs two or more increasing values, got {np.array2string(values, threshold=6)}"
            raise InputError(f"axis {self.name!r}", problem, fix="pass e.g. np.linspace(0.0, 0.6, 7)")


def axis_of_path(path: str, values: Any, unit: str = "", *, name: str = "") -> Axis:
    """Create an axis whose values replace a quantity, or one element of an array, e.g. "autopilot.law.K[0,1]"."""
    whole, at = split_index(path)

    def change(scenario: Scenario, value: float) -> Mapping[str, Any]:
        return {whole: value if at is None else _with_number(scenario, whole, at, lambda own: value)}

    return Axis(name or path, values, unit, change, lambda scenario: with_part_of(scenario, whole))


def _with_number(scenario: Scenario, path: str, at: tuple[int, ...], change: Callable[[Any], Any]) -> Any:
    """Return the array at a path, with the element at index `at` replaced by change(element)."""
    array = np.array(find_quantity(scenario, path)[0], float)
    if not has_index(array.shape, at):
        raise _misfit(path, array.shape)
    array[at] = change(array[at])
    return array


def _misfit(path: str, shape: tuple[int, ...]) -> InputError:
    whole = ", or scale the whole array, with values in percent" if shape else ""
    fix = f"write {first_number(path, shape)!r}{whole}"
    return InputError(
        f"axis {path!r}", f"the parameter has shape {shape}, but an axis can vary only one number", fix=fix
    )


def axis_of_scale(path: str, factors: Any, *, name: str = "") -> Axis:
    """Create an axis whose values scale a quantity: a number, an array, or one element of an array."""
    whole, at = split_index(path)

    def change(scenario: Scenario, factor: float) -> Mapping[str, Any]:
        def scale(own: Any) -> Any:
            if not np.any(own):
                problem = "the scenario's own value is 0, and a percentage of 0 is always 0"
                raise InputError(f"axis {path!r}", problem, fix="give numbers without %")
            return own * factor

        if at is not None:
            return {whole: _with_number(scenario, whole, at, scale)}
        return {whole: scale(np.asarray(find_quantity(scenario, whole)[0], float))}

    return Axis(name or path, factors, "× own", change)


def axis_of_link(kind: str, values: Any, link: str = "uplink") -> Axis:
    """Create an axis for a link's delay (s), jitter (s) or loss (probability). The link becomes a `MeasuredLatency`.

    Axis "delay": a constant replaces the link's own latency. Axis "jitter": a uniformly distributed latency from 0 to
    the axis value is added to the value of the delay axis, or without a delay axis to the link's mean latency. Axis
    "loss": each packet is lost independently with this probability. A predictor in the autopilot uses the uplink's mean
    latency, so its prediction horizon changes with a delay or jitter axis of the uplink.
    """
    for what, name, choices in (("axis", kind, KINDS), ("link", link, LINKS)):
        if name not in choices:
            raise InputError(what, f"unknown {what} {name!r}", choices=choices, fix=f"write {choices[0]!r}")
    path = f"world.{link}." + ("loss" if kind == "loss" else "latency")
    added = np.ones(NODES) if kind == "delay" else even_latencies()
    longest = 0 if kind == "loss" else seconds(round(float(np.max(np.asarray(values, float), initial=0.0)), 3))

    def change(scenario: Scenario, value: float) -> Mapping[str, Any]:
        if kind == "loss":
            return {path: value}
        latency = np.asarray(find_quantity(scenario, path)[0]) + value * added
        if link == "uplink" and scenario.autopilot.predictor is not None:
            return {path: latency, EXPECTED: mean_latency(latency)}
        return {path: latency}

    def prepare(scenario: Scenario) -> Scenario:
        channel = measured_latency(scenario, link)
        if kind == "delay":
            channel = replace(channel, latency=np.zeros(NODES))
        elif kind == "jitter":
            channel = without(channel, "jitter")
        return replace(extend_horizon(scenario, longest), world=replace(scenario.world, **{link: channel}))

    return Axis(f"{link} {kind}", values, "1" if kind == "loss" else "s", change, prepare, link, kind)


def find_quantity(scenario: Scenario, path: str) -> tuple[Any, Quantity]:
    """Return value and declaration of the quantity at a path.

    Raise InputError if the path is unknown or names an option.
    """
    value, declared = _find_leaf(scenario, path.split("."))
    if isinstance(declared, Quantity):
        return value, declared
    if declared is not None:
        problem = "is an option that changes the program, not a number that a map can vary"
        raise InputError(f"axis {path!r}", problem, fix=f"fly one map for each choice: {argument('settings', '…')}")
    known = [where for where, _, declared in leaves(scenario) if isinstance(declared, Quantity)]
    near = closest(path, known, 6) or known[:6]
    raise InputError(f"axis {path!r}", "unknown quantity", choices=near, fix=f"write {near[0]!r}")


def _find_leaf(value: Any, path: list[str]) -> tuple[Any, Any]:
    """Return value and declaration of the quantity at a path, or None and None for an unknown path."""
    for name, child, declared in children(value):
        if name == path[0] and isinstance(declared, Quantity | Option):
            return (child, declared) if len(path) == 1 else (None, None)
        if name == path[0] and len(path) > 1:
            return _find_leaf(child, path[1:])
    return None, None


def with_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """Return the scenario with changed quantities. values: path -> new value, with the shape of the old value."""
    for path, value in values.items():
        own, _ = find_quantity(scenario, path)
        if np.shape(value) != np.shape(own):
            raise _misfit(path, np.shape(own))
        scenario = with_leaf(scenario, path, lambda old, declared, value=value: value)
    return scenario


def enlarge_rings(scenario: Scenario, last: Scenario) -> Scenario:
    """Return the scenario with link buffers that are large enough for the latencies in another scenario, `last`."""
    for link in LINKS:
        channel, longest = getattr(scenario.world, link), getattr(last.world, link)
        if isinstance(channel, MeasuredLatency):
            table, capacity = np.asarray(longest.latency, float), channel.capacity
            if np.isfinite(table).all():
                capacity = max(capacity, required_slots(float(table[-1]), channel.send_period, channel.period))
            channel = replace(channel, capacity=capacity)
            scenario = replace(scenario, world=replace(scenario.world, **{link: channel}))
    return scenario
