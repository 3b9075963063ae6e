"""The World: truth, sensors, downlink, uplink and actuators. It takes a Command and gives a Frame."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Generic

from trimtab.core.errors import InputError, argument
from trimtab.core.integrate import rk4
from trimtab.core.interfaces import optional_member
from trimtab.core.record import part, period, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import NO_GUST, Command, Frame, Sample, hold_sample
from trimtab.core.time import Instant, ms, to_seconds
from trimtab.environment.turbulence import Turbulence
from trimtab.loop.integration import Integration, integrate_truth
from trimtab.loop.structure import cast_like, check_alike, step_if, zeros_of, zeros_of_step

if TYPE_CHECKING:  # a default of a type's parameter: Python 3.13
    from typing_extensions import TypeVar

    V = TypeVar("V", default=Any)
else:
    from typing import TypeVar

    V = TypeVar("V")


@record
class WorldState:
    """Everything about the world that changes. Source: docs page, Time."""

    x: Any = part("State of the vehicle.")
    sensors: Any = part("State of each sensor.")
    sampled: Any = part("Last sample of each sensor.")
    downlink: Any = part("State of each sensor's downlink.")
    received: Any = part("Last sample that came out of each downlink.")
    uplink: Any = part("State of the uplink.")
    commanded: Any = part("Last command that came out of the uplink.")
    actuators: Any = part("State of the actuators.")
    actuated: Any = part("Last output of the actuators.")
    u: Any = part("What acts on the vehicle: the field u of that output.")
    integrated: Any = part("What the integration up to now says of itself; nothing of a plain step.", default=())
    turbulence: Any = part("State of the turbulence.", default=())
    gust: Any = part("What it adds to the air about the vehicle.", default=())


@record
class World(Generic[V]):
    """Vehicle, sensors, radio and actuators, with their faults.

    >>> from trimtab import build
    >>> build("hovercraft/spin").world.vehicle.mass
    2.6

    Source: docs page, Time, for the order of things at one instant.
    """

    vehicle: V = part("The truth: dynamics and motion.")
    sensors: Any = part("Sensors by name: a mapping, or (name, sensor) pairs.")
    actuators: Any = part("What turns commands into the vehicle's input.")
    downlink: Any = part("Channel from each sensor to the autopilot.")
    uplink: Any = part("Channel from the autopilot to the actuators.")
    max_step: int = period("Longest step of the integration.", default=ms(1))
    integration: Any = part(
        "How the truth is integrated; None: one Runge–Kutta step of order four.", default=None, optional=Integration()
    )
    turbulence: Any = part("What the vehicle flies through; None: still air.", default=None, optional=Turbulence())

    def __post_init__(self) -> None:
        if not isinstance(self.sensors, Mapping):
            object.__setattr__(self, "sensors", _sensors_by_name(self.sensors))

    def check(self) -> None:
        """Refuse to turn quaternions that the vehicle doesn't name."""
        named = optional_member(self.vehicle, "QUATERNIONS")
        if self.integration is not None and self.integration.attitude == "group" and not named:
            problem = f"{type(self.vehicle).__name__} names no quaternion of its state that could be turned"
            fix = argument("settings", "numbers", "world.integration.attitude")
            fix += ', or write  QUATERNIONS = ("NAME",)  in the vehicle'
            raise InputError("integration.attitude", problem, fix=fix)

    def periods(self) -> list[int]:
        """The periods of everything in the world."""
        parts = [*self.sensors.values(), self.actuators, self.uplink, self.downlink]
        return [p.period for p in (parts if self.turbulence is None else [*parts, self.turbulence])]

    def init(self, key: Key, x: Any) -> WorldState:
        """The world at rest: no sample taken, nothing received. The uplink follows when the command is known."""
        neutral = self.actuators.neutral()
        motion = _check_vehicle(self.vehicle, x, neutral.u)
        states, samples, links, received = {}, {}, {}, {}
        for name, sensor in self.sensors.items():
            states[name] = sensor.init(key.at(f"sensors.{name}"))
            where = f"world.sensors.{name}"
            felt = _sensor_input(where, sensor, lambda: motion, x, neutral.u)
            _, samples[name] = zeros_of_step(where, "world.vehicle", sensor.step, 0, states[name], felt)
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
        """What integrates, or None for the plain step, which locates no events."""
        has_events = optional_member(self.vehicle, "events") is not None
        return Integration() if self.integration is None and has_events else self.integration

    def _first_gust(self, key: Key) -> dict[str, Any]:
        """State of the turbulence and its gust before the first instant; refuses a vehicle that would not feel it."""
        if self.turbulence is None:
            return {}
        if optional_member(self.vehicle, "in_gust") is None:
            problem = f"{type(self.vehicle).__name__} has no in_gust(gust), so that it would not feel any"
            fix = "leave it out, or def in_gust(self, gust): …  in a vehicle that feels the air (docs, Turbulence)"
            raise InputError("world.turbulence", problem, fix=fix)
        return {"turbulence": self.turbulence.init(key.at("turbulence")), "gust": NO_GUST}

    def _vehicle_in(self, gust: Any) -> Any:
        """The vehicle, in the air as it is now."""
        vehicle: Any = self.vehicle
        return vehicle if self.turbulence is None else vehicle.in_gust(gust)

    def _meet_gust(self, clock: Instant, s: WorldState) -> WorldState:
        """The state with the gust of this instant, which the turbulence makes of where the vehicle is."""
        if self.turbulence is None:
            return s

        vehicle: Any = self.vehicle

        def step() -> Any:
            return self.turbulence.step(clock.t, s.turbulence, vehicle.motion(clock.t, s.x, s.u))

        state, gust = step_if(clock.due(self.turbulence.period), step, lambda: (s.turbulence, s.gust))
        return replace(s, turbulence=state, gust=gust)

    def connect(self, key: Key, s: WorldState, command: Command) -> WorldState:
        """The world with an uplink for commands of this structure."""
        sample = as_sample(command, False)
        link = self.uplink.init(key.at("uplink"), sample)
        _, commanded = zeros_of_step("world.uplink", "the autopilot", self.uplink.step, 0, link, sample)
        act = self.actuators.step
        _, actuated = zeros_of_step("world.actuators", "world.uplink", act, 0, s.actuators, commanded)
        fix = "a demand, or what the allocation makes of it, has another shape than the vehicle's input"
        check_alike("world.actuators", "what they give the vehicle", actuated.u, s.u, fix)
        actuated = cast_like(s.actuated, actuated)
        return replace(s, uplink=link, commanded=commanded, actuated=actuated, u=actuated.u)

    def sense(self, clock: Instant, s: WorldState) -> tuple[WorldState, Frame]:
        """Truth, sensors, downlink: the frame that the autopilot holds at this instant."""
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
        """Uplink and actuators, from this instant on."""
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
        """The state without outputs that are made anew at every instant, so that a run does not carry them along."""
        return replace(
            s,
            sampled={n: () if self.sensors[n].period in always else v for n, v in s.sampled.items()},
            received={n: () if self.downlink.period in always else v for n, v in s.received.items()},
            commanded=() if self.uplink.period in always else s.commanded,
            actuated=() if self.actuators.period in always else s.actuated,
        )

    def advance(self, t: Any, s: WorldState, h: Any) -> WorldState:
        """The truth integrated from integer time t over integer time h, the actuators' output held."""
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


def _check_vehicle(vehicle: Any, x: Any, u: Any) -> Any:
    """A motion, every number zero; refuses what is no vehicle, and a derivative that is none of its state."""
    for name in ("dynamics", "motion"):
        if not callable(getattr(vehicle, name, None)):
            problem = f"{type(vehicle).__name__} has no {name}(t, x, u)"
            raise InputError("world.vehicle", problem, fix=f"def {name}(self, t, x, u): …  in it (docs, Add a vehicle)")
    motion = zeros_of("world.vehicle.motion", "the vehicle's state", vehicle.motion, 0, x, u)
    part = "world.vehicle.dynamics"
    rate = zeros_of(part, "world.actuators", vehicle.dynamics, 0.0, x, u)
    check_alike(part, "what it returns", rate, x, f"return {type(x).__name__}(…) with the derivative of each field")
    return motion


def _sensor_input(where: str, sensor: Any, motion: Callable[[], Any], x: Any, u: Any) -> Any:
    """What this sensor gets: the motion, or what its class variable FEELS names."""
    inputs = {"motion": motion, "state": lambda: x, "input": lambda: u}
    feels = optional_member(sensor, "FEELS")
    if feels not in inputs:
        problem = f"{type(sensor).__name__} feels {feels!r}, which is nothing that a world has"
        raise InputError(where, problem, choices=inputs, fix='write FEELS = "motion", or leave it out')
    return inputs[feels]()


def as_sample(command: Command, fresh: Any) -> Sample:
    """A command as the uplink carries it."""
    return Sample(value=command.value, t=command.t, age=0.0, fresh=fresh, valid=command.valid)


def _sensors_by_name(pairs: Any) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for name, sensor in pairs:
        if name in named:
            problem = f"two sensors are named {name!r}: {type(named[name]).__name__} and {type(sensor).__name__}"
            raise InputError("world.sensors", problem, fix=f"give one of them another name, e.g. '{name}2'")
        named[name] = sensor
    return named
