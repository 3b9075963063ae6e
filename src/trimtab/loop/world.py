"""World: vehicle, sensors, downlink, uplink and actuators. Its input is a Command, its output a Frame of samples."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Generic

from trimtab.core.errors import InputError, argument
from trimtab.core.integrate import rk4
from trimtab.core.interfaces import optional_member
from trimtab.core.record import is_record, part, period, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import NO_GUST, Command, Frame, Sample, hold_sample
from trimtab.core.time import Instant, ms, to_seconds
from trimtab.environment.turbulence import Turbulence
from trimtab.loop.integration import PLAIN_STEP, Integration, integrate_truth
from trimtab.loop.structure import (
    cast_like,
    check_alike,
    check_output,
    check_state,
    check_vehicle,
    describe_tree,
    first_state,
    step_if,
    zeros_of_step,
)

if TYPE_CHECKING:  # default of a type parameter, which needs Python 3.13
    from typing_extensions import TypeVar

    V = TypeVar("V", default=Any)
else:
    from typing import TypeVar

    V = TypeVar("V")


@record
class WorldState:
    """State of the world: states and last outputs of its parts. Source: docs page, Time."""

    x: Any = part("State of the vehicle.")
    sensors: Any = part("State of each sensor.")
    sampled: Any = part("Last sample of each sensor.")
    downlink: Any = part("State of each sensor's downlink.")
    received: Any = part("Last sample received over each downlink.")
    uplink: Any = part("State of the uplink.")
    commanded: Any = part("Last command received over the uplink.")
    actuators: Any = part("State of the actuators.")
    actuated: Any = part("Last output of the actuators.")
    u: Any = part("Input of the vehicle, i.e. the field u of the actuators' last output.")
    integrated: Any = part(
        "Diagnostics of the integrator since the previous instant, or empty for the default integrator.", default=()
    )
    turbulence: Any = part("State of the turbulence.", default=())
    gust: Any = part("Gust velocity at the vehicle due to turbulence.", default=())


@record
class World(Generic[V]):
    """World of a loop: vehicle, sensors, links and actuators, with their imperfections.

    >>> from trimtab import build
    >>> build("hovercraft/spin").world.vehicle.mass
    2.6

    Source: docs page, Time, which describes the order of computation at one instant.
    """

    vehicle: V = part("Model of the true vehicle: dynamics and motion.")
    sensors: Any = part("Sensors: a mapping of names to sensors, or (name, sensor) pairs.")
    actuators: Any = part("Actuators, which turn commands into the vehicle's input.")
    downlink: Any = part("Channel from each sensor to the autopilot.")
    uplink: Any = part("Channel from the autopilot to the actuators.")
    max_step: int = period("Longest step of the integration.", default=ms(1))
    integration: Any = part(
        "Integration method of the true state. None: one Runge–Kutta step of order four per instant.",
        default=None,
        optional=Integration(),
    )
    turbulence: Any = part("Model of the air's turbulence. None: no turbulence.", default=None, optional=Turbulence())

    def __post_init__(self) -> None:
        if not isinstance(self.sensors, Mapping):
            object.__setattr__(self, "sensors", _sensors_by_name(self.sensors))

    def check(self) -> None:
        """Raise InputError if quaternions are to be integrated as rotations, but the vehicle names no quaternions."""
        named = optional_member(self.vehicle, "QUATERNIONS")
        if self.integration is not None and self.integration.attitude == "group" and not named:
            problem = f"attitude 'group' needs a vehicle with QUATERNIONS, but {type(self.vehicle).__name__} has none"
            fix = argument("settings", "numbers", "world.integration.attitude")
            fix += ', or write  QUATERNIONS = ("NAME",)  in the vehicle'
            raise InputError("integration.attitude", problem, fix=fix)

    def periods(self) -> list[int]:
        """Return the periods of all parts of the world."""
        parts = [*self.sensors.values(), self.actuators, self.uplink, self.downlink]
        return [p.period for p in (parts if self.turbulence is None else [*parts, self.turbulence])]

    def init(self, key: Key, x: Any) -> WorldState:
        """Return the initial state of the world, in which no sample has been measured or received.

        This state has no uplink yet: `connect` adds the uplink. x: initial state of the vehicle.
        """
        neutral = self.actuators.neutral()
        motion = check_vehicle(self.vehicle, x, neutral.u)
        states, samples, links, received = {}, {}, {}, {}
        for name, sensor in self.sensors.items():
            where = f"world.sensors.{name}"
            states[name] = first_state(where, sensor.init, key.at(f"sensors.{name}"))
            felt = _sensor_input(where, sensor, lambda: motion, x, neutral.u)
            after, samples[name] = zeros_of_step(where, "world.vehicle", sensor.step, 0, states[name], felt)
            check_state(where, sensor.step, after, states[name])
            check_output(where, sensor.step, samples[name], Sample)
            links[name] = self.downlink.init(key.at(f"downlink.{name}"), samples[name])
            _, received[name] = zeros_of_step(
                "world.downlink", where, self.downlink.step, 0, links[name], samples[name]
            )
        return WorldState(
            x=x,
            sensors=states,
            sampled=samples,
            downlink=links,
            received=received,
            uplink=(),
            commanded=(),
            actuators=self.actuators.init(key.at("actuators")),
            actuated=neutral,
            u=neutral.u,
            **self._first_gust(key),
            integrated=() if (method := self._method()) is None else method.first_report(to_seconds(self.max_step)),
        )

    def _method(self) -> Integration | None:
        """Return the integration method, or None for a single Runge–Kutta step.

        None is the default for a vehicle without events.
        """
        has_events = optional_member(self.vehicle, "events") is not None
        return PLAIN_STEP if self.integration is None and has_events else self.integration

    def _first_gust(self, key: Key) -> dict[str, Any]:
        """Return the initial state and gust of the turbulence. Raise InputError if the vehicle has no in_gust()."""
        if self.turbulence is None:
            return {}
        if optional_member(self.vehicle, "in_gust") is None:
            problem = f"{type(self.vehicle).__name__} has no in_gust(gust), so turbulence would have no effect"
            fix = "leave turbulence out, or write def in_gust(self, gust): … in the vehicle (docs, Turbulence)"
            raise InputError("world.turbulence", problem, fix=fix)
        return {"turbulence": self.turbulence.init(key.at("turbulence")), "gust": NO_GUST}

    def _vehicle_in(self, gust: Any) -> Any:
        """Return the vehicle's model, including the effect of the present gust."""
        vehicle: Any = self.vehicle
        return vehicle if self.turbulence is None else vehicle.in_gust(gust)

    def _meet_gust(self, clock: Instant, s: WorldState) -> WorldState:
        """Return the world's state with the gust at the vehicle's position updated to this instant."""
        if self.turbulence is None:
            return s

        vehicle: Any = self.vehicle

        def step() -> Any:
            return self.turbulence.step(clock.t, s.turbulence, vehicle.motion(clock.t, s.x, s.u))

        state, gust = step_if(clock.due(self.turbulence.period), step, lambda: (s.turbulence, s.gust))
        return replace(s, turbulence=state, gust=gust)

    def connect(self, key: Key, s: WorldState, command: Command) -> WorldState:
        """Return the world's state with the initial state of the uplink added. command: example of a command."""
        sample = as_sample(command, False)
        link = self.uplink.init(key.at("uplink"), sample)
        _, commanded = zeros_of_step("world.uplink", "the autopilot", self.uplink.step, 0, link, sample)
        act = self.actuators.step
        wanted, got = type(s.u).__name__, describe_tree(command.value)
        try:
            _, actuated = zeros_of_step("world.actuators", "world.uplink", act, 0, s.actuators, commanded)
        except InputError as error:
            if is_record(command.value) or not is_record(s.u):
                raise
            problem = f"the actuators need a command that is a record such as {wanted}, but the demand is {got}"
            raise InputError("autopilot.law", problem, fix=f"return demand={wanted}(…) from step()") from error
        fix = "return a demand, or a command of the allocation, with the shape of the vehicle's input"
        check_alike("world.actuators", "the actuators' output u for the vehicle", actuated.u, s.u, fix)
        actuated = cast_like(s.actuated, actuated)
        return replace(s, uplink=link, commanded=commanded, actuated=actuated, u=actuated.u)

    def sense(self, clock: Instant, s: WorldState) -> tuple[WorldState, Frame]:
        """Return the state after the steps of sensors and downlink, and the frame (samples) received by the
        autopilot."""
        t = clock.t
        s = self._meet_gust(clock, s)
        vehicle = self._vehicle_in(s.gust)
        states, samples, links, received = {}, {}, {}, {}

        def sample_sensor(name: str, sensor: Any) -> Any:
            felt = _sensor_input(name, sensor, lambda: vehicle.motion(t, s.x, s.u), s.x, s.u)
            return sensor.step(t, s.sensors[name], felt)

        for name, sensor in self.sensors.items():
            states[name], samples[name] = step_if(
                clock.due(sensor.period),
                lambda sensor=sensor, name=name: sample_sensor(name, sensor),
                lambda name=name: (s.sensors[name], hold_sample(t, s.sampled[name])),
            )
            links[name], received[name] = step_if(
                clock.due(self.downlink.period),
                lambda name=name: self.downlink.step(t, s.downlink[name], samples[name]),
                lambda name=name: (s.downlink[name], hold_sample(t, s.received[name])),
            )
        s = replace(s, sensors=states, sampled=samples, downlink=links, received=received)
        return s, Frame(t=t, samples=received)

    def act(self, clock: Instant, s: WorldState, command: Command, fresh: Any) -> WorldState:
        """Return the state after the steps of uplink and actuators. The actuators' output acts from this instant on.

        fresh: True if the command is new.
        """
        t = clock.t
        sent = hold_sample(t, as_sample(command, fresh), fresh=fresh)
        link, commanded = step_if(
            clock.due(self.uplink.period),
            lambda: self.uplink.step(t, s.uplink, sent),
            lambda: (s.uplink, hold_sample(t, s.commanded)),
        )
        state, actuated = step_if(
            clock.due(self.actuators.period),
            lambda: self.actuators.step(t, s.actuators, commanded),
            lambda: (s.actuators, s.actuated),
        )
        return replace(s, uplink=link, commanded=commanded, actuators=state, actuated=actuated, u=actuated.u)

    def drop_derived_outputs(self, s: WorldState, always: frozenset[int]) -> WorldState:
        """Return the state without outputs that are recomputed at every instant. A run is faster without them.

        always: periods of the blocks that are computed at every instant.
        """
        return replace(
            s,
            sampled={n: () if self.sensors[n].period in always else v for n, v in s.sampled.items()},
            received={n: () if self.downlink.period in always else v for n, v in s.received.items()},
            commanded=() if self.uplink.period in always else s.commanded,
            actuated=() if self.actuators.period in always else s.actuated,
        )

    def advance(self, t: Any, s: WorldState, h: Any) -> WorldState:
        """Return the world's state after integration of the true state from integer time t to t + h.

        The vehicle's input is constant during this time.
        """
        vehicle = self._vehicle_in(s.gust)

        def derivative(time: Any, x: Any) -> Any:
            return vehicle.dynamics(time, x, s.u)

        method = self._method()
        if method is None:
            x, report = rk4(derivative, to_seconds(t), s.x, to_seconds(h)), s.integrated
        else:
            x, report = integrate_truth(method, vehicle, s.u, to_seconds(t), s.x, to_seconds(h), s.integrated)
        if (settle := optional_member(self.vehicle, "after_step")) is not None:
            x = settle(to_seconds(t + h), x)
        return replace(s, x=x, integrated=report)


def _sensor_input(where: str, sensor: Any, motion: Callable[[], Any], x: Any, u: Any) -> Any:
    """Return the input of a sensor: the vehicle's motion, state or input, as the sensor's class variable FEELS says."""
    inputs = {"motion": motion, "state": lambda: x, "input": lambda: u}
    feels = optional_member(sensor, "FEELS")
    if feels not in inputs:
        problem = f"{type(sensor).__name__} has FEELS = {feels!r}, which is not a quantity that the world provides"
        raise InputError(where, problem, choices=inputs, fix='write FEELS = "motion", or leave it out')
    return inputs[feels]()


def as_sample(command: Command, fresh: Any) -> Sample:
    """Return a command as a sample that the uplink can carry."""
    return Sample(value=command.value, t=command.t, age=0.0, fresh=fresh, valid=command.valid)


def _sensors_by_name(pairs: Any) -> dict[str, Any]:
    named: dict[str, Any] = {}
    if not isinstance(pairs, tuple | list) or any(not isinstance(pair, tuple) or len(pair) != 2 for pair in pairs):
        problem = f"must be a mapping of names to sensors, got {describe_tree(pairs)}"
        raise InputError("world.sensors", problem, fix='write sensors={"NAME": SENSOR}')
    for name, sensor in pairs:
        if name in named:
            problem = f"two sensors are named {name!r}: {type(named[name]).__name__} and {type(sensor).__name__}"
            raise InputError("world.sensors", problem, fix=f"give one of them another name, e.g. '{name}2'")
        named[name] = sensor
    return named
