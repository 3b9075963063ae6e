"""What a virtual vehicle tells ground stations of itself, which the autopilot neither asks for nor hears.

Posture and velocity are the true ones: a ground station is there to see what the vehicle really does.
Source: docs page, Telemetry.

How a vehicle moves, compiled: its `motion`, for whoever wants to see it and not its state's own numbers.

Source: docs page, Vehicle.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.failsafe import Failsafe
from trimtab.compiler.block import Exported, export_step
from trimtab.core.float64 import jax
from trimtab.core.record import leaves, numeric, part, quantity, record
from trimtab.core.rng import Key
from trimtab.core.time import ms, seconds
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import start
from trimtab.run.fast_step import FastStep
from trimtab.wire import telemetry
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.protocol import Channels, Event
from trimtab.wire.streams import Stream, Streams
from trimtab.wire.telemetry import Health, Seen


@record
class Posture:
    """What the motion is told of. Source: docs page, Vehicle."""

    t: Any = quantity("100 ns", "Now.", kind="time")
    truth: Any = part("State of the vehicle.")
    u: Any = part("What acts on it.")


def motion_step(scenario: Scenario, *, name: str = "motion") -> Exported:
    """The text of a vehicle's motion; its inputs are named as in a world's outputs, but for "actuators."."""
    world, autopilot, x = numeric(scenario.world), numeric(scenario.autopilot), numeric(scenario.initial)
    key = Key(np.uint32(0), np.uint32(0))
    s, _ = jax.eval_shape(lambda: start(world, autopilot, x, key))
    state, u = jax.tree.map(lambda v: np.zeros(v.shape, v.dtype), (s.x, s.actuated.u))
    return export_step(
        name,
        "How a vehicle moves.",
        world.vehicle,
        lambda p: (),
        lambda p, s, now: (s, p.motion(now.t, now.truth, now.u)),
        Posture(t=np.int64(0), truth=state, u=u),
        "f64",
    )


QUICK, MEDIUM, SLOW = ms(250), ms(500), seconds(1)
WIDEST = 1e100
"""A range of a command that is wider is none: nothing is known of it."""
RADIO_SILENT = ms(500)
FORCE, RATE, FIELD = "specific_force", "angular_rate", "field"


class Instruments:
    """Reads a vehicle for its telemetry."""

    def __init__(
        self, body: VirtualVehicle, failsafe: Failsafe, endpoint: Endpoint, flying: Callable[[], bool]
    ) -> None:
        """Compile what is needed. flying: whether somebody commands it."""
        self._body, self._endpoint, self._flying = body, endpoint, flying
        self._motion = FastStep(motion_step(body.scenario))
        self._pairs = _pairs(self._motion.reads, body.world.writes)
        self._commanded = _commanded(failsafe, body.world.reads)
        self._imu, self._magnetometer = (_sensor(body.world.writes, name) for name in (FORCE, FIELD))
        self._pulses: tuple[float, ...] = ()
        self._pulses_at = -2 * RADIO_SILENT

    def streams(self) -> Streams:
        """Everything it tells, at the rates of a slow line."""
        told: dict[str, Stream] = {
            "ATTITUDE": Stream(lambda now: telemetry.attitude(now, self.seen()), QUICK),
            "LOCAL_POSITION_NED": Stream(lambda now: telemetry.local_position(now, self.seen()), QUICK),
            "VFR_HUD": Stream(lambda now: telemetry.head_up(self.seen()), MEDIUM),
            "SERVO_OUTPUT_RAW": Stream(self._servos, MEDIUM),
            "RC_CHANNELS": Stream(self._receiver, MEDIUM),
            "SYS_STATUS": Stream(self._health, SLOW),
            "EXTENDED_SYS_STATE": Stream(lambda now: telemetry.landed(not self._flying()), SLOW),
            "SYSTEM_TIME": Stream(lambda now: telemetry.system_time(now, time.time()), SLOW),
        }
        if self._imu is not None:
            told["HIGHRES_IMU"] = Stream(self._inertial, MEDIUM)
        return Streams(self._endpoint, told)

    def note(self, event: Event, now: int) -> None:
        """Take note of what the safety pilot's receiver says."""
        if isinstance(event, Channels):
            self._pulses, self._pulses_at = event.pulses, now

    def seen(self) -> Seen:
        """How it moves now."""
        motion, world = self._motion, self._body.world
        motion.inputs[motion.reads["t"]] = self._body.t
        for into, out in self._pairs:
            motion.inputs[into] = world.outputs[out]
        motion.step()
        return Seen(*(motion.result(name).tolist() for name in Seen._fields))

    def _servos(self, now: int) -> Mapping[str, Any]:
        at, low, span = self._commanded
        return telemetry.servos(now, ((self._body.world.inputs[at] - low) / span).tolist())

    def _receiver(self, now: int) -> Mapping[str, Any] | None:
        return telemetry.receiver(now, self._pulses) if now - self._pulses_at <= RADIO_SILENT else None

    def _inertial(self, now: int) -> Mapping[str, Any] | None:
        assert self._imu is not None
        outputs, imu, field = self._body.world.outputs, self._imu, self._magnetometer
        if not outputs[imu.valid]:
            return None
        magnetic = outputs[field.at[FIELD]].tolist() if field and outputs[field.valid] else None
        force, rate = (outputs[imu.at[name]].tolist() for name in (FORCE, RATE))
        return telemetry.inertial(int(outputs[imu.t]), force, rate, magnetic)

    def _health(self, now: int) -> Mapping[str, Any]:
        outputs, counts = self._body.world.outputs, self._endpoint.counts
        has = well = Health.MOTORS | Health.ARMING_CHECK
        for sensor, kind in (
            (self._imu, Health.GYRO | Health.ACCELEROMETER),
            (self._magnetometer, Health.MAGNETOMETER),
        ):
            if sensor is not None:
                has |= kind
                well |= kind if outputs[sensor.valid] else Health(0)
        if now - self._pulses_at <= RADIO_SILENT:
            has, well = has | Health.RECEIVER, well | Health.RECEIVER
        return telemetry.health(has, well, counts.lost, counts.accepted, counts.refused)


class _Sensor(NamedTuple):
    """Where a sensor's newest sample stands in a world's outputs."""

    at: Mapping[str, Any]
    t: Any
    valid: Any


def _sensor(writes: Mapping[str, Any], quantity: str) -> _Sensor | None:
    """The first sensor that measures a quantity."""
    for path in writes:
        sensor, dot, name = path.partition(".value.")
        if dot and name == quantity and sensor.startswith("sensors."):
            fields = {p.removeprefix(f"{sensor}.value."): at for p, at in writes.items() if p.startswith(sensor)}
            return _Sensor(fields, writes[f"{sensor}.t"], writes[f"{sensor}.valid"])
    return None


def _pairs(reads: Mapping[str, Any], writes: Mapping[str, Any]) -> list[tuple[Any, Any]]:
    """Where each number of the state, and of what acts, stands for the motion and in the world."""
    return [(at, writes[p if p.startswith("truth") else f"actuators.{p}"]) for p, at in reads.items() if p != "t"]


def _commanded(failsafe: Failsafe, reads: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    """Where the numbers that the actuators are given stand, their lowest value and their range; NaN for none."""
    every = np.arange(1 + max(at.stop if isinstance(at, slice) else at for at in reads.values()))
    at = [np.atleast_1d(every[reads[f"command.value.{p}"]]) for p, _, _ in leaves(failsafe.safe)]
    low, high = (
        np.concatenate([np.ravel(np.asarray(v, float)) for _, v, _ in leaves(r)]) for r in (failsafe.low, failsafe.high)
    )
    span = high - low
    return np.concatenate(at), low, np.where((span > 0) & (span < WIDEST), span, np.nan)
