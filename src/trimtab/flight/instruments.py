"""Telemetry that a virtual vehicle sends to ground stations. The autopilot does not use this telemetry.

Position and velocity are the true values, so that a ground station shows what the vehicle really does.
Source: docs page, Telemetry.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.clock import SYSTEM_CLOCK, Clock
from trimtab.core.record import leaves
from trimtab.core.time import ms, seconds
from trimtab.flight.duties import Duties
from trimtab.flight.exchange import slot_indices
from trimtab.flight.globe import Globe
from trimtab.flight.manual_control import RADIO_TIMEOUT, command_ranges
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import ArmRequest, ReceiverChannels, VehicleEvent
from trimtab.flight.prearm import ArmingGuard
from trimtab.flight.station import telemetry
from trimtab.flight.station.streams import Streams, TelemetryStream
from trimtab.flight.station.telemetry import Health, Place, VehicleMotion
from trimtab.flight.virtual_vehicle import VirtualVehicle
from trimtab.run.blocks import motion_block
from trimtab.run.kept_blocks import compile_kept

QUICK, MEDIUM, SLOW, VERY_SLOW = ms(250), ms(500), seconds(1), seconds(5)
FORCE, RATE, FIELD = "specific_force", "angular_rate", "field"


class Instruments:
    """Reader of the state of a virtual vehicle, for the telemetry."""

    def __init__(
        self,
        body: VirtualVehicle,
        duties: Duties,
        guard: ArmingGuard,
        endpoint: Endpoint,
        origin: Place | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """Compile the blocks that telemetry needs.

        Args:
            body: vehicle whose motion is sent.
            duties: duties of the firmware. Their failsafe defines the names and ranges of the outputs.
            guard: the vehicle's checks before arming.
            endpoint: endpoint of the vehicle.
            origin: geographic position of the origin of the world frame W, or None if it is unknown.
            clock: clock whose wall-clock time is sent as SYSTEM_TIME.
        """
        self._body, self._endpoint, self._clock = body, endpoint, clock
        self._duties, self._guard = duties, guard
        self._motion = compile_kept(motion_block, body.scenario)
        self._pairs = pair_slots(self._motion.reads, body.world.writes)
        self.globe = Globe(endpoint, self.vehicle_motion, origin)
        paths = [f"command.value.{p}" for p, _, _ in leaves(duties.failsafe.safe)]
        self._command_slots = slot_indices(body.world.reads, paths, len(body.world.inputs))
        self._low, span = command_ranges(duties.failsafe)
        self._range = np.where(span > 0, span, np.nan)
        self._imu, self._magnetometer = (find_sensor(body.world.writes, name) for name in (FORCE, FIELD))
        self._pulses, self._pulse_time = tuple[float, ...](), -2 * RADIO_TIMEOUT

    def telemetry_streams(self) -> Streams:
        """Return all telemetry streams (repeated messages), with default rates for a slow link."""
        streams: dict[str, TelemetryStream] = {
            "ATTITUDE": TelemetryStream(lambda now: telemetry.attitude(now, self.vehicle_motion()), QUICK),
            "LOCAL_POSITION_NED": TelemetryStream(
                lambda now: telemetry.local_position(now, self.vehicle_motion()), QUICK
            ),
            "VFR_HUD": TelemetryStream(lambda now: telemetry.vfr_hud(self.vehicle_motion()), MEDIUM),
            "SERVO_OUTPUT_RAW": TelemetryStream(self._servo_fields, MEDIUM),
            "RC_CHANNELS": TelemetryStream(self._receiver_fields, MEDIUM),
            "SYS_STATUS": TelemetryStream(self._health_fields, SLOW),
            "EXTENDED_SYS_STATE": TelemetryStream(
                lambda now: telemetry.landed_state(not self._duties.is_commanded), SLOW
            ),
            "GLOBAL_POSITION_INT": TelemetryStream(self.globe.position_fields, QUICK),
            "GPS_GLOBAL_ORIGIN": TelemetryStream(self.globe.origin_fields, VERY_SLOW),
            "HOME_POSITION": TelemetryStream(self.globe.home_fields, VERY_SLOW),
            "BATTERY_STATUS": TelemetryStream(lambda now: telemetry.battery_status(), VERY_SLOW),
            "SYSTEM_TIME": TelemetryStream(lambda now: telemetry.system_time(now, self._clock.unix()), SLOW),
        }
        if self._imu is not None:
            streams["HIGHRES_IMU"] = TelemetryStream(self._inertial_fields, MEDIUM)
        return Streams(self._endpoint, streams)

    def handle_event(self, event: VehicleEvent, now: int) -> None:
        """Handle a message or an event: store the safety pilot's radio channels, and set home when the vehicle is
        armed."""
        if isinstance(event, ArmRequest) and event.arm and not self._duties.is_commanded:
            self.globe.mark_home()
        if isinstance(event, ReceiverChannels):
            self._pulses, self._pulse_time = event.pulses, now

    def vehicle_motion(self) -> VehicleMotion:
        """Return the current motion of the vehicle."""
        motion, world = self._motion, self._body.world
        motion.inputs[motion.reads["t"]] = self._body.t
        for into, out in self._pairs:
            motion.inputs[into] = world.outputs[out]
        motion.step()
        return VehicleMotion(*(motion.result(name).tolist() for name in VehicleMotion._fields))

    def pose(self) -> list[float]:
        """Return position, attitude and geographic position, in the layout of `logs.frames`."""
        motion = self.vehicle_motion()
        place = self.globe.place(motion.p_WB)
        return [*motion.p_WB, *motion.attitude, *((math.nan,) * 3 if place is None else place)]

    def _servo_fields(self, now: int) -> Mapping[str, Any]:
        shares = (self._body.world.inputs[self._command_slots] - self._low) / self._range
        return telemetry.servo_outputs(now, shares.tolist())

    def _receiver_fields(self, now: int) -> Mapping[str, Any] | None:
        return telemetry.receiver_channels(now, self._pulses) if now - self._pulse_time <= RADIO_TIMEOUT else None

    def _inertial_fields(self, now: int) -> Mapping[str, Any] | None:
        assert self._imu is not None
        outputs, imu, field = self._body.world.outputs, self._imu, self._magnetometer
        if not outputs[imu.valid]:
            return None
        magnetic = outputs[field.at[FIELD]].tolist() if field and outputs[field.valid] else None
        force, rate = (outputs[imu.at[name]].tolist() for name in (FORCE, RATE))
        return telemetry.inertial_sample(int(outputs[imu.t]), force, rate, magnetic)

    def _health_fields(self, now: int) -> Mapping[str, Any]:
        outputs, counts = self._body.world.outputs, self._endpoint.counts
        has = well = Health.MOTORS
        has |= Health.ARMING_CHECK
        well |= Health.ARMING_CHECK if self._guard.may_be_armed else Health(0)
        for sensor, kind in (
            (self._imu, Health.GYRO | Health.ACCELEROMETER),
            (self._magnetometer, Health.MAGNETOMETER),
        ):
            if sensor is not None:
                has |= kind
                well |= kind if outputs[sensor.valid] else Health(0)
        if now - self._pulse_time <= RADIO_TIMEOUT:
            has, well = has | Health.RECEIVER, well | Health.RECEIVER
        return telemetry.system_health(has, well, counts.lost, counts.accepted, counts.refusals)


class SensorSlots(NamedTuple):
    """Indices of a sensor's newest sample in the outputs of a compiled world. at: index of each measured quantity, by
    the quantity's name."""

    name: str
    at: Mapping[str, Any]
    t: Any
    valid: Any


def find_sensor(writes: Mapping[str, Any], quantity: str) -> SensorSlots | None:
    """Return the indices of the newest sample of the first sensor that measures a quantity, or None without such a
    sensor."""
    for path in writes:
        sensor, dot, name = path.partition(".value.")
        if dot and name == quantity and sensor.startswith("sensors."):
            fields = {p.removeprefix(f"{sensor}.value."): at for p, at in writes.items() if p.startswith(sensor)}
            return SensorSlots(
                sensor.removeprefix("sensors."), fields, writes[f"{sensor}.t"], writes[f"{sensor}.valid"]
            )
    return None


def pair_slots(reads: Mapping[str, Any], writes: Mapping[str, Any]) -> list[tuple[Any, Any]]:
    """Return a pair of indices for each input of the motion block (true state and actuation): index in the block's
    inputs, index in the world's outputs."""
    acting = "input.truth", "input.u"
    pairs = [(p.removeprefix("input."), at) for p, at in reads.items() if p.startswith(acting)]
    return [(at, writes[p if p.startswith("truth") else f"actuators.{p}"]) for p, at in pairs]
