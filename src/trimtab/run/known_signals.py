"""Signals of a scenario with shape and unit, known without a simulation. The scenario's targets are checked."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import Quantity, leaves
from trimtab.logs.metrics import check_targets
from trimtab.logs.spatial import FLIGHT, FLIGHT_DECLARED, FlightSource, find_flight, place_parameters
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import logged_signals
from trimtab.run.blocks import hold_vehicle
from trimtab.run.inputs import run_inputs
from trimtab.run.walk_structure import signal_structure


class KnownSignals(NamedTuple):
    """Signals that metrics of a scenario may use. shapes, units: path of a signal -> shape, unit.

    Derived signals such as `flight.roll` are included.  flight: source of these derived signals, or None for a vehicle
    that moves in a plane.
    """

    shapes: dict[str, tuple[int, ...]]
    units: dict[str, str]
    flight: FlightSource | None

    def source_signals(self, paths: Iterable[str]) -> tuple[str, ...]:
        """Return the sorted paths of the signals that must be logged so that the given signals can be computed."""
        source = self.flight.paths if self.flight else ()
        return tuple(sorted({one for p in paths for one in (source if p.startswith(FLIGHT) else (p,))}))


def find_signals(scenario: Scenario) -> KnownSignals:
    """Return the signals of a scenario. Raise InputError for a target whose signal the scenario does not have."""
    signals = list(logged_signals(signal_structure(run_inputs(hold_vehicle(scenario)))))
    shapes, declared = {p: tuple(np.shape(value)) for p, value, _ in signals}, {p: d for p, _, d in signals}
    flight = find_flight(shapes, declared)
    if flight is not None:
        declared |= {p: FLIGHT_DECLARED[p] for p in flight.flight_paths(shapes, scenario_place(scenario))}
        shapes |= {p: () for p in declared if p not in shapes}
    check_targets(scenario.targets, shapes, shapes.__getitem__)
    return KnownSignals(shapes, {p: d.unit for p, d in declared.items()}, flight)


def scenario_place(scenario: Scenario) -> dict[str, Any]:
    """Return path -> value of the parameters needed to compute derived signals of a flight over the rotating earth."""
    return place_parameters({p: v for p, v, d in leaves(scenario) if isinstance(d, Quantity) and np.ndim(v) == 0})
