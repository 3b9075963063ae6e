"""Virtual vehicle that another autopilot (ArduPilot, PX4) controls by servo pulses, and the vehicle's motion for this
autopilot.

The vehicle is held in place until its pulses leave their rest position, because the model has no ground. After the
release the vehicle moves from the scenario's initial state. Source: docs pages, ArduPilot and PX4.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import compile_block
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import replace
from trimtab.core.rotation import from_euler
from trimtab.core.signals import surrounding_air
from trimtab.flight.instruments import find_sensor, pair_slots
from trimtab.flight.mavlink.dialect import derive_dialect
from trimtab.flight.stacks.ardupilot_json import MOST_CHANNELS, PhysicsState
from trimtab.flight.virtual_vehicle import VirtualVehicle
from trimtab.links.wire import Wire
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import motion_block
from trimtab.run.command_pulses import PulseOutput, find_outputs
from trimtab.run.cosimulation import prepare_world
from trimtab.sensors.imu import Imu

REST_BAND = 20e-6
"""Largest deviation (s) of a pulse width from its rest position that still counts as rest."""
HALF = 0.5
FORCE, RATE = "specific_force", "angular_rate"


class PulsedVehicle:
    """Compiled simulation of a vehicle that servo pulses control. The first call of `advance` must be to time 0.

    Args:
        scenario: scenario of the vehicle.
        seed: seed of the random numbers.
        channels: number of the autopilot's channel (1, 2, …) for each element of the command. If it is empty, the
            channels are 1, 2, and so on.
        release: pulse width (s) that releases the vehicle, or None if any pulse that is not at rest releases it.
        door: name of the argument to which error messages refer.
        most_channels: number of channels of the autopilot.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int,
        channels: Sequence[int],
        release: float | None,
        door: str = "ardupilot",
        most_channels: int = MOST_CHANNELS,
    ) -> None:
        """Compile the world of the scenario."""
        bare = replace(scenario, world=replace(scenario.world, uplink=Wire()))
        self._world, frame, command = prepare_world(bare, seed=seed)
        self._scenario, self._dialect, self._release = bare, derive_dialect(frame, command), release
        self.outputs = find_outputs(scenario, command, most_channels, argument_name(door))
        self.channels = _check_channels(channels, self.outputs, most_channels)
        self._tables = [_read_table(o) for o in self.outputs]
        self._slots = [_slot(o, self._world.reads, len(self._world.inputs)) for o in self.outputs]
        self._safe = np.array([o.safe for o in self.outputs])
        self._motion = compile_block(_physics_block(bare))
        self._pairs = pair_slots(self._motion.reads, self._world.writes)
        imu = find_sensor(self._world.writes, FORCE)
        has_axes = imu is not None and RATE in imu.at and np.size(self._world.outputs[imu.at[RATE]]) == 3
        self._imu = imu if has_axes else None
        self.reset()

    def reset(self) -> None:
        """Reset the vehicle to the scenario's initial state, and hold it in place."""
        self._world.reset()
        self.body = VirtualVehicle(self._scenario, self._dialect, self._world)
        self._instants: Iterator[int] = self.body.instants()
        self._due = next(self._instants)
        self.release_time: int | None = None
        self._is_new = True

    @property
    def imu(self) -> str:
        """Name of the sensor whose samples are sent to the autopilot, or "" if the true motion is sent."""
        return "" if self._imu is None else self._imu.name

    def set_pulses(self, pulses: Sequence[int]) -> None:
        """Set the widths of all channels (µs) from now on. For a channel without a pulse, the safe value is set."""
        widths = np.array([pulses[c - 1] for c in self.channels]) * 1e-6
        widths = np.where(widths > 0, widths, self._safe)
        inputs, reads = self._world.inputs, self._world.reads
        for slot, table, o, width in zip(self._slots, self._tables, self.outputs, widths, strict=True):
            value = np.interp(width, *table)
            inputs[slot] = value > HALF if o.declared.kind == "flag" else value
        inputs[reads["command.t"]], inputs[reads["command.valid"]] = self.body.t, True
        self._is_new = True
        if self.release_time is None and self._is_let_go(widths):
            self.release_time = self.body.t

    def _is_let_go(self, widths: Any) -> bool:
        if self._release is None:
            return bool((np.abs(widths - self._safe) > REST_BAND).any())
        return bool((widths >= self._release).any())

    def advance(self, t: int, tell_row: Callable[[int], None] = lambda _: None) -> None:
        """Advance the simulation to integer time t, through all instants until t.

        tell_row: function that is called with the time of each instant.
        """
        while self._due <= t:
            self._step(self._due)
            tell_row(self._due)
            self._due = next(self._instants)
        if self.body.t < t:
            self._step(t)

    def _step(self, t: int) -> None:
        self.body.advance(t, fresh=self._is_new, is_held=self.release_time is None)
        self._is_new = False

    def state(self) -> PhysicsState:
        """Return the current motion, with samples of the vehicle's IMU if it has a three-axis IMU."""
        motion, outputs = self._motion, self._world.outputs
        motion.inputs[motion.reads["t"]] = self.body.t
        for into, out in self._pairs:
            motion.inputs[into] = outputs[out]
        motion.inputs[motion.reads["input.is_held"]] = self.release_time is None
        motion.step()
        state = PhysicsState(*(motion.result(name).tolist() for name in PhysicsState._fields))
        if self._imu is None or self.release_time is None or not outputs[self._imu.valid]:
            return state
        force, rate = (outputs[self._imu.at[name]].tolist() for name in (FORCE, RATE))
        return state._replace(specific_force=force, angular_rate=rate)


def _physics_block(scenario: Scenario) -> BlockDefinition:
    """Define the block that computes `PhysicsState`, the motion with samples of an ideal IMU. While the vehicle is
    held, the motion is at rest."""
    motion_of, ideal = motion_block(scenario), Imu()

    def step(p: Any, s: Any, now: Any) -> Any:
        _, motion = motion_of.step(p, s, now)
        moves = jnp.where(now.input["is_held"], 0.0, 1.0)
        still = {n: moves * getattr(motion, n) for n in ("v_WB_B", "w_WB_B", "a_WB_B", "alpha_WB_B")}
        motion = replace(motion, **still)
        reading = ideal.measure(motion)
        wind = surrounding_air(motion).velocity
        through_air = motion.v_WB_B - wind
        return s, {
            FORCE: reading.specific_force,
            RATE: reading.angular_rate,
            "position": motion.p_WB,
            "attitude": motion.attitude,
            "velocity": from_euler(*motion.attitude) @ motion.v_WB_B,
            "airspeed": jnp.sqrt(jnp.sum(through_air**2)),
        }

    first = replace(motion_of.input, input=dict(motion_of.input.input) | {"is_held": np.bool_(False)})
    return motion_of._replace(name="physics", doc="Motion of a vehicle, as ArduPilot gets it.", step=step, input=first)


def _check_channels(channels: Sequence[int], outputs: Sequence[PulseOutput], most: int) -> tuple[int, ...]:
    """Return the number of the autopilot's channel for each output. Raise InputError if `channels` is not valid."""
    usual = tuple(range(1, len(outputs) + 1))
    if not channels:
        return usual
    names = ", ".join(o.name for o in outputs)
    part, listed = argument_name("channels"), ",".join(map(str, usual))
    fix = f"{argument('channels', listed)}, or the same numbers in another order"
    if len(channels) != len(outputs):
        problem = f"must be {len(outputs)} numbers, one for each element of a command ({names}), got {len(channels)}"
        raise InputError(part, problem, fix=fix)
    if len(set(channels)) < len(channels) or not all(1 <= c <= most for c in channels):
        problem = f"the channels must be different numbers from 1 to {most}, got {','.join(map(str, channels))}"
        raise InputError(part, problem, fix=fix)
    return tuple(channels)


def _read_table(o: PulseOutput) -> tuple[Any, Any]:
    """Return the pulse table of an output: increasing pulse widths (s), and the output's value for each width."""
    widths, values = np.asarray(o.pulse.widths, float), np.asarray(o.pulse.values, float)
    order = np.argsort(widths)
    return widths[order], values[order]


def _slot(o: PulseOutput, reads: Mapping[str, Any], size: int) -> int:
    """Return the index, in the inputs of the compiled world, of the command element that an output sets."""
    return int(np.atleast_1d(np.arange(size)[reads[f"command.value.{o.path}"]])[o.slot or 0])
