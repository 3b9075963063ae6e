"""The World: truth, sensors, downlink, uplink and actuators. It takes a Command and gives a Frame."""

from collections.abc import Callable, Mapping
from typing import Any

from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.interfaces import optional_member
from trimtab.core.record import part, period, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Command, Frame, Sample, hold_sample
from trimtab.core.time import Clock, ms, to_seconds
from trimtab.loop.structure import cast_like, step_if, zeros_of


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


@record
class World:
    """Vehicle, sensors, radio and actuators, with their faults.

    Source: docs page, Time, for the order of things at one instant.
    """

    vehicle: Any = part("The truth: dynamics and motion.")
    sensors: Any = part("Sensors by name: a mapping, or (name, sensor) pairs.")
    actuators: Any = part("What turns commands into the vehicle's input.")
    downlink: Any = part("Channel from each sensor to the autopilot.")
    uplink: Any = part("Channel from the autopilot to the actuators.")
    max_step: int = period("Longest step of the integration.", default=ms(1))

    def __post_init__(self) -> None:
        if not isinstance(self.sensors, Mapping):
            object.__setattr__(self, "sensors", _sensors_by_name(self.sensors))

    def periods(self) -> list[int]:
        """The periods of everything in the world."""
        parts = [*self.sensors.values(), self.actuators, self.uplink, self.downlink]
        return [p.period for p in parts]

    def init(self, key: Key, x: Any) -> WorldState:
        """The world at rest: no sample taken, nothing received. The uplink follows when the command is known."""
        neutral = self.actuators.neutral()
        motion = zeros_of("world.vehicle.motion", "the vehicle's state", self.vehicle.motion, 0, x, neutral.u)
        states, samples, links, received = {}, {}, {}, {}
        for name, sensor in self.sensors.items():
            states[name] = sensor.init(key.at(f"sensors.{name}"))
            where = f"world.sensors.{name}"
            felt = _sensor_input(where, sensor, lambda: motion, x, neutral.u)
            _, samples[name] = zeros_of(where, "world.vehicle", sensor.step, 0, states[name], felt)
            links[name] = self.downlink.init(key.at(f"downlink.{name}"), samples[name])
            _, received[name] = zeros_of("world.downlink", where, self.downlink.step, 0, links[name], samples[name])
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
        )

    def connect(self, key: Key, s: WorldState, command: Command) -> WorldState:
        """The world with an uplink for commands of this structure."""
        sample = as_sample(command, False)
        link = self.uplink.init(key.at("uplink"), sample)
        _, commanded = zeros_of("world.uplink", "the autopilot", self.uplink.step, 0, link, sample)
        act = self.actuators.step
        _, actuated = zeros_of("world.actuators", "world.uplink", act, 0, s.actuators, commanded)
        actuated = cast_like(s.actuated, actuated)
        return replace(s, uplink=link, commanded=commanded, actuated=actuated, u=actuated.u)

    def sense(self, clock: Clock, s: WorldState) -> tuple[WorldState, Frame]:
        """Truth, sensors, downlink: the frame that the autopilot holds at this instant."""
        t = clock.t
        states, samples, links, received = {}, {}, {}, {}

        def sample_sensor(name: str, sensor: Any) -> Any:
            felt = _sensor_input(name, sensor, lambda: self.vehicle.motion(t, s.x, s.u), s.x, s.u)
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

    def act(self, clock: Clock, s: WorldState, command: Command, fresh: Any) -> WorldState:
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

        def derivative(time: Any, x: Any) -> Any:
            return self.vehicle.dynamics(time, x, s.u)

        return replace(s, x=rk4(derivative, to_seconds(t), s.x, to_seconds(h)))


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
