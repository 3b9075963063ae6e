"""Three-axis inertial measurement unit: triads of accelerometers and gyros, with the errors of micromachined sensors.

The output z of a triad follows from its noise-free input h by

    z = quantised( clip( (I + S + M) L(h) + b + w ) ),   b = b0 + b_turn_on + walk

S: scale factors (diagonal); M: misalignments (off the diagonal); L: low-pass filter; w: white noise. The
noise is added after the low-pass, so its density is that of the output.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, tree_where
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import DEG, from_euler
from trimtab.core.second_order import SectionState, filter_sample, low_pass, steady_state
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import format_time, to_seconds
from trimtab.environment.geodetic import STANDARD
from trimtab.sensors.gyro_dynamics import TICK

UNIT_DRAWS = 12
"""Number of standard normal draws for a triad in one run: 3 turn-on biases, 3 scale factors, 6 misalignments."""
OFF_DIAGONAL = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
ZERO = (0.0, 0.0, 0.0)
SOURCE = "IEEE Std 952-1997, annex C"
RESPONSE = "Response model that replaces the low-pass, with methods start(u) and respond(state, u)."


@record
class AccelerometerErrors:
    """Errors of three accelerometers.

    The value zero switches an error off.

    Frames:  the unit's own axes.
    Source:  IEEE Std 952-1997.
    """

    noise: Scalar = imperfection(
        "m/s^2/Hz^0.5", "White noise density of the accelerometers: velocity random walk N.", "imu-noise", source=SOURCE
    )
    bias: Any = quantity(
        "m/s^2",
        "Constant bias of the accelerometers, the same in every run.",
        default=ZERO,
        shape=(3,),
        off={"imu-turn-on-bias": ZERO},
    )
    turn_on_bias: Scalar = imperfection(
        "m/s^2", "Standard deviation of the turn-on bias, drawn for each run.", "imu-turn-on-bias"
    )
    bias_walk: Scalar = imperfection(
        "m/s^2/s^0.5", "Random walk density K of the accelerometer bias.", "imu-bias-walk", source=SOURCE
    )
    scale_factor: Scalar = imperfection(
        "1", "Standard deviation of the scale error of each axis, drawn for each run.", "imu-scale-factor"
    )
    misalignment: Scalar = imperfection(
        "rad", "Standard deviation of an axis's misalignment towards each of the other axes.", "imu-misalignment"
    )
    bandwidth: Scalar = imperfection(
        "Hz", "Bandwidth (-3 dB) of a second-order Butterworth low-pass; 0: no limit.", "imu-bandwidth"
    )
    resolution: Scalar = imperfection(
        "m/s^2", "Quantisation step of the converter; 0: no quantisation.", "imu-quantisation"
    )
    range: Scalar = imperfection("m/s^2", "Largest magnitude of the output of an axis; 0: no limit.", "imu-saturation")
    response: Any = part(RESPONSE, default=None, off={"imu-bandwidth": None})


@record
class GyroErrors:
    """Errors of three gyros.

    The value zero switches an error off.

    Frames:  the unit's own axes.
    Source:  IEEE Std 952-1997.
    """

    noise: Scalar = imperfection(
        "rad/s/Hz^0.5", "White noise density of the gyros: angle random walk N.", "imu-noise", source=SOURCE
    )
    bias: Any = quantity(
        "rad/s",
        "Constant bias of the gyros, the same in every run.",
        default=ZERO,
        shape=(3,),
        off={"imu-turn-on-bias": ZERO},
    )
    turn_on_bias: Scalar = imperfection(
        "rad/s", "Standard deviation of the turn-on bias, drawn for each run.", "imu-turn-on-bias"
    )
    bias_walk: Scalar = imperfection(
        "rad/s/s^0.5", "Random walk density K of the gyro bias: rate random walk.", "imu-bias-walk", source=SOURCE
    )
    scale_factor: Scalar = imperfection(
        "1", "Standard deviation of the scale error of each axis, drawn for each run.", "imu-scale-factor"
    )
    misalignment: Scalar = imperfection(
        "rad", "Standard deviation of an axis's misalignment towards each of the other axes.", "imu-misalignment"
    )
    bandwidth: Scalar = imperfection(
        "Hz", "Bandwidth (-3 dB) of a second-order Butterworth low-pass; 0: no limit.", "imu-bandwidth"
    )
    resolution: Scalar = imperfection(
        "rad/s", "Quantisation step of the converter; 0: no quantisation.", "imu-quantisation"
    )
    range: Scalar = imperfection("rad/s", "Largest magnitude of the output of an axis; 0: no limit.", "imu-saturation")
    response: Any = part(RESPONSE, default=None, off={"imu-bandwidth": None})


TriadErrors = AccelerometerErrors | GyroErrors


@record
class TriadState:
    """State of a triad of accelerometers or gyros. Frames: the unit's own axes. Source: this module."""

    draws: Any = quantity(
        "1", "Standard normal draws of biases, scale factors and misalignments in this run.", shape=(UNIT_DRAWS,)
    )
    walk: Any = quantity("1", "Change of the bias since the start of the run, in the unit of the output.", shape=(3,))
    started: Scalar = quantity("1", "True once the low-pass has received a sample.", kind="flag")
    memory: Any = part("State of the low-pass, or of the response model that replaces it.")


def triad_state(errors: TriadErrors, draws: Any) -> TriadState:
    """Return the initial state of a triad, from 12 standard normal draws."""
    zero = jnp.zeros(3)
    memory = SectionState(zero, zero) if errors.response is None else errors.response.start(zero)
    return TriadState(draws=draws, walk=zero, started=jnp.asarray(False), memory=memory)


def distortion(errors: TriadErrors, draws: Any) -> Any:
    """Return the matrix I + S + M (3, 3) of a triad's scale errors S and misalignments M in this run."""
    rows = [[1.0 + errors.scale_factor * draws[3 + i] if i == j else 0.0 for j in range(3)] for i in range(3)]
    for k, (i, j) in enumerate(OFF_DIAGONAL):
        rows[i][j] = errors.misalignment * draws[6 + k]
    return jnp.stack([jnp.stack(row) for row in rows])


def corrupt_triad(
    errors: TriadErrors, state: TriadState, true: Any, dt: float, white: Any, step: Any
) -> tuple[Any, Any, Any]:
    """Return the next state, the output (3,) and the saturation flag of a triad for a true input (3,).

    Args:     true: noise-free input along the unit's axes.    dt: time between samples (s).
              white: standard normals (3,) for this sample's noise.    step: standard normals (3,) for the random walk
              of the bias to the next sample.
    """
    memory, passed = _limit_bandwidth(errors, state, true, dt)
    bias = jnp.stack([errors.bias[i] + errors.turn_on_bias * state.draws[i] + state.walk[i] for i in range(3)])
    noisy = distortion(errors, state.draws) @ passed + bias + errors.noise / np.sqrt(dt) * white
    out, saturated = digitise(noisy, errors.range, errors.resolution)
    walk = state.walk + errors.bias_walk * np.sqrt(dt) * step
    return TriadState(draws=state.draws, walk=walk, started=jnp.asarray(True), memory=memory), out, saturated


def digitise(output: Any, most: Any, resolution: Any) -> tuple[Any, Any]:
    """Return an output (3,) clipped to ±most and rounded to multiples of `resolution`, and its saturation flag.

    A value of 0 for `most` or `resolution` means no clipping or no rounding.
    """
    limited = most > 0
    saturated = limited & (jnp.max(jnp.abs(output)) >= most)
    clipped = jnp.where(limited, jnp.clip(output, -most, most), output)
    coarse = resolution > 0
    grain = jnp.where(coarse, resolution, 1.0)
    return jnp.where(coarse, grain * jnp.floor(clipped / grain + 0.5), clipped), saturated


def _limit_bandwidth(errors: TriadErrors, state: TriadState, true: Any, dt: float) -> tuple[Any, Any]:
    """Return the state and the output of the low-pass or response model. At the first sample, start in steady state."""
    if errors.response is not None:
        rest = errors.response.start(true)
        memory = tree_where(state.started, state.memory, rest)
        return errors.response.respond(memory, true)
    narrow = errors.bandwidth > 0
    section = low_pass(jnp.where(narrow, errors.bandwidth, 0.1 / dt), np.sqrt(0.5), dt)
    memory, passed = filter_sample(section, tree_where(state.started, state.memory, steady_state(section, true)), true)
    return memory, jnp.where(narrow, passed, true)


@record
class InertialReading:
    """Sample of an inertial measurement unit.

    Frames:  the unit's axes, which are B's axes turned by the mounting.
    Source:  docs page, Imu.
    """

    specific_force: Any = quantity(
        "m/s^2",
        "Specific force: acceleration minus gravity. At rest the specific force points up.",
        frame="B",
        shape=(3,),
    )
    angular_rate: Any = quantity("rad/s", "Angular velocity measured by the gyros.", frame="B", shape=(3,))
    accelerometer_saturated: Scalar = quantity("1", "True if an accelerometer is at its limit.", kind="flag")
    gyro_saturated: Scalar = quantity("1", "True if a gyro is at its limit.", kind="flag")


@record
class ImuState:
    """State of an inertial measurement unit: the states of its two triads. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    accelerometer: TriadState = part("State of the accelerometers.")
    gyro: TriadState = part("State of the gyros.")


@record
class Imu:
    """Three accelerometers and three gyros, fixed to the body.

        f = R_SB (a + 2 W × v + alpha × l + w × (w × l) - g),    omega = R_SB (w + W)

    where a is the acceleration of the centre of mass, l the lever arm, g gravity (down), W the earth's rotation (all in
    B), and R_SB the mounting. `measure` returns these values; `step` adds the errors of each triad.

    Frames:  lever arm in B from the centre of mass; mounting as roll, pitch, yaw of the unit in B.
    Not modelled: vibration, temperature, g-sensitivity, size effect, averaging (samples are instantaneous values).
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             eqs. 3.28-3.29, for the form of the errors; Groves, 2nd ed., section 4.4, for the rest.
    """

    accelerometer: AccelerometerErrors = part("Errors of the accelerometers.", default=AccelerometerErrors())
    gyro: GyroErrors = part("Errors of the gyros.", default=GyroErrors())
    lever_arm: Any = quantity(
        "m", "Position of the inertial unit relative to the centre of mass, in B.", frame="B", default=ZERO, shape=(3,)
    )
    mounting: Any = quantity(
        "rad",
        "Orientation of the inertial unit in B: roll, pitch, yaw.",
        default=ZERO,
        kind="angle",
        shape=(3,),
        off={"imu-mounting": ZERO},
    )
    gravity: Any = quantity("m/s^2", "Acceleration of gravity.", frame="W", default=(0.0, 0.0, STANDARD), shape=(3,))
    earth_rate: Any = quantity(
        "rad/s",
        "Rotation rate of the earth; 0 also switches off Coriolis acceleration.",
        frame="W",
        default=ZERO,
        shape=(3,),
    )
    period: int = period("Time between samples.", default=TICK)

    @classmethod
    def microstrain_3dm_gx1(cls, **settings: Any) -> "Imu":
        """Return the inertial unit of the hovercraft of [1]. settings: fields to change, as name=value.

        Printed in [1]: ranges of ±1.7 g (ADXL103) and ±300 deg/s, and the sampling period. Manufacturer's figures, as
        transcribed in public code: noise 0.4 m/s/√h and 3.5 deg/√h, biases 10 mg and 0.7 deg/s, 16-bit outputs with
        full scales of 8.5 g and 10 rad/s. Reconstructed (docs Errata): bias walks that give an Allan deviation at 15 s
        of 0.2 mg and 0.02 deg/s; bandwidth of 30 Hz, from the gyros' measured gains; scale factors 0.2 %, misalignments
        0.2 deg.
        """
        g = STANDARD
        accelerometer = AccelerometerErrors(
            noise=0.4 / 60,
            turn_on_bias=0.010 * g,
            bias_walk=4.2e-4,
            scale_factor=0.002,
            misalignment=0.2 * DEG,
            bandwidth=30.0,
            resolution=8.5 * g / 32768,
            range=1.7 * g,
        )
        gyro = GyroErrors(
            noise=3.5 * DEG / 60,
            turn_on_bias=0.7 * DEG,
            bias_walk=1.0e-4,
            scale_factor=0.002,
            misalignment=0.2 * DEG,
            bandwidth=30.0,
            resolution=10.0 / 32768,
            range=300 * DEG,
        )
        return cls(**{"accelerometer": accelerometer, "gyro": gyro, **settings})

    def check(self) -> None:
        """Raise InputError if a bandwidth is too high for the period, or a response was made for another period."""
        half = 0.5 / to_seconds(self.period)
        for name, errors in (("accelerometer", self.accelerometer), ("gyro", self.gyro)):
            if not errors.bandwidth < half:
                problem = (
                    f"a bandwidth of {errors.bandwidth:g} Hz is too high "
                    f"for a sampling period of {format_time(self.period)}"
                )
                fix = f"{argument('settings', 'VALUE', f'{name}.bandwidth')} with VALUE below {half:g} Hz, or 0"
                raise InputError(f"{name}.bandwidth", problem, fix=fix)
            tick = optional_member(errors.response, "sampling") or self.period
            if tick != self.period:
                own, other = format_time(self.period), format_time(tick)
                problem = f"the response is made for a sampling period of {other}, but the period of the unit is {own}"
                raise InputError(f"{name}.response", problem, fix=argument("settings", other, "period"))

    def init(self, key: Key) -> ImuState:
        """Return the initial state, with biases, scale factors and misalignments drawn for this run."""
        draws = normals(key.at("unit"), 0, 2 * UNIT_DRAWS)
        return ImuState(
            key=key.at("noise"),
            accelerometer=triad_state(self.accelerometer, draws[:UNIT_DRAWS]),
            gyro=triad_state(self.gyro, draws[UNIT_DRAWS:]),
        )

    def measure(self, motion: Motion) -> InertialReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        R_WB, w, arm = from_euler(*motion.attitude), motion.w_WB_B, jnp.asarray(self.lever_arm)
        turning = R_WB.T @ jnp.asarray(self.earth_rate)
        acceleration = motion.a_WB_B + 2 * jnp.cross(turning, motion.v_WB_B)
        swing = jnp.cross(motion.alpha_WB_B, arm) + jnp.cross(w, jnp.cross(w, arm))
        R_BS = from_euler(*jnp.asarray(self.mounting))
        return InertialReading(
            specific_force=R_BS.T @ (acceleration + swing - R_WB.T @ jnp.asarray(self.gravity)),
            angular_rate=R_BS.T @ (w + turning),
            accelerometer_saturated=jnp.asarray(False),
            gyro_saturated=jnp.asarray(False),
        )

    def step(self, t: Any, state: ImuState, motion: Motion) -> tuple[ImuState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true, dt = self.measure(motion), to_seconds(self.period)
        z = normals(state.key, t // self.period, 12)
        a, force, a_full = corrupt_triad(
            self.accelerometer, state.accelerometer, true.specific_force, dt, z[:3], z[3:6]
        )
        g, rate, g_full = corrupt_triad(self.gyro, state.gyro, true.angular_rate, dt, z[6:9], z[9:12])
        return ImuState(state.key, a, g), new_sample(t, InertialReading(force, rate, a_full, g_full))
