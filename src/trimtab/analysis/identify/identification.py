"""Identification of a scenario's vehicle and actuators from logs.

The logged commands are the input of the scenario's actuator models. The output of these models, delayed by an unknown
time, drives the vehicle model from one measurement to the next. The measurements are fields of the vehicle's state,
such as the pose from a motion capture system.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.analysis.identify.flight_data import (
    GAP,
    FlightData,
    actuate,
    fill_gaps,
    find_grid,
    lay_on_grid,
    mean_input,
    refuse_copies,
)
from trimtab.analysis.identify.maximum_likelihood import (
    LikelihoodEstimate,
    Model,
    Timeline,
    compare_flights,
    compile_likelihood,
    maximise_likelihood,
    name_collinear,
    profile_intervals,
)
from trimtab.core.integrate import rk4
from trimtab.core.quantity import Quantity, leaves
from trimtab.core.record import replace, to_arrays, with_leaf
from trimtab.core.time import UNITS_PER_SECOND
from trimtab.logs.consistency import whiteness
from trimtab.loop.scenario import Scenario
from trimtab.run.fit_parameters import DELAY, FitParameter, find_parameters, find_scale

UNMEASURED = 2.0
"""Initial standard deviation (SI units) of a state that is not measured. The absolute value of the scenario's initial
state is added. The filter is initialised at the start of a log and after each long gap."""
NOISE_START = {"m": 5e-3, "rad": 5e-3, "m/s": 2e-2, "rad/s": 2e-2}
PROCESS_START = {"m/s": 1e-3, "rad/s": 1e-2}
"""Start value of the process noise intensity in (unit)² per second, by the unit of the state."""
LEAST_PROCESS = math.log(1e-8)
"""Logarithm of the smallest process noise intensity: every model is assumed to err by 0.1 mm/s or 0.1 mrad/s in 1 s."""
HORIZON = 1.0
"""Prediction horizon (s) at which a fitted model is compared with the measurements."""
EXPLAINED = 0.5
"""Largest rms prediction error of a field, as a fraction of the field's rms change, if the model explains the field."""
CORRELATED = 0.5
"""Correlation of successive innovations above which the sensor's errors count as correlated in time."""
AGREEING = 1e-4
"""Significance level. At a smaller p-value, a flight disagrees with the other flights."""


class Identified(NamedTuple):
    """Identified parameters. values: parameter values (m,).  intervals: 95 % intervals (m, 2).

    groups: groups of parameters that the data cannot distinguish.
    noise: state field -> standard deviation of the measurements.  process: state field -> process noise intensity
    (unit²/s).
    unexplained: fields whose rms prediction error over the time `HORIZON`, in the fitted flights, is not much smaller
    than their rms change in that time -> (error, change). The cause is a wrong model, or wrong units, signs or axes in
    the log.
    correlated: fields with a large correlation of successive innovations -> correlation. Only listed if a field is
    unexplained. The sensor errors are then not white noise, and the fit attributes the law's reaction to the errors to
    the vehicle.
    disagreeing: name of a fitted flight that does not agree with the others on the parameters -> p-value.
    held_out: field -> rms prediction errors over the time `HORIZON` in flights that were not fitted, with nominal and
    with fitted parameters.
    """

    parameters: tuple[FitParameter, ...]
    values: Any
    standard_errors: Any
    intervals: Any
    groups: tuple[tuple[str, ...], ...]
    noise: Mapping[str, float]
    process: Mapping[str, float]
    held_out: Mapping[str, tuple[float, float]]
    estimate: LikelihoodEstimate
    nominal_log_likelihood: float
    covariance: Any
    unexplained: Mapping[str, tuple[float, float]] = {}
    correlated: Mapping[str, float] = {}
    disagreeing: Mapping[str, float] = {}

    def unidentifiable(self) -> set[str]:
        """Return the paths of the parameters that the data cannot determine, alone or at all."""
        unbounded = {p.path for p, i in zip(self.parameters, self.intervals, strict=True) if not np.isfinite(i).any()}
        return unbounded.union(*self.groups)


def identify(
    scenario: Scenario,
    flights: Sequence[FlightData],
    paths: Sequence[str],
    *,
    held_out: Sequence[FlightData] = (),
    tell: Callable[[str, int, float], None] = lambda stage, iteration, value: None,
) -> Identified:
    """Fit parameters of a scenario's vehicle and actuators to flights, and return the result.

    Args:
        scenario: scenario with the nominal parameter values, at which the search starts.
        flights: flights to fit.
        paths: parameters to fit: settings below world.vehicle and world.actuators, and "delay".
        held_out: flights for validation, on which nominal and fitted values are compared.
        tell: function that is called with stage, iteration and log likelihood, e.g. to show the progress.

    Raises: InputError for parameters that can't be fitted.
    """
    refuse_copies(flights, held_out)
    (found,) = _identify_groups(scenario, [flights], paths, held_out, tell)
    return found


def identify_each(scenario: Scenario, flights: Sequence[FlightData], paths: Sequence[str]) -> list[Identified]:
    """Fit parameters of a scenario's vehicle and actuators to each flight separately, and return the results.

    The results of the flights can be compared by their intervals. For flights of the same length, with measurements at
    the same times, the likelihood is compiled once.  Raises: as `identify`.
    """
    return _identify_groups(scenario, [[flight] for flight in flights], paths, (), lambda stage, iteration, value: None)


def _identify_groups(
    scenario: Scenario,
    groups: Sequence[Sequence[FlightData]],
    paths: Sequence[str],
    held_out: Sequence[FlightData],
    tell: Callable[[str, int, float], None],
) -> list[Identified]:
    """Return the parameters identified from each group of flights."""
    scenario, parameters = find_parameters(scenario, paths)
    world = _IdentifiedWorld(scenario, parameters, [flight for group in groups for flight in group])
    return [_identify_group(world, group, held_out, tell) for group in groups]


def _identify_group(
    world: "_IdentifiedWorld",
    flights: Sequence[FlightData],
    held_out: Sequence[FlightData],
    tell: Callable[[str, int, float], None],
) -> Identified:
    """Return the parameters identified from one group of flights."""
    parameters, timeline, first = world.parameters, world.timeline(flights), world.start()
    m, count = len(parameters), len(first)
    noise_only = np.arange(count) >= m
    low, high = world.bounds()

    def maximise(stage: str, start: Any, free: Any) -> LikelihoodEstimate:
        told = functools.partial(tell, stage)
        return maximise_likelihood(world.likelihood, timeline, start, low, high, free=free, tell=told)

    nominal = maximise("noise", first, noise_only)
    found = maximise("parameters", nominal.p, None)
    scaled = found.information[:m, :m]
    groups = tuple(name_collinear(scaled, [p.path for p in parameters]))
    covariance = np.linalg.pinv(found.information, rcond=1e-12, hermitian=True)[:m, :m]
    tell("intervals", 0, found.log_likelihood)
    intervals = profile_intervals(world.likelihood, timeline, found, range(m), ~noise_only)
    unit = world.scale[:m]
    start = np.array([p.start for p in parameters])
    scores = world.predict_held_out(held_out, nominal.p, found.p) if held_out else {}
    noise, process = world.noise_of(found.p)
    unexplained = world.find_unexplained(flights, found.p, noise)
    return Identified(
        parameters,
        start + unit * found.p[:m],
        unit * np.sqrt(np.maximum(np.diagonal(covariance), 0)),
        start[:, None] + unit[:, None] * intervals,
        groups,
        noise,
        process,
        scores,
        found,
        nominal.log_likelihood,
        covariance * np.outer(unit, unit),
        unexplained,
        world.find_correlated(timeline, found.p) if unexplained else {},
        world.find_disagreeing(flights, timeline, found, {name for group in groups for name in group}),
    )


class _IdentifiedWorld:
    """Model to fit: vehicle, actuators and noise as functions of a vector of unknowns.

    The vector contains (parameters - start)/scale, the logarithms of the measurement noise variances, and those of the
    process noise intensities.
    """

    def __init__(self, scenario: Scenario, parameters: tuple[FitParameter, ...], flights: Sequence[FlightData]) -> None:
        self.parameters = parameters
        fan = scenario.world.actuators
        thruster = any(".actuators.thruster." in p.path for p in parameters)
        self.tabulated = getattr(fan, "table", None) is not None and (thruster or fan.table.origin == "formula")
        actuators = replace(fan, table=None) if self.tabulated else fan
        self.world = to_arrays(replace(scenario.world, actuators=actuators, sensors={}))
        state = to_arrays(scenario.initial)
        leaves_, self.tree = jax.tree.flatten(state)
        self.fields = [path for path, _, _ in leaves(scenario.initial)]
        self.units = [d.unit for _, _, d in leaves(scenario.initial) if isinstance(d, Quantity)]
        angles = [d.kind == "angle" for _, _, d in leaves(scenario.initial)]
        self.size, self.initial = len(leaves_), np.array(leaves_, np.float64)
        seen = np.array([np.isfinite(f.y).any(axis=0) for f in flights]).any(axis=0)
        self.measured = tuple(int(i) for i in np.flatnonzero(seen))
        self.wraps = tuple(angles[i] for i in self.measured)
        self.scale = np.array([find_scale(p) for p in parameters])
        self.driven = self._driven_fields()
        self.grid = find_grid(actuators)
        self.likelihood = compile_likelihood(self._model())

    def start(self) -> Any:
        """Return the unknowns at which the search starts."""
        r = [math.log(NOISE_START.get(self.units[i], 1e-2) ** 2) for i in self.measured]
        q = [math.log(PROCESS_START.get(self.units[i], 1e-3)) for i in self.driven]
        return np.array([*(0.0 for _ in self.parameters), *r, *q])

    def bounds(self) -> tuple[Any, Any]:
        """Return lower and upper bounds of the unknowns."""
        ends = [
            ((p.low - p.start) / s, (p.high - p.start) / s) for p, s in zip(self.parameters, self.scale, strict=True)
        ]
        ends += [(-32.0, 4.0)] * len(self.measured) + [(LEAST_PROCESS, 4.0)] * len(self.driven)
        low, high = np.array(ends).T
        return low, high

    def _model(self) -> Model:
        """Return the model to fit. The inputs of the model are computed from the field `drive` of a `Timeline`."""
        m, k = len(self.parameters), len(self.measured)
        spread = (UNMEASURED + np.abs(self.initial)) ** 2
        spread[list(self.measured)] = [(5 * NOISE_START.get(self.units[i], 1e-2)) ** 2 for i in self.measured]

        def step(p: Any, x: Any, u: Any, h: Any) -> Any:
            vehicle = self._world_at(p).vehicle
            new = rk4(lambda t, x: vehicle.dynamics(t, x, u), 0.0, jax.tree.unflatten(self.tree, list(x)), h)
            return jnp.stack(jax.tree.leaves(new))

        def inputs(p: Any, drive: Any) -> Any:
            delay, actuators = self._delay(p), self._world_at(p).actuators
            parts = [
                mean_input(
                    actuate(actuators, self.grid, rows) if self._fits_actuators() else rows, self.grid, at, delay
                )
                for rows, at in drive
            ]
            return jax.tree.map(lambda *v: jnp.concatenate(v), *parts)

        def process(p: Any) -> Any:
            return jnp.zeros(self.size).at[jnp.array(self.driven)].set(jnp.exp(p[m + k :]))

        return Model(step, inputs, process, lambda p: jnp.exp(p[m : m + k]), self.measured, self.wraps, spread)

    def predict_held_out(
        self, flights: Sequence[FlightData], nominal: Any, fitted: Any
    ) -> dict[str, tuple[float, float]]:
        """Return field -> rms prediction errors over the time `HORIZON`, with nominal and with fitted parameters."""
        timeline = self.timeline(flights)
        when = np.concatenate([np.cumsum(np.where(b, 0.0, h)) for h, b in timeline.segments()])
        rows: dict[str, list[float]] = {self.fields[i]: [] for i in self.measured}

        for p in (nominal, fitted):
            total, number = np.zeros(len(self.measured)), np.zeros(len(self.measured))
            for phase in (0, 1):
                blind = (when / HORIZON).astype(int) % 2 == phase
                sighted = timeline._replace(seen=timeline.seen & ~blind[:, None])
                x = np.asarray(self.likelihood.innovations(sighted, p).x)
                late = blind & (when % HORIZON > 0.5 * HORIZON)
                for j, i in enumerate(self.measured):
                    e = timeline.y[:, j] - x[:, i]
                    e = (e + np.pi) % (2 * np.pi) - np.pi if self.wraps[j] else e
                    good = late & timeline.seen[:, j]
                    total[j] += float(np.sum(e[good] ** 2))
                    number[j] += int(good.sum())
            for j, i in enumerate(self.measured):
                rows[self.fields[i]].append(math.sqrt(total[j] / max(number[j], 1)))
        return {field: (a, b) for field, (a, b) in rows.items()}

    def find_unexplained(
        self, flights: Sequence[FlightData], fitted: Any, noise: Mapping[str, float]
    ) -> dict[str, tuple[float, float]]:
        """Return the fields that the fitted model predicts hardly better than a constant would, see `Identified`."""
        found = self.predict_held_out(flights, fitted, fitted)
        unexplained = {}
        for i, wraps in zip(self.measured, self.wraps, strict=True):
            name, squares = self.fields[i], [np.zeros(0)]
            for flight in flights:
                seen = np.isfinite(flight.y[:, i])
                t, y = flight.ticks[seen] / UNITS_PER_SECOND, flight.y[seen, i]
                later = np.searchsorted(t, t + 0.75 * HORIZON)
                good = later < len(t)
                good[good] &= t[later[good]] - t[good] < 1.25 * HORIZON
                e = y[later[good]] - y[good]
                squares.append((((e + np.pi) % (2 * np.pi) - np.pi) if wraps else e) ** 2)
            every = np.concatenate(squares)
            change = math.sqrt(float(np.mean(every))) if len(every) else math.inf
            if found[name][1] > max(EXPLAINED * change, 5 * noise[name]):
                unexplained[name] = found[name][1], change
        return unexplained

    def find_correlated(self, timeline: Timeline, fitted: Any) -> dict[str, float]:
        """Return the fields whose successive innovations have a large correlation, with the correlation."""
        innovations, found = self.likelihood.innovations(timeline, fitted), {}
        z = np.asarray(innovations.e) / np.sqrt(np.asarray(innovations.s))
        for j, i in enumerate(self.measured):
            correlation = float(whiteness(z[timeline.seen[:, j], j], lags=1).correlation[0])
            if correlation > CORRELATED:
                found[self.fields[i]] = correlation
        return found

    def find_disagreeing(
        self, flights: Sequence[FlightData], timeline: Timeline, found: LikelihoodEstimate, unidentifiable: set[str]
    ) -> dict[str, float]:
        """Return the flights that disagree with the others on the identifiable parameters, with their p-values."""
        low, high = self.bounds()
        kept = (found.p > low) & (found.p < high) & (np.arange(len(found.p)) < len(self.parameters))
        kept[: len(self.parameters)] &= [p.path not in unidentifiable for p in self.parameters]
        chances = compare_flights(self.likelihood, timeline, found.p, kept)
        return {f.name: chance for f, chance in zip(flights, chances, strict=True) if chance < AGREEING}

    def noise_of(self, p: Any) -> tuple[dict[str, float], dict[str, float]]:
        """Return standard deviation of the measurements of each field, and process noise intensity of each field."""
        m, k = len(self.parameters), len(self.measured)
        noise = {self.fields[i]: float(np.exp(v / 2)) for i, v in zip(self.measured, p[m : m + k], strict=True)}
        return noise, {self.fields[i]: float(np.exp(v)) for i, v in zip(self.driven, p[m + k :], strict=True)}

    def _world_at(self, p: Any) -> Any:
        world = self.world
        for k, (parameter, scale) in enumerate(zip(self.parameters, self.scale, strict=True)):
            if parameter.path == DELAY:
                continue
            base, index = parameter.path.removeprefix("world.").partition("[")[0], parameter.path.partition("[")[2]
            at = tuple(int(i) for i in index.rstrip("]").split(",")) if index else None
            value = parameter.start + scale * p[k]

            def change(old: Any, _: Any, at: Any = at, value: Any = value) -> Any:
                return value if at is None else jnp.asarray(old).at[at].set(value)

            world = with_leaf(world, base, change)
        return world

    def _delay(self, p: Any) -> Any:
        at = next((k for k, q in enumerate(self.parameters) if q.path == DELAY), None)
        return 0.0 if at is None else self.parameters[at].start + self.scale[at] * p[at]

    def _fits_actuators(self) -> bool:
        return any(p.path.startswith("world.actuators.") for p in self.parameters)

    def _driven_fields(self) -> tuple[int, ...]:
        """Return indices of the state fields whose time derivatives depend on input or parameters.

        Only the fields with these indices have process noise.
        """
        vehicle, neutral = self.world.vehicle, to_arrays(self.world.actuators.neutral().u)
        rng = np.random.default_rng(0)
        x = jax.tree.unflatten(self.tree, list(0.5 + rng.uniform(size=self.size)))
        u = jax.tree.map(lambda v: jnp.asarray(v) + 0.3, neutral)

        def rates(vehicle: Any, u: Any) -> Any:
            return jnp.stack(jax.tree.leaves(vehicle.dynamics(0.0, x, u)))

        floats = jax.tree.map(lambda v: jnp.asarray(v, float), vehicle)
        slopes = jax.tree.leaves(jax.jacfwd(rates, argnums=(0, 1))(floats, u))
        size = sum(np.abs(np.asarray(s)).reshape(self.size, -1).sum(1) for s in slopes)
        return tuple(int(i) for i in np.flatnonzero(size > 0))

    def timeline(self, flights: Sequence[FlightData]) -> Timeline:
        """Return all flights joined end to end.

        `drive` contains the actuator outputs, or the commands if actuators are fitted.
        """
        rows, drive = [], []
        for flight in flights:
            y = flight.y[:, list(self.measured)]
            there = np.isfinite(y).any(1)
            ticks, y = flight.ticks[there], y[there]
            instants, at = fill_gaps(ticks)
            h = np.diff(instants, prepend=instants[0]) / UNITS_PER_SECOND
            begins = np.zeros(len(instants), bool)
            begins[at[1:][np.diff(ticks) > GAP * UNITS_PER_SECOND]] = True
            begins[0] = True
            values, seen = np.zeros((len(instants), y.shape[1])), np.zeros((len(instants), y.shape[1]), bool)
            values[at], seen[at] = np.nan_to_num(y), np.isfinite(y)
            first = np.tile(self.initial, (len(instants), 1))
            first[:, list(self.measured)] = values
            owner = np.full(len(instants), len(rows))
            rows.append((np.where(begins, 0.0, h), begins, values, seen, first, owner))
            commanded = lay_on_grid(self.grid, flight)
            given = commanded if self._fits_actuators() else actuate(self.world.actuators, self.grid, commanded)
            drive.append((given, (instants - commanded.t[0]) / self.grid))
        h, begins, y, seen, first, owner = (np.concatenate(v) for v in zip(*rows, strict=True))
        return Timeline(h, begins, y, seen, first, drive, owner)
