"""Campaign over plants that differ from the model: random coefficients, a disturbance and noise.

The command is +3000 ft and +500 ft/s from the trim of the model, in 100 s. Law and filter use the nominal vehicle.
A plant starts at the model's trim, with the static deflection of its own modes. It does not start at its own trim,
because that would be unknown in flight.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206: names impulses, steps and parameter variation as further work.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import replace
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.flexible.discrete import EQUAL_Q
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.path_inversion import InputLimits
from trimtab.laws.stable_inversion import FitRange
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.hypersonic._flight import hypersonic_scenario
from trimtab.scenarios.hypersonic._internal import level_points, quasi_static_states
from trimtab.vehicles.hypersonic import Disturbance, Hypersonic

NOMINAL = Hypersonic()
CLIMB, LENGTH = FilteredClimb(dh=3000.0, dV=500.0), 100.0
LATE = 20.0
"""Duration (s) at the end of a flight over which errors and saturation are evaluated."""
OFF = 30.0, 5.0
"""Largest accepted errors of h (ft) and V (ft/s) at the end of a flight: 1 % of the command."""
PARTS = {
    "": ("m", "Iyy"),
    "forces.atmosphere.": ("rho0",),
    "forces.aerodynamics.": (
        *("CL_a", "CL_d", "CL_0", "CD_a2", "CD_a", "CD_d2", "CD_d", "CD_0"),
        *("CM_a2", "CM_a", "CM_0", "ce"),
    ),
    "forces.propulsion.": ("zT", *(f"b{i}" for i in range(1, 9))),
    "modes.": (
        *("w1", "w2", "zeta1", "zeta2", "psi1", "psi2"),
        *("N1_a2", "N1_a", "N1_0", "N2_a2", "N2_a", "N2_d", "N2_0"),
    ),
}
COEFFICIENTS = tuple(part + name for part, names in PARTS.items() for name in names)
"""Parameters that are varied, as paths below the vehicle."""
KEPT = ("g", "forces.atmosphere.h0", "forces.atmosphere.hs", "forces.aerodynamics.S", "forces.aerodynamics.c")
"""Fixed parameters: gravity, the atmosphere's shape, and two lengths that only multiply varied ones."""
NAMES = tuple(path.rpartition(".")[2] for path in COEFFICIENTS)
WEIGHT = NOMINAL.m * NOMINAL.g
ONSET, SHORT = 20.0, 0.05
"""Start of disturbances, and duration of an impulse (s)."""
DISTURBANCES = {
    "none": Disturbance(),
    "moment impulse": Disturbance(moment=0.4 * NOMINAL.Iyy, start=ONSET, duration=SHORT),
    "normal-force impulse": Disturbance(normal=20.0 / SHORT * NOMINAL.m, start=ONSET, duration=SHORT),
    "moment step": Disturbance(moment=5000.0, start=ONSET),
    "drag step": Disturbance(along=-88.0, start=ONSET),
    "lift step": Disturbance(normal=-0.02 * WEIGHT, start=ONSET),
}
"""Name -> disturbance, with the sizes of the scenarios `hypersonic/impulse` and `hypersonic/step-gust`."""
KINDS = tuple(DISTURBANCES)
SIGNALS = ("law.h_error", "law.V_error", "law.saturated", "law.outside")
CHUNK = 2048


class FlightOutcomes(NamedTuple):
    """Outcome of each run (n,).

    lacks_trim: True if no level trim exists at the start or end of the command, within limits and fit range.
    lost: True if the flight left 80-95 kft, 7-9 kft/s or 0-4 deg of alpha.
    is_saturated: True if an input was at its limit in the last 20 s.
    h, V: largest errors in the last 20 s (ft, ft/s), infinite if the flight diverged.
    """

    lacks_trim: Any
    lost: Any
    is_saturated: Any
    h: Any
    V: Any

    @property
    def is_off(self) -> Any:
        """True for runs whose errors at the end exceed OFF."""
        return (self.h > OFF[0]) | (OFF[1] < self.V)

    @property
    def is_success(self) -> Any:
        """True for runs that have a trim, were not lost or saturated, and end within OFF."""
        return ~(self.lacks_trim | self.lost | self.is_saturated | self.is_off)


@cache
def build_scenario(integral: bool, Q: tuple[float, ...] = EQUAL_Q) -> Scenario:
    """Return the scenario before parameters are varied. Q: process noise of the filter."""
    plant = replace(NOMINAL, disturbance=Disturbance())
    made = hypersonic_scenario("campaign", CLIMB, LENGTH, plant=plant, noise="on", integral="on" if integral else "off")
    return replace(made, autopilot=replace(made.autopilot, estimator=replace(made.autopilot.estimator, Q=Q)))


def draw_factors(size: float, runs: int, seed: int) -> Any:
    """Draw factors of the coefficients (runs, 37), independent and uniform in 1 +- size."""
    return 1 + size * np.random.default_rng(seed).uniform(-1, 1, (runs, len(COEFFICIENTS)))


def build_plants(factors: Any) -> Hypersonic:
    """Return the plants as one record of arrays (n,), nominal values times factors (n, 37)."""
    values = dict(zip(COEFFICIENTS, np.asarray(factors).T, strict=True))
    parts: dict[str, Any] = {}
    for part, names in PARTS.items():
        found = NOMINAL
        for step in part.split(".")[:-1]:
            found = getattr(found, step)
        parts[part] = replace(found, **{n: getattr(found, n) * values[part + n] for n in names})
    below = {name: parts[f"forces.{name}."] for name in ("atmosphere", "aerodynamics", "propulsion")}
    return replace(parts[""], forces=replace(NOMINAL.forces, **below), modes=parts["modes."])


def fly_plants(
    factors: Any, kinds: Any, *, integral: bool, seeds: Any = None, Q: tuple[float, ...] = EQUAL_Q
) -> FlightOutcomes:
    """Fly each plant.

    Args:
        factors: factors of the coefficients (n, 37).
        kinds: index of the disturbance in KINDS (n,).
        integral: True for integral action in the law.
        seeds: seeds of the noise (n,). None means a different seed for each run.
        Q: process noise of the filter, diagonal (4,).
    """
    factors, kinds = np.asarray(factors), np.asarray(kinds)
    seeds = np.arange(len(factors)) if seeds is None else np.asarray(seeds)
    parts = [slice(a, a + CHUNK) for a in range(0, len(factors), CHUNK)]
    found = [_fly_chunk(build_scenario(integral, Q), build_plants(factors[p]), kinds[p], seeds[p]) for p in parts]
    return FlightOutcomes(
        find_untrimmed(build_plants(factors)), *(np.concatenate(values) for values in zip(*found, strict=True))
    )


def find_untrimmed(craft: Hypersonic) -> Any:
    """Return True for plants (n,) without level trim, within limits and fit range, at start or end of the command."""
    limits, fit, n = InputLimits(), FitRange(), len(np.asarray(craft.m))
    end = CLIMB.at(LENGTH)
    without = np.zeros(n, bool)
    for h, V in ((CLIMB.h0, CLIMB.V0), (float(end.h), float(end.V))):
        zeta, u, found = quasi_static_states(craft, level_points(np.full(n, h), np.full(n, V)))
        Phi = (limits.Phi_low <= u[0]) & (u[0] <= limits.Phi_high)
        delta = (limits.delta_low <= u[1]) & (u[1] <= limits.delta_high)
        alpha = (fit.alpha[0] <= zeta[0]) & (zeta[0] <= fit.alpha[1])
        without |= ~(found & Phi & delta & alpha)
    return without


def _fly_chunk(flown: Scenario, craft: Hypersonic, kinds: Any, seeds: Any) -> tuple[Any, Any, Any, Any]:
    spread: dict[str, Any] = {}
    for path in COEFFICIENTS:
        value: Any = craft
        for step in path.split("."):
            value = getattr(value, step)
        spread[f"world.vehicle.{path}"] = value
    for name in ("moment", "along", "normal", "start", "duration"):
        sizes = np.array([float(getattr(d, name)) for d in DISTURBANCES.values()])
        spread[f"world.vehicle.disturbance.{name}"] = sizes[kinds]
    eta1, eta2 = craft.modes.static_displacements(flown.initial.alpha, flown.world.actuators.neutral_input.delta_e)
    spread |= {"initial.eta1": eta1, "initial.eta2": eta2}
    batch = simulate_batch(flown, seeds=seeds, spread=spread, signals=SIGNALS, log_period=ms(100), log=True)
    late = to_seconds(batch.ticks) >= LENGTH - LATE
    h, V, saturated, outside = (batch.log[path] for path in SIGNALS)
    worst = (np.abs(values[:, late]).max(axis=1) for values in (h, V))
    ended = [np.where(np.isfinite(values), values, np.inf) for values in worst]
    return (outside != 0).any(axis=1), (saturated[:, late] != 0).any(axis=1), ended[0], ended[1]
