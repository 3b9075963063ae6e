"""Ground collision avoidance: below a minimum altitude the law rolls the wings level and pulls up.

[1] is P. Heidlauf, A. Collins, M. Bolender, S. Bak, "Verification challenges in F-16 ground collision avoidance and
other automated maneuvers", ARCH 2018.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.rng import Key
from trimtab.core.rotation import DEG, wrap
from trimtab.core.signals import Estimate
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.imperial import FOOT

MODES = ("standby", "roll", "pull")
STANDBY, ROLL, PULL = range(3)


@record
class LoadFactorControl:
    """Controller of load factor, roll rate and sideslip: state feedback with integrals of the command errors.

        elevator       = trim - K (alpha - alpha0, q, ∫(nz - 1 - nz_ref))
        aileron, rudder =      - K (beta, p, r, ∫(ps - ps_ref), ∫(ny + r))        ps = p cos alpha + r sin alpha

    alpha is the angle of attack, beta the sideslip angle, p, q and r are the body rates, nz and ny the load factors,
    and ps is the roll rate about the flight path. Gains are those of a linear quadratic regulator at 502 ft/s and 1000
    ft (`scenarios.f16._gains`).

    Frames:  body rates; load factors at the accelerometers, which [1] places 15 ft in front of the centre of mass.
    Source:  [1], low-level controller, which adds ny (in g) and r (in rad/s) as plain numbers.
    """

    longitudinal: Any = quantity(
        "1",
        "Gain from angle of attack (rad), pitch rate (rad/s) and load factor integral (s) to the elevator (rad).",
        shape=(3,),
        default=np.array([-2.7452436, -0.5424604, -0.6759631]),
        source="scenarios.f16._gains",
    )
    lateral: Any = quantity(
        "1",
        "Gain to aileron and rudder (rad), from sideslip (rad), roll rate and yaw rate (rad/s), and the "
        "integrals of roll rate error (rad) and of side load plus yaw rate.",
        shape=(2, 5),
        default=np.array(
            [
                [0.6602139, -0.4435218, -0.1190806, -5.8101709, -0.2994289],
                [-0.4168640, 0.0996614, -0.3774424, 1.1282363, -1.5419933],
            ]
        ),
        source="scenarios.f16._gains",
    )
    trim_alpha: Scalar = quantity(
        "rad", "Angle of attack at the trim in level flight.", default=0.0387535, kind="angle"
    )
    trim_elevator: Scalar = quantity(
        "rad", "Elevator angle at the trim in level flight.", default=-0.0130925, kind="angle"
    )
    throttle: Scalar = quantity("1", "Throttle at the trim in level flight.", default=0.1401371, low=0, high=1)

    def errors(self, x: Any, load: Any, roll: Any) -> Any:
        """Return the errors (3,) to be integrated: load factor (1), roll rate (rad/s), side load plus yaw rate."""
        about_path = x.roll_rate * jnp.cos(x.alpha) + x.yaw_rate * jnp.sin(x.alpha)
        return jnp.stack([x.normal_load - 1 - load, about_path - roll, x.side_load + x.yaw_rate])

    def surfaces(self, x: Any, integrals: Any) -> F16Controls:
        """Return the surface angles for a measured flight condition and the three integrals."""
        along = jnp.stack([x.alpha - self.trim_alpha, x.pitch_rate, integrals[0]])
        aside = jnp.stack([x.beta, x.roll_rate, x.yaw_rate, integrals[1], integrals[2]])
        aileron, rudder = -jnp.asarray(self.lateral) @ aside
        elevator = self.trim_elevator - jnp.asarray(self.longitudinal) @ along
        return F16Controls(elevator=elevator, aileron=aileron, rudder=rudder, throttle=self.throttle)


@record
class GroundAvoidanceState:
    """State of the law `GroundAvoidance`. Frames: none. Source: [1]."""

    integrals: Any = quantity(
        "s", "Integrals of the errors of load factor (s), roll rate (rad), and side load plus yaw rate.", shape=(3,)
    )
    mode: Scalar = quantity("1", "Active mode of the law: standby, roll or pull.", kind="mode", modes=MODES)
    pulls: Scalar = quantity("s", "Time since the pull-up began.")


@record
class GroundAvoidanceOutput:
    """Demand of the law `GroundAvoidance`. Source: [1]."""

    demand: F16Controls = part("Demanded surface angles and throttle.")
    mode: Scalar = quantity("1", "Active mode of the law: standby, roll or pull.", kind="mode", modes=MODES)
    load_command: Scalar = quantity("1", "Commanded load factor minus 1.")
    roll_rate_command: Scalar = quantity("rad/s", "Commanded roll rate about the flight path.")
    load_error: Scalar = quantity("1", "Load factor minus the commanded load factor.")


@record
class GroundAvoidance:
    """Law of [1] for the ground collision avoidance of an F-16.

        standby  --flies down, below `deck`-->  roll  --wings level, roll rate low-->  pull
        pull     --flies up, and has pulled for `least_pull`-->  standby

    The mode standby demands a load factor of 1 and no roll. The mode roll demands the roll rate ps = -k_roll phi -
    k_damp p, with the bank angle phi and the measured roll rate p. The mode pull demands a load factor of 1 + `load`.

    Frames:  altitude above the ground at the origin of W; roll angle from the nearest wings-level attitude.
    Not modelled: terrain; throttle control. The throttle stays at its trim value, as in [1].
    Source:  [1]; the default parameters are those of the authors' program AeroBenchVV.
    """

    control: LoadFactorControl = part("Controller of load factor and roll rate.", default=LoadFactorControl())
    deck: Scalar = quantity("m", "Altitude below which the law acts.", default=1000 * FOOT)
    load: Scalar = quantity("1", "Commanded load factor minus 1 in the pull-up.", default=5.0)
    roll_gain: Scalar = quantity("1/s", "Roll gain: commanded roll rate per bank angle.", default=4.0)
    roll_damping: Scalar = quantity(
        "1", "Roll damping: reduction of the commanded roll rate per measured roll rate.", default=2.0
    )
    most_roll: Scalar = quantity(
        "rad/s",
        "Maximum commanded roll rate. The default is so large that it never limits, because [1] has no limit.",
        default=100.0,
        above=0,
    )
    level_bank: Scalar = quantity(
        "rad", "Bank angle below which the wings count as level.", default=5 * DEG, kind="angle", above=0
    )
    level_rate: Scalar = quantity(
        "rad/s", "Roll rate below which the roll motion counts as stopped.", default=10 * DEG, above=0
    )
    path: Scalar = quantity("rad", "Flight path angle above which the pull-up may end.", default=0.0, kind="angle")
    least_pull: Scalar = quantity("s", "Minimum duration of the pull-up.", default=2.0, low=0)

    reads: ClassVar[tuple[str, ...]] = (
        "alpha",
        "beta",
        "altitude",
        "roll",
        "pitch",
        "roll_rate",
        "pitch_rate",
        "yaw_rate",
        "normal_load",
        "side_load",
    )

    def init(self, key: Key) -> GroundAvoidanceState:
        """Return the initial state: mode standby, all integrals zero."""
        return GroundAvoidanceState(jnp.zeros(3), np.int32(STANDBY), jnp.zeros(()))

    def step(self, t: Any, state: GroundAvoidanceState, estimate: Estimate) -> tuple[Any, GroundAvoidanceOutput]:
        """Return the demanded surface angles and throttle at time t (unit: 100 ns)."""
        x, dt = estimate.state, estimate.dt
        mode = self._next_mode(state, x)
        pulls, rolls = mode == PULL, mode == ROLL
        load = jnp.where(pulls, self.load, 0.0)
        back = -self.roll_gain * wrap(x.roll) - self.roll_damping * x.roll_rate
        roll = jnp.where(rolls, jnp.clip(back, -self.most_roll, self.most_roll), 0.0)
        error = self.control.errors(x, load, roll)
        demand = self.control.surfaces(x, state.integrals)
        new = GroundAvoidanceState(
            integrals=state.integrals + dt * error, mode=mode, pulls=jnp.where(pulls, state.pulls + dt, 0.0)
        )
        return new, GroundAvoidanceOutput(demand, mode, load, roll, error[0])

    def _next_mode(self, state: GroundAvoidanceState, x: Any) -> Any:
        rises = wrap(x.pitch - x.alpha) > self.path
        level = (jnp.abs(wrap(x.roll)) < self.level_bank) & (jnp.abs(x.roll_rate) < self.level_rate)
        waits, rolls, pulls = (state.mode == m for m in (STANDBY, ROLL, PULL))
        mode = jnp.where(waits & ~rises & (x.altitude < self.deck), ROLL, state.mode)
        mode = jnp.where(rolls & level, PULL, mode)
        return jnp.where(pulls & rises & (state.pulls >= self.least_pull), STANDBY, mode).astype(np.int32)
