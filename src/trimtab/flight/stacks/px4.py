"""Virtual vehicle that serves as the simulator of PX4's SITL: it sends sensor data and follows PX4's answers.

In lockstep, PX4 waits for each sample and the vehicle waits for each answer, so neither waits for a clock. Before the
first answer, and while PX4 runs by its own clock, samples are sent in real time. Each new connection begins a new
flight.
Source: docs page, PX4.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import compile_block
from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.record import Quantity, to_arrays
from trimtab.core.rotation import from_euler
from trimtab.core.time import ms, to_seconds
from trimtab.environment.atmosphere import standard_atmosphere
from trimtab.environment.geodetic import TangentPlane
from trimtab.environment.magnetic import COLLEGE_PARK
from trimtab.flight.globe import parse_origin
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.stacks.ardupilot_json import PhysicsState
from trimtab.flight.stacks.physics_log import PhysicsFlights, PhysicsSummary
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.flight.stacks.px4_simulator import (
    CHANNELS,
    INERTIAL,
    MAGNETIC,
    PER_MICROSECOND,
    PRESSURES,
    ControlFrame,
    Surroundings,
    fix_fields,
    read_controls,
    sensor_fields,
    simulator_dialect,
)
from trimtab.flight.transports.reconnecting_stream import StreamLink
from trimtab.loop.scenario import Scenario
from trimtab.run.command_pulses import PulseOutput

ORIGIN = "38.9897,-76.9378,20"
"""Geographic position of the origin of the world frame W: latitude and longitude (degrees), height (m). From this
position PX4 derives the magnetic field COLLEGE_PARK.
"""
STEP, SLOW_SAMPLES, FIX_SAMPLES = ms(4), 5, 25
"""Period of the inertial unit's samples (100 ns), as in PX4's own simulators. The other two numbers are the periods of
the slower sensors and of the position fixes, in samples of the inertial unit.
"""
START = ms(1000)
"""Time of the first sample (100 ns). PX4 adopts this time as its own. It is not 0, because PX4 treats 0 as an unknown
time."""
LISTEN_S, SILENCE_S = 0.1, 1.0
"""Longest time (s) to wait for a connection before `stop` is called again, and longest time (s) to wait for PX4's
answer to a sample."""
RATE_NOISE, FORCE_NOISE, FIELD_NOISE, PRESSURE_NOISE = np.radians(2000 / 32768), 9.80665 / 2048, 1e-7, 1.0
"""Standard deviations of the sensor noise: rate (rad/s), specific force (m/s²), magnetic field (T), pressure (Pa). The
first two are the resolution of PX4's simulated sensors. The other two are chosen here. Noise is needed because PX4
treats a sensor with constant samples as dead."""
SYSTEM, COMPONENT = 1, 200

OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.held": (
        "?",
        Quantity(
            "1",
            "True while the vehicle is held in place, until its servo pulses leave their rest position.",
            kind="flag",
        ),
    ),
    "px4.armed": ("?", Quantity("1", "PX4 is armed.", kind="flag")),
    "px4.unanswered": ("i8", Quantity("1", "Number of samples so far that PX4 did not answer in time.", kind="count")),
}
"""Signals of the vehicle's log, in addition to the signals of the simulated world."""


@dataclass
class AnswerTally:
    """Counts of samples sent to PX4, and of PX4's answers.

    unanswered: samples that PX4 did not answer in time. The simulation then continued without an answer.
    """

    samples: int = 0
    answers: int = 0
    unanswered: int = 0
    malformed: int = 0
    refused: int = 0


class Px4Simulator:
    """Virtual vehicle that PX4 flies. The method `serve` runs the vehicle."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: PulsedVehicle,
        link: StreamLink,
        *,
        seed: int = 0,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """Prepare one run of `serve`.

        Args:
            scenario: scenario of the vehicle, for its log.
            vehicle: vehicle that PX4 flies.
            link: listening end of the link to PX4.
            seed: seed of the noise.
            clock: clock of this process.
        """
        self.scenario, self.vehicle, self.link, self.seed, self._clock = scenario, vehicle, link, seed, clock
        self.tally = AnswerTally()
        self._flights = PhysicsFlights(scenario, vehicle, OWN_SIGNALS, seed=seed, period=STEP)
        self._around = compile_block(_surroundings_block())
        self._spans = {c: pulse_span(o) for c, o in zip(vehicle.channels, vehicle.outputs, strict=True)}
        self._begin_connection()

    def _seconds(self) -> float:
        return self._clock.monotonic_ns() / NS_PER_SECOND

    def _begin_connection(self) -> None:
        self._endpoint = Endpoint(simulator_dialect(), SYSTEM, COMPONENT, unsigned=True)
        self._noise = np.random.default_rng(self.seed)
        self._last: ControlFrame | None = None
        self._samples, self._due, self._is_in_step = 0, self._seconds(), False

    def serve(
        self,
        *,
        duration: int | None = None,
        log: Path | None = None,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _: None,
        lost_lines: Callable[[], int] = lambda: 0,
    ) -> PhysicsSummary:
        """Fly until `duration` (100 ns) after the vehicle's release, or until stop() returns True.

        Args:
            duration: time (100 ns) from the vehicle's release to the end, or None to run until stop() returns True.
            log: path of the log. The log of a second flight is called NAME-2, and so on.
            stop: function called at every sample, and ten times a second. If it returns True, the run ends.
            tell: function that receives the messages for the user.
            lost_lines: function that returns the number of messages to the user that were lost. It is called at the
                end.
        """
        self._flights.prepare(log, tell)
        connection = -1
        try:
            while not (stop() or self._flights.problems or self._is_over(duration)):
                if not self.link.statistics.connected:
                    self.link.receive(LISTEN_S)
                    continue
                if connection != self.link.statistics.reconnects:
                    connection = self.link.statistics.reconnects
                    self._begin_flight()
                self._send_sample()
                self._move(self._await_answer(stop))
        finally:
            self._flights.close(lost_lines())
        return self._flights.summarise(self.tally)

    def _is_over(self, duration: int | None) -> bool:
        release = self.vehicle.release_time
        return duration is not None and release is not None and self.vehicle.body.t - release >= duration

    def _now(self) -> int:
        """Return the current time (100 ns) as sent to PX4. It starts at START."""
        return START + self.vehicle.body.t

    def _send_sample(self) -> None:
        """Send the current sensor samples to PX4."""
        state, t = self.vehicle.state(), self._now()
        if not state.is_finite:
            problem = f"the motion is not finite, {to_seconds(self.vehicle.body.t):g} s into the flight"
            self._flights.add_problem(problem)
            return
        around, updated = self._surroundings(state), INERTIAL
        if self._samples % FIX_SAMPLES == 0:
            self.link.send(self._endpoint.pack("HIL_GPS", fix_fields(t, state, around)))
        if self._samples % SLOW_SAMPLES == 0:
            updated |= MAGNETIC | PRESSURES
        noisy, around = self._add_noise(state, around)
        self.link.send(self._endpoint.pack("HIL_SENSOR", sensor_fields(t, noisy, around, updated)))
        self._samples += 1
        self.tally.samples += 1

    def _surroundings(self, state: PhysicsState) -> Surroundings:
        block = self._around
        block.set_inputs({"p_WB": state.position, "attitude": state.attitude, "airspeed": state.airspeed})
        block.step()
        *numbers, field = (block.result(name) for name in Surroundings._fields)
        return Surroundings(*map(float, numbers), field=field.tolist())

    def _add_noise(self, state: PhysicsState, around: Surroundings) -> tuple[PhysicsState, Surroundings]:
        force, rate, field = self._noise.standard_normal((3, 3))
        noisy = state._replace(
            specific_force=(np.asarray(state.specific_force) + FORCE_NOISE * force).tolist(),
            angular_rate=(np.asarray(state.angular_rate) + RATE_NOISE * rate).tolist(),
        )
        spoilt = around._replace(
            field=(np.asarray(around.field) + FIELD_NOISE * field).tolist(),
            pressure=around.pressure + PRESSURE_NOISE * self._noise.standard_normal(),
        )
        return noisy, spoilt

    def _await_answer(self, stop: Callable[[], bool]) -> ControlFrame | None:
        """Return PX4's answer to the newest sample, or None if no answer arrived in time.

        At the start of lockstep, answers to earlier samples are skipped, so that PX4 does not stay one sample behind.
        """
        sent, is_locked = self._now() // PER_MICROSECOND, self._last is not None and self._last.is_locked
        self._due = max(self._due + to_seconds(STEP), self._seconds() - SILENCE_S)
        until, newest = self._seconds() + SILENCE_S if is_locked else self._due, None
        while not stop() and self.link.statistics.connected and (left := until - self._seconds()) > 0:
            answer = self._take(self.link.receive(min(left, LISTEN_S)))
            newest = answer or newest
            if answer is None or not answer.is_locked:
                continue
            if self._is_in_step or answer.time >= sent:
                self._is_in_step = True
                return answer
            until, is_locked = self._seconds() + SILENCE_S, True
        self._is_in_step = newest is not None and newest.is_locked
        if is_locked and newest is None and self.link.statistics.connected and not stop():
            self.tally.unanswered += 1
            self._flights.report_once(
                f"PX4 did not answer a sample within {SILENCE_S:g} s: the vehicle continues without an answer"
            )
        return newest

    def _take(self, data: bytes | None) -> ControlFrame | None:
        """Return the last answer of PX4 in the received bytes, or None if they contain no answer."""
        answer = None
        for message in self._endpoint.feed(data):
            if message.name != "HIL_ACTUATOR_CONTROLS":
                continue
            frame = read_controls(message)
            if isinstance(frame, str):
                self.tally.malformed += 1
                self._flights.report_once(f"refused an answer: {frame}")
                continue
            self.tally.answers += 1
            answer = frame
        counts = self._endpoint.counts
        refused = counts.checksum + counts.downgraded + counts.garbage
        if refused:
            self.tally.refused += refused
            counts.checksum = counts.downgraded = counts.garbage = 0
            self._flights.report_once(
                "refused bytes that are not MAVLink 2: check that the program that connects here is PX4's simulator "
                "module"
            )
        return answer

    def _move(self, answer: ControlFrame | None) -> None:
        """Advance the vehicle by one step (STEP), with PX4's newest outputs. answer: PX4's new answer, or None if no
        answer has arrived."""
        if answer is not None:
            if self._last is None:
                self._flights.report(f"PX4 answers, {'in lockstep' if answer.is_locked else 'by the clock'}")
            if self._last is None or answer.is_armed != self._last.is_armed:
                self._flights.report("PX4 is armed" if answer.is_armed else "PX4 is disarmed")
            self._last = answer
            self.vehicle.set_pulses(self._pulses(answer))
        self.vehicle.advance(self.vehicle.body.t + STEP, self._write_row)

    def _pulses(self, answer: ControlFrame) -> Sequence[int]:
        """Return the pulse widths (µs) that PX4 sets. While PX4 is not armed, all widths are 0, which means no pulse
        and is safe."""
        pulses = [0] * CHANNELS
        if answer.is_armed:
            for channel, (rest, low, high) in self._spans.items():
                control = min(max(answer.controls[channel - 1], -1.0), 1.0)
                pulses[channel - 1] = round(1e6 * (rest + control * (high - rest if control >= 0 else rest - low)))
        return pulses

    def _begin_flight(self) -> None:
        """Reset the vehicle to its initial state, and start a new log."""
        self._begin_connection()
        self._flights.begin("new connection")
        self.vehicle.advance(0, self._write_row)

    def _write_row(self, t: int) -> None:
        """Write the log row of the last instant before t."""
        is_held, is_armed = self.vehicle.release_time is None, self._last is not None and self._last.is_armed
        self._flights.write_row(t, (is_held, is_armed, self.tally.unanswered))


def pulse_span(o: PulseOutput) -> tuple[float, float, float]:
    """Return the pulse widths (s) of an output for PX4's control values 0 (rest), -1 and 1 (the ends of the range).

    If the rest position of a motor is at one end of the range, the motor turns in one direction only.
    """
    return o.safe, min(o.pulse.widths), max(o.pulse.widths)


def _surroundings_block() -> BlockDefinition:
    """Define the block that computes `Surroundings` (geographic position, air, magnetic field) from a motion. The
    block's parameters are the geographic position of the origin of the world frame W."""

    def step(p: Any, s: Any, now: Any) -> Any:
        latitude, longitude, height = p.from_ned(now["p_WB"])
        air = standard_atmosphere(height)
        field = from_euler(*now["attitude"]).T @ jnp.asarray(COLLEGE_PARK)
        dynamic = 0.5 * air.density * now["airspeed"] ** 2
        return s, Surroundings(latitude, longitude, height, air.pressure, dynamic, air.temperature, field)._asdict()

    first = {"p_WB": np.zeros(3), "attitude": np.zeros(3), "airspeed": np.float64(0.0)}
    latitude, longitude, height = parse_origin(ORIGIN)
    plane = TangentPlane(latitude=latitude, longitude=longitude, height=height)
    return BlockDefinition("surroundings", "Surroundings of a vehicle.", step, lambda p: (), to_arrays(plane), first)
