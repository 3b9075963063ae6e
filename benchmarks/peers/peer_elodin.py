"""Hovercraft closed loop in Elodin: components and systems, which Elodin's own compiler (Cranelift) compiles.

    python benchmarks/peers/run.py elodin

Simplified: nothing that changes results. Order, noise and delays are those of the loop. A world can be simulated only
once, so it is built before the time is measured. Telemetry has one row per second, the minimum, and its last row is the
end of the run. With Elodin's default of 1000 rows per second, a run takes three times as long.

Elodin 0.18.0 computes wrong numbers, without a message, for three ways to write the loop. Its other backend, JAX, is
right. This program avoids them. tests/compiler/test_shapes_of_peers.py tests trimtab's compiler on the same cases:

- `map` over several vehicles if each ring buffer is read at a different position. Instead: `map_seq`.
- A command selected by one truth value, `where(k % 20 == 0, received, latch)`, after a read with a random delay: the
  second number is never selected. Instead: the truth value is repeated for each number.
- The whole tick as one function: draws after a branch that draws noise change the noise of the branch. Instead: one
  system for each part.
"""

from dataclasses import field, make_dataclass
from typing import Annotated

import elodin as el
import hover_jax as hover
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from spec import BIAS0, DL, DLJ, DT, FIX_TICKS, HP0, IMU_U, NB, NP0, NX0, OM0, SERVO_TICKS, TICK_U, UL, ULJ, X0, N

BLANK = hover.init()


def component(name, *shape, kind=el.PrimitiveType.F64):
    return Annotated[jax.Array, el.Component(name, el.ComponentType(kind, shape))]


Key = component("key", 2, kind=el.PrimitiveType.U64)
Gains = component("gains", 2)
Tick = component("k", 1, kind=el.PrimitiveType.U64)
X = component("x", 6)
Act = component("act", 2)
Esc = component("esc", 2)  # mode, timer
Latch = component("latch", 2)
Bias = component("bias", 3)
Om = component("om", 1)
Hx = component("hx", 2)
HP = component("hp", 2, 2)
Nx = component("nx", 6)
NP = component("np", 6, 6)
Down = component("down", NB, 3)
Up = component("up", NB, 2)
Received = component("received", 3)

START = {
    "tick": (Tick, np.zeros(1, np.uint64)),
    "x": (X, np.array(X0)),
    "act": (Act, np.zeros(2)),
    "esc": (Esc, np.zeros(2)),
    "latch": (Latch, np.zeros(2)),
    "bias": (Bias, np.array(BIAS0)),
    "om": (Om, np.array([OM0])),
    "hx": (Hx, np.zeros(2)),
    "hP": (HP, np.diag(HP0)),
    "nx": (Nx, np.array(NX0)),
    "nP": (NP, NP0 * np.eye(6)),
    "down": (Down, np.zeros((NB, 3))),
    "up": (Up, np.zeros((NB, 2))),
    "received": (Received, np.zeros(3)),
}
STATE = [(name, kind, field(default_factory=value.copy)) for name, (kind, value) in START.items()]
Craft = make_dataclass("Craft", [("key", Key), ("gains", Gains), *STATE], bases=(el.Archetype,))


def number(tick):
    return tick[0].astype(jnp.int32)


def uniforms(key, tick):
    return hover.uni(key.astype(jnp.uint32), number(tick), 0)


def imu(
    key: Key, tick: Tick, x: X, act: Act, bias: Bias, om: Om, hx: Hx, hP: HP, nx: Nx, nP: NP
) -> tuple[Bias, Om, Hx, HP, Nx, NP]:
    def sample():
        s = BLANK._replace(x=x, act=act, bias=bias, om=om[0], hx=hx, hP=hP, nx=nx, nP=nP)
        s = hover.imu(s, key.astype(jnp.uint32), number(tick))
        return s.bias, s.om[None], s.hx, s.hP, s.nx, s.nP

    return lax.cond((number(tick) * TICK_U) % IMU_U < TICK_U, sample, lambda: (bias, om, hx, hP, nx, nP))


def fix(key: Key, tick: Tick, x: X, hx: Hx, hP: HP, nx: Nx, nP: NP) -> tuple[Hx, HP, Nx, NP]:
    def update():
        s = hover.fix(BLANK._replace(x=x, hx=hx, hP=hP, nx=nx, nP=nP), key.astype(jnp.uint32), number(tick))
        return s.hx, s.hP, s.nx, s.nP

    return lax.cond((number(tick) % FIX_TICKS == 0) & (number(tick) > 0), update, lambda: (hx, hP, nx, nP))


def downlink(key: Key, tick: Tick, hx: Hx, nx: Nx, om: Om, down: Down) -> tuple[Down, Received]:
    delay = DL + (DLJ * uniforms(key, tick)[0]).astype(jnp.int32)
    return hover.through(down, hover.estimate(BLANK._replace(hx=hx, nx=nx, om=om[0])), number(tick), delay)


def controller(key: Key, tick: Tick, gains: Gains, received: Received, up: Up, latch: Latch) -> tuple[Up, Latch]:
    delay = UL + (ULJ * uniforms(key, tick)[1]).astype(jnp.int32)
    up, command = hover.through(up, hover.control(gains, received), number(tick), delay)
    return up, jnp.where(jnp.full(2, number(tick) % SERVO_TICKS == 0), command, latch)


def actuators(latch: Latch, esc: Esc, act: Act) -> tuple[Esc, Act]:
    mode, timer, T = hover.esc(esc[0].astype(jnp.int32), esc[1].astype(jnp.int32), latch[0])
    act = jnp.array([act[0] + hover.AT * (T - act[0]), act[1] + hover.AD * (latch[1] - act[1])])
    return jnp.array([mode, timer]).astype(float), act


def plant(tick: Tick, x: X, act: Act) -> tuple[X, Tick]:
    x = hover.rk4(x, act[0] * jnp.cos(act[1]), act[0] * jnp.sin(act[1]), DT)
    return x, tick + jnp.uint64(1)


def build(gains, keys):
    """Return a compiled world with one vehicle for each key."""
    mapped = el.map if len(keys) == 1 else el.map_seq
    first, *others = [mapped(system) for system in (imu, fix, downlink, controller, actuators, plant)]
    for system in others:
        first = first | system
    world = el.World()
    for i, key in enumerate(keys):
        world.spawn(Craft(key=np.asarray(key, np.uint64), gains=np.asarray(gains, float)), name=f"craft{i}")
    return world.build(first, simulation_rate=1 / DT, telemetry_rate=1.0)


def end(world, craft):
    """Return x, hx and nx from the last row of the telemetry."""
    row = world.history([f"craft{craft}.{name}" for name in ("x", "hx", "nx")]).tail(1)
    return np.concatenate([np.asarray(row[c][0], float).ravel() for c in row.columns if c != "time"])


WORLDS = {}


def prepare(gains, key, runs=1):
    """Build the world of one run, or of several runs with increasing keys."""
    keys = [(int(key[0]), int(key[1]) + i) for i in range(runs)]
    WORLDS.setdefault((*gains, *keys), []).append(build(gains, keys))


def single(gains, key):
    return campaign(gains, key, 1)[0]


def campaign(gains, key, runs):
    keys = [(int(key[0]), int(key[1]) + i) for i in range(runs)]
    world = WORLDS[(*gains, *keys)].pop()
    world.run(N, show_progress=False)
    return [end(world, i) for i in range(runs)]
