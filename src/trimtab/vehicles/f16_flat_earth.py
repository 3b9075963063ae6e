"""F-16 of Stevens and Lewis: thirteen states over a flat earth, with engine lag.

[1] is B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft control and simulation", 3rd ed., Wiley 2015.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion
from trimtab.environment.atmosphere import AirProperties
from trimtab.vehicles.f16 import AREA, CHORD, INERTIA, REFERENCE, SPAN, F16Controls, coefficients, engine_thrust
from trimtab.vehicles.imperial import FOOT, SLUG
from trimtab.vehicles.rigid_body import Airflow, Wrench

GRAVITY = 32.17 * FOOT
"""Acceleration of gravity (m/s²)."""
SEA_DENSITY = 2.377e-3 * SLUG / FOOT**3
RANKINE = 5 / 9
"""Size of one degree Rankine in kelvins."""
GAS_CONSTANT = 1716.3 * FOOT**2 / RANKINE
"""Gas constant of air (J/(kg K))."""
GEAR_KNEE = 0.77
"""Throttle at which the engine command reaches military power."""


@record
class F16State:
    """State of the F-16: airspeed and air angles, attitude, rates, position and engine power.

    Frames:  W north-east-down; rates in B.
    Source:  [1] table 3.5-2.
    """

    speed: Scalar = quantity("m/s", "Airspeed.", above=0)
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    beta: Scalar = quantity("rad", "Sideslip angle, positive with the wind from starboard.", kind="angle")
    roll: Scalar = quantity("rad", "Bank angle, starboard wing down.", frame="WB", kind="angle")
    pitch: Scalar = quantity("rad", "Pitch angle, nose up.", frame="WB", kind="angle")
    yaw: Scalar = quantity("rad", "Yaw angle, clockwise from north.", frame="WB", kind="angle")
    roll_rate: Scalar = quantity("rad/s", "Roll rate P.", frame="B")
    pitch_rate: Scalar = quantity("rad/s", "Pitch rate Q.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate R.", frame="B")
    north: Scalar = quantity("m", "North position.", frame="W")
    east: Scalar = quantity("m", "East position.", frame="W")
    altitude: Scalar = quantity("m", "Altitude above the ground, which is at sea level.", frame="W")
    power: Scalar = quantity("1", "Power of the engine: 0 idle, 0.5 military, 1 full afterburner.")


class Loads(NamedTuple):
    """Velocity, forces and accelerations of the F-16.

    velocity: in B (3,) (m/s). wrench: force and moment of air and engine. acceleration: relative to W, resolved in B
    (3,) (m/s²). turn: angular acceleration in B (3,) (rad/s²).
    """

    velocity: Any
    wrench: Wrench
    acceleration: Any
    turn: Any


@record
class F16FlatEarth:
    """F-16 over a flat earth that does not rotate, with the tables and the equations of [1].

        m (v' + w × v) = F + m R_WB' g        J w' + w × (J w + h) = M        h: angular momentum of the engine
        power' = (wanted - power)/T(power, wanted)        wanted: `engine_command` of the throttle

    The state is that of [1]: velocity as speed, angle of attack and sideslip, and attitude as Euler angles.

    Frames:  W north-east-down, its origin on the ground; B at the centre of mass, x forward, y starboard, z down.
    Valid:   angle of attack -10 to 45 degrees, sideslip within 30 degrees, up to Mach 0.6, pitch away from 90 degrees,
             where Euler angles are singular. Not modelled: wind, lag of the control surfaces (`actuators.bank`), the
             leading-edge flap.
    Source:  [1] sections 3.5 and 3.6 and appendix A; tables as in `vehicles.f16`.
    """

    mass: Scalar = quantity(
        "kg", "Mass of the aeroplane.", default=SLUG / 1.57e-3, above=0, source="[1] fig. 3.5-1, RM"
    )
    inertia: Any = quantity(
        "kg m^2",
        "Moments of inertia Jx, Jy, Jz about the axes of B.",
        frame="B",
        shape=(3,),
        default=np.array([9496.0, 55814.0, 63100.0]) * INERTIA,
        source="[1] table 3.5-1",
    )
    product: Scalar = quantity(
        "kg m^2", "Product of inertia Jzx.", frame="B", default=982.0 * INERTIA, source="[1] table 3.5-1"
    )
    engine_momentum: Scalar = quantity(
        "kg m^2/s", "Angular momentum of the engine, along x.", frame="B", default=160.0 * INERTIA, source="[1] 3.5"
    )
    centre: Scalar = quantity(
        "1", "Distance of the centre of mass behind the leading edge (chord lengths).", default=0.35, low=0.1, high=0.45
    )
    gravity: Scalar = quantity("m/s^2", "Acceleration of gravity.", default=GRAVITY, source="[1] fig. 3.5-1, GD")

    MAV_TYPE: ClassVar[str] = "FIXED_WING"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def check(self) -> None:
        """Raise InputError for moments and products of inertia that are physically impossible."""
        x, y, z = np.asarray(self.inertia, float)
        moments = np.linalg.eigvalsh([[x, 0, -self.product], [0, y, 0], [-self.product, 0, z]])
        if moments[0] <= 0 or moments[0] + moments[1] < moments[2]:
            problem = f"principal moments of inertia of {np.round(moments, 6).tolist()} are not possible for a body"
            raise InputError("inertia", problem, fix="give moments above 0, none greater than the sum of the other two")

    def loads(self, x: F16State, u: F16Controls) -> Loads:
        """Return velocity, force and moment, and accelerations for a state and an input."""
        ca, sa, cb, sb = jnp.cos(x.alpha), jnp.sin(x.alpha), jnp.cos(x.beta), jnp.sin(x.beta)
        velocity = x.speed * jnp.stack([ca * cb, sb, sa * cb])
        rate = jnp.stack([x.roll_rate, x.pitch_rate, x.yaw_rate])
        flow = Airflow(velocity, x.speed, rate, air_data(x.altitude))
        qS = flow.pressure * AREA
        C = coefficients(flow, u)
        thrust = engine_thrust(x.power, flow.mach, x.altitude)
        aero = qS * C[:3]
        arm = (self.centre - REFERENCE) * CHORD
        moment = qS * C[3:] * jnp.array([SPAN, CHORD, SPAN]) + arm * jnp.stack([0 * aero[0], -aero[2], aero[1]])
        force = aero + jnp.stack([thrust, 0 * thrust, 0 * thrust])
        down = jnp.stack([-jnp.sin(x.pitch), jnp.cos(x.pitch) * jnp.sin(x.roll), jnp.cos(x.pitch) * jnp.cos(x.roll)])
        return Loads(velocity, Wrench(force, moment), force / self.mass + self.gravity * down, self._turn(rate, moment))

    def _turn(self, w: Any, moment: Any) -> Any:
        """Return the angular acceleration w' that solves J w' = M - w × (J w + h)."""
        (jx, jy, jz), jxz = self.inertia, self.product
        p, q, r = w
        hx, hy, hz = jx * p - jxz * r + self.engine_momentum, jy * q, jz * r - jxz * p
        tx, ty, tz = moment - jnp.stack([q * hz - r * hy, r * hx - p * hz, p * hy - q * hx])
        size = jx * jz - jxz**2
        return jnp.stack([(jz * tx + jxz * tz) / size, ty / jy, (jxz * tx + jx * tz) / size])

    def dynamics(self, t: Any, x: F16State, u: F16Controls) -> F16State:
        """Return the time derivative of the state x."""
        f = self.loads(x, u)
        p, q, r = x.roll_rate, x.pitch_rate, x.yaw_rate
        ub, vb, wb = f.velocity
        du, dv, dw = f.acceleration - jnp.cross(jnp.stack([p, q, r]), f.velocity)
        along = (ub * du + vb * dv + wb * dw) / x.speed
        forward2 = ub * ub + wb * wb
        turning = q * jnp.sin(x.roll) + r * jnp.cos(x.roll)
        over_ground = from_euler(x.roll, x.pitch, x.yaw) @ f.velocity
        return F16State(
            speed=along,
            alpha=(ub * dw - wb * du) / forward2,
            beta=(x.speed * dv - vb * along) * jnp.cos(x.beta) / forward2,
            roll=p + jnp.tan(x.pitch) * turning,
            pitch=q * jnp.cos(x.roll) - r * jnp.sin(x.roll),
            yaw=turning / jnp.cos(x.pitch),
            roll_rate=f.turn[0],
            pitch_rate=f.turn[1],
            yaw_rate=f.turn[2],
            north=over_ground[0],
            east=over_ground[1],
            altitude=-over_ground[2],
            power=power_rate(x.power, engine_command(u.throttle)),
        )

    def motion(self, t: Any, x: F16State, u: F16Controls) -> Motion:
        """Return the motion of the centre of mass at time t (unit: 100 ns), for sensors."""
        f = self.loads(x, u)
        return Motion(
            t=t,
            p_WB=jnp.stack([x.north, x.east, -x.altitude]),
            attitude=jnp.stack([x.roll, x.pitch, x.yaw]),
            v_WB_B=f.velocity,
            w_WB_B=jnp.stack([x.roll_rate, x.pitch_rate, x.yaw_rate]),
            a_WB_B=f.acceleration,
            alpha_WB_B=f.turn,
        )


def air_data(height: Any) -> AirProperties:
    """Return the air properties at a height (m). Source: [1] fig. A-2, ADC. The viscosity is 0, because [1] does not
    give it."""
    altitude = height / FOOT
    share = 1 - 0.703e-5 * altitude
    temperature = jnp.where(altitude >= 35_000, 390.0, 519 * share) * RANKINE
    density = SEA_DENSITY * jnp.exp(4.14 * jnp.log(share))
    sound = jnp.sqrt(1.4 * GAS_CONSTANT * temperature)
    return AirProperties(temperature, density * GAS_CONSTANT * temperature, density, sound, 0 * sound)


def engine_command(throttle: Any) -> Any:
    """Return the commanded engine power (0 to 1) for a throttle (0 to 1). Source: [1] appendix A, TGEAR."""
    return jnp.where(throttle <= GEAR_KNEE, 0.6494 * throttle, 2.1738 * throttle - 1.1738)


def power_rate(power: Any, wanted: Any) -> Any:
    """Return the rate of change of the engine power (1/s), which depends on the size of the change and the afterburner.

    Source: [1] appendix A, PDOT and RTAU.
    """
    burns, shall_burn = power >= 0.5, wanted >= 0.5
    towards = jnp.where(shall_burn, jnp.where(burns, wanted, 0.6), jnp.where(burns, 0.4, wanted))
    gap = 100 * (towards - power)
    dry = jnp.clip(1.9 - 0.036 * gap, 0.1, 1.0)
    return jnp.where(burns, 5.0, dry) * (towards - power)
