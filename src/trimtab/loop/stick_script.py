"""Scripted stick movements of a pilot, for simulations."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import period, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import STICK_MODES, Motion, Sample, Stick
from trimtab.core.time import ms
from trimtab.loop.faults import FaultyPart
from trimtab.loop.scenario import Scenario


@record
class StickScript:
    """Sensor of the pilot's stick, with scripted stick positions.

    Each scripted position is held until the time of the next one. Before the first scripted position, no sample is
    valid. The stick is sampled once per `period`, as in a flight with a pilot. The age of a sample is its delay from
    the stick to the autopilot. In a flight with a pilot, the ground station with the stick provides the samples
    instead.

    Frames:  none.    Source:  docs page, Piloted.
    """

    times: Any = quantity(
        "100 ns", "Times of the scripted stick positions, in rising order.", kind="time", default=np.zeros(0, np.int64)
    )
    forward: Any = quantity("1", "Forward deflection of the stick.", default=np.zeros(0), low=-1, high=1)
    turn: Any = quantity(
        "1", "Sideways deflection of the stick, clockwise positive.", default=np.zeros(0), low=-1, high=1
    )
    mode: Any = quantity(
        "1",
        "Mode of the stick: the kind of motion that its deflections command.",
        kind="mode",
        modes=STICK_MODES,
        default=np.zeros(0, np.int32),
        low=0,
        high=2,
    )
    period: int = period("Time between samples of the stick.", default=ms(20))

    def check(self) -> None:
        """Raise InputError unless the times rise and each time has a forward and a sideways deflection and a mode."""
        shapes = [np.shape(a) for a in (self.times, self.forward, self.turn, self.mode)]
        if len(set(shapes)) > 1 or len(shapes[0]) != 1 or not (np.diff(np.asarray(self.times, np.int64)) > 0).all():
            counts = ", ".join(f"{np.size(a)}" for a in (self.times, self.forward, self.turn, self.mode))
            problem = (
                "times must rise, and each time needs one forward, one turn and one mode; "
                f"numbers of times, forward, turn and mode: {counts}"
            )
            raise InputError(
                "times",
                problem,
                fix="write one forward, one turn and one mode for each time, and the times in rising order",
            )

    def init(self, key: Key) -> tuple[()]:
        """Return an empty state."""
        return ()

    def measure(self, motion: Motion) -> Stick:
        """Return a centred stick, because the stick's position doesn't depend on the motion."""
        return Stick(forward=np.float64(0.0), turn=np.float64(0.0), mode=np.int32(0))

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """Return the state and the stick's position at integer time t.

        The sample is valid from the time of the first scripted position on.
        """
        forward, turn, mode, held = (jnp.asarray(v) for v in (0.0, 0.0, np.int32(0), False))
        for k in range(np.shape(self.times)[0]):
            due = t >= self.times[k]
            forward, turn = jnp.where(due, self.forward[k], forward), jnp.where(due, self.turn[k], turn)
            mode, held = jnp.where(due, self.mode[k], mode), held | due
        value = Stick(forward=forward, turn=turn, mode=mode.astype(np.int32))
        return state, Sample(value=value, t=t, age=0.0, fresh=held, valid=held)


def stick_script(*entries: tuple[int, float, float, str]) -> StickScript:
    """Return a script of stick positions, each given as a tuple (integer time, forward, turn, name of the mode)."""
    for _, _, _, name in entries:
        if name not in STICK_MODES:
            raise InputError(
                "stick's script", f"unknown mode {name!r}", choices=STICK_MODES, fix="use one of these names"
            )
    times, forward, turn, names = zip(*entries, strict=True) if entries else ((), (), (), ())
    return StickScript(
        times=np.array(times, np.int64),
        forward=np.array(forward, np.float64),
        turn=np.array(turn, np.float64),
        mode=np.array([STICK_MODES.index(name) for name in names], np.int32),
    )


def add_stick_sensor(scenario: Scenario) -> Scenario:
    """Return the scenario with a sensor for the stick that the law reads.

    A scenario whose law reads no stick, or that has this sensor, is returned unchanged.
    """
    name, sensors = optional_member(scenario.autopilot.law, "stick"), scenario.world.sensors
    if not name or name in sensors:
        return scenario
    return replace(scenario, world=replace(scenario.world, sensors={**sensors, name: StickScript()}))


def empty_sticks(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the sticks without scripted positions.

    In a flight, a pilot moves these sticks at the ground station.
    """
    found = []
    for name, sensor in scenario.world.sensors.items():
        while isinstance(sensor, FaultyPart):
            sensor = sensor.inner
        if isinstance(sensor, StickScript) and not np.size(sensor.times):
            found.append(name)
    return tuple(found)
