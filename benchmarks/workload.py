"""Benchmark loop of `benchmarks/README.md`, built from trimtab's World, Autopilot and walk.

`single(gains, key)` returns the same 14 numbers as every program in `reference/`: momenta, pose, filter states.
"""

import sys
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, period, quantity, record, replace, to_arrays
from trimtab.core.rng import Key, normal2, uniform2
from trimtab.core.rotation import planar
from trimtab.core.signals import Motion, PlanarForce, PlanarState, Sample, new_sample
from trimtab.core.time import ms, timetable
from trimtab.estimators.passthrough import Passthrough
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.walk import walk
from trimtab.loop.world import World
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

sys.path.insert(0, str(Path(__file__).parent / "reference"))
import spec

I2, Z2 = np.eye(2), np.zeros((2, 2))
LOGGED = ("truth", *(f"sensors.navigation.value.{n}" for n in ("surge_velocity", "sway_velocity", "yaw_rate")))
LOGGED += ("actuators.thrust", "actuators.rudder")
"""Paths of the 11 numbers that the programs of `reference/` log."""


def shared_stream(key: Key) -> Key:
    """Return the key unchanged. All parts share the run's key, because the workload numbers its random streams."""
    return Key(key.seed, key.run)


@record
class Filters:
    """State: true biases, heading filter (hx, hP), navigation filter (nx, nP). Source: benchmarks/README.md."""

    key: Any = part("Key of the noise.")
    bias: Any = quantity("1", "True sensor biases.", shape=(3,))
    om: Any = quantity("rad/s", "Estimated yaw rate.")
    hx: Any = quantity("1", "Estimated heading and gyro bias.", shape=(2,))
    hP: Any = quantity("1", "Covariance of heading and gyro bias.", shape=(2, 2))
    nx: Any = quantity("1", "Estimated position, velocity and accelerometer bias.", shape=(6,))
    nP: Any = quantity("1", "Covariance of position, velocity and accelerometer bias.", shape=(6, 6))


@record
class Navigator:
    """IMU, fixes and both filters aboard the vehicle. Source: benchmarks/README.md, steps 1 to 3."""

    period: int = period("Base tick.", default=ms(1))

    def init(self, key: Key) -> Filters:
        """Return the initial state of the workload."""
        return Filters(
            key=shared_stream(key),
            bias=jnp.array(spec.BIAS0),
            om=jnp.array(spec.OM0),
            hx=jnp.zeros(2),
            hP=jnp.diag(jnp.array(spec.HP0)),
            nx=jnp.array(spec.NX0),
            nP=spec.NP0 * jnp.eye(6),
        )

    def measure(self, motion: Motion) -> Any:
        """Return yaw rate and acceleration."""
        return jnp.stack([motion.w_WB_B[2], motion.a_WB_B[0], motion.a_WB_B[1]])

    def step(self, t: Any, s: Filters, motion: Motion) -> tuple[Filters, Sample]:
        """Take a sample, run the filters, and return the estimate."""
        k = t // ms(1)
        s = jax.lax.cond(t % spec.IMU_U < ms(1), lambda: imu(s, k, self.measure(motion)), lambda: s)
        due = (k % spec.FIX_TICKS == 0) & (k > 0)
        s = jax.lax.cond(due, lambda: fix(s, k, motion.p_WB[:2], motion.attitude[2]), lambda: s)
        v = planar(s.hx[0]).T @ s.nx[2:4]
        return s, new_sample(t, PlanarState(v[0], v[1], s.om, s.hx[0]))


def imu(s: Filters, k: Any, true: Any) -> Filters:
    """Take an IMU sample, and do the time update of both filters."""
    n0, n1 = normal2(s.key, k, 1)
    n2, n3 = normal2(s.key, k, 2)
    n4, n5 = normal2(s.key, k, 3)
    bias = s.bias + jnp.stack([spec.SBG * n0, spec.SBA * n1, spec.SBA * n2])
    meas = true + bias + jnp.stack([spec.SG * n3, spec.SA * n4, spec.SA * n5])
    om, dt = meas[0] - s.hx[1], spec.DTI
    hx = jnp.stack([s.hx[0] + om * dt, s.hx[1]])
    F = np.array([[1.0, -dt], [0.0, 1.0]])
    hP = F @ s.hP @ F.T + np.diag([(spec.SG * dt) ** 2, spec.SBG**2])
    R = planar(hx[0])
    a = R @ (meas[1:3] - s.nx[4:6])
    p, v, b = s.nx[0:2], s.nx[2:4], s.nx[4:6]
    nx = jnp.concatenate([p + dt * v + 0.5 * dt**2 * a, v + dt * a, b])
    F = jnp.block([[I2, dt * I2, -0.5 * dt**2 * R], [Z2, I2, -dt * R], [Z2, Z2, I2]])
    q = (spec.SA * dt) ** 2
    Q = np.diag([spec.QPOS, spec.QPOS, q, q, spec.SBA**2, spec.SBA**2])
    return replace(s, bias=bias, om=om, hx=hx, hP=hP, nx=nx, nP=F @ s.nP @ F.T + Q)


def fix(s: Filters, k: Any, position: Any, heading: Any) -> Filters:
    """Take a position and heading fix, and do the measurement update of both filters."""
    n0, n1 = normal2(s.key, k, spec.STREAM_FIX_POS)
    n2, _ = normal2(s.key, k, spec.STREAM_FIX_PSI)
    K = s.hP[:, 0] / (s.hP[0, 0] + spec.SPSI**2)
    hx = s.hx + K * (heading + spec.SPSI * n2 - s.hx[0])
    hP = s.hP - jnp.outer(K, s.hP[0, :])
    S = s.nP[0:2, 0:2] + spec.SPOS**2 * I2
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    K = s.nP[:, 0:2] @ (jnp.stack([jnp.stack([S[1, 1], -S[0, 1]]), jnp.stack([-S[1, 0], S[0, 0]])]) / det)
    nx = s.nx + K @ (position + spec.SPOS * jnp.stack([n0, n1]) - s.nx[0:2])
    return replace(s, hx=hx, hP=hP, nx=nx, nP=s.nP - K @ s.nP[0:2, :])


@record
class ReadDelay:
    """Ring buffer read with a random delay, drawn at each tick. Source: benchmarks/README.md, steps 3 and 5."""

    ticks: Scalar = quantity("1", "Smallest delay, in periods.", kind="count")
    jitter: Scalar = quantity("1", "Range of the jitter, in periods.", kind="real")
    draw: int = option("Index of the uniform number of stream 0 that sets the delay, 0 or 1.")
    period: int = period("Base tick.", default=ms(1))

    def init(self, key: Key, like: Sample) -> Any:
        """Return an empty ring buffer."""
        return shared_stream(key), jax.tree.map(lambda a: jnp.zeros((spec.NB, *jnp.shape(a))), like.value)

    def step(self, t: Any, state: Any, sample: Sample) -> tuple[Any, Sample]:
        """Write the sample, and return the one written some ticks ago."""
        key, ring = state
        k = t // self.period
        delay = self.ticks + (self.jitter * uniform2(key, k, spec.STREAM_DELAY)[self.draw]).astype(np.int32)
        ring = jax.tree.map(lambda r, v: r.at[k & (spec.NB - 1)].set(v), ring, sample.value)
        return (key, ring), replace(sample, value=jax.tree.map(lambda r: r[(k - delay) & (spec.NB - 1)], ring))


@record
class Thrust:
    """Thrust (N) along the rudder angle (rad). Source: benchmarks/README.md."""

    thrust: Scalar = quantity("N", "Thrust.")
    rudder: Scalar = quantity("rad", "Rudder.")


@record
class Demand:
    """Output of the control law. Source: benchmarks/README.md."""

    demand: PlanarForce = part("Force.")


@record
class LateralLaw:
    """Control law to zero velocity. Source: benchmarks/README.md, step 4."""

    k1: Scalar = quantity("kg/s", "Surge gain.")
    k2: Scalar = quantity("kg/s", "Sway gain.")
    arm: Scalar = quantity("m", "Arm.", default=spec.D)

    reads = ("surge_velocity", "sway_velocity", "yaw_rate")

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Any) -> tuple[tuple[()], Demand]:
        """The force."""
        e = estimate.state
        FY = -self.k2 * (e.sway_velocity - self.arm * e.yaw_rate)
        return state, Demand(demand=PlanarForce(FX=-self.k1 * e.surge_velocity, FY=FY))


@record
class Polar:
    """Allocation of a force to thrust and angle, with dead zone and limits. Source: benchmarks/README.md, step 4."""

    dead: Scalar = quantity("N", "Dead zone.", default=spec.DEAD)

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: PlanarForce) -> tuple[tuple[()], Thrust]:
        """The command."""
        FX, FY = demand.FX, demand.FY
        m = jnp.sqrt(FX * FX + FY * FY + 1e-12)
        T = jnp.where(m < self.dead, 0.0, jnp.clip(jnp.where(FX >= 0, m, -m), spec.TREV, spec.TMAX))
        angle = jnp.arctan(FY / jnp.where(jnp.abs(FX) < 1e-6, 1e-6, FX))
        return state, Thrust(thrust=T, rudder=jnp.clip(angle, -spec.ANGMAX, spec.ANGMAX))


@record
class FanState:
    """State of the fan: latch, brake and lags. Source: benchmarks/README.md."""

    latch: Thrust = part("Command latched by the servo.")
    act: Thrust = part("Thrust and rudder angle after the lags.")
    mode: Scalar = quantity("1", "Mode: 0 forward, 1 braking, 2 reverse.", kind="mode")
    timer: Scalar = quantity("1", "Remaining ticks of braking.", kind="count")


@record
class FanOutput:
    """Output of the fan. Source: benchmarks/README.md."""

    u: PlanarForce = part("Force.")
    thrust: Scalar = quantity("N", "Thrust.")
    rudder: Scalar = quantity("rad", "Rudder.")


@record
class Fan:
    """Fan: servo latch, speed controller, lags. Source: benchmarks/README.md, steps 5 to 7."""

    period: int = period("Base tick.", default=ms(1))

    def neutral(self) -> FanOutput:
        """At rest."""
        return FanOutput(u=PlanarForce(0.0, 0.0), thrust=0.0, rudder=0.0)

    def init(self, key: Key) -> FanState:
        """At rest."""
        zero = Thrust(thrust=0.0, rudder=0.0)
        return FanState(latch=zero, act=zero, mode=0, timer=0)

    def step(self, t: Any, s: FanState, command: Sample) -> tuple[FanState, FanOutput]:
        """Compute one base tick."""
        servo = t % ms(spec.SERVO_TICKS) == 0
        latch = jax.tree.map(lambda new, old: jnp.where(servo, new, old), command.value, s.latch)
        want, busy = jnp.where(latch.thrust < 0, 2, 0), s.mode == 1
        timer = jnp.where(busy, s.timer - 1, s.timer)
        start = (~busy) & (want != s.mode) & (latch.thrust != 0)
        mode = jnp.where(start, 1, jnp.where(busy & (timer <= 0), want, s.mode)).astype(np.int32)
        timer = jnp.where(start, spec.BRAKE, timer).astype(np.int32)
        T = jnp.where(mode == 1, 0.0, latch.thrust)
        at, ad = 1 - np.exp(-spec.DT / spec.TAU_T), 1 - np.exp(-spec.DT / spec.TAU_D)
        act = Thrust(s.act.thrust + at * (T - s.act.thrust), s.act.rudder + ad * (latch.rudder - s.act.rudder))
        u = PlanarForce(act.thrust * jnp.cos(act.rudder), act.thrust * jnp.sin(act.rudder))
        return FanState(latch, act, mode, timer), FanOutput(u=u, thrust=act.thrust, rudder=act.rudder)


def loop(gains: Any) -> tuple[World, Autopilot, HovercraftState]:
    """Return world, autopilot and initial state."""
    world = World(
        vehicle=Hovercraft(mass=spec.M, inertia=spec.J, arm=spec.D),
        sensors={"navigation": Navigator()},
        actuators=Fan(),
        downlink=ReadDelay(ticks=spec.DL, jitter=spec.DLJ, draw=0),
        uplink=ReadDelay(ticks=spec.UL, jitter=spec.ULJ, draw=1),
    )
    law = LateralLaw(k1=gains[0], k2=gains[1])
    autopilot = Autopilot(estimator=Passthrough(), law=law, allocation=Polar())
    px, py, h, X, Y, psi = spec.X0
    x = HovercraftState(px / spec.M, py / spec.M, h / spec.J, X, Y, psi)
    return to_arrays(world), to_arrays(autopilot), to_arrays(x)


def fly(gains: Any, key: Any, wanted: tuple[str, ...], n: int = spec.N) -> Any:
    """Return the 14 numbers, and the log of the wanted signals at every tick. wanted: paths; () logs nothing."""
    world, autopilot, x = loop(np.zeros(2))
    autopilot = replace(autopilot, law=replace(autopilot.law, k1=gains[0], k2=gains[1]))
    table = timetable([*world.periods(), autopilot.period], ms(n), world.max_step)
    rows = len(table.t) if wanted else 1
    index = np.arange(len(table.t), dtype=np.int32) if wanted else np.zeros(len(table.t), np.int32)
    instants, k = (table.t, table.h, index), Key(key[0], key[1])
    done = walk(world, autopilot, x, k, instants, rows, table.always, wanted)
    nav, v = done.sensors["navigation"], done.x
    momenta = jnp.stack([v.surge_velocity * spec.M, v.sway_velocity * spec.M, v.yaw_rate * spec.J])
    end = jnp.concatenate([momenta, jnp.stack([v.north, v.east, v.heading]), nav.hx, nav.nx])
    return (end, done.rows) if wanted else end


@cache
def _compiled(wanted: tuple[str, ...]) -> Any:
    return jax.jit(partial(fly, wanted=wanted))


def single(gains: Any, key: Any) -> Any:
    """Return the 14 numbers of one run, without a log."""
    return np.asarray(_compiled(())(gains, key))


def logged(wanted: tuple[str, ...]) -> Any:
    """Return a function that simulates a run and returns the 14 numbers and the log (ticks, signals)."""
    return lambda gains, key: jax.block_until_ready(_compiled(wanted)(gains, key))


if __name__ == "__main__":
    print(single(np.array(spec.GAINS), np.array([spec.KEY0, 0], np.uint32)))
