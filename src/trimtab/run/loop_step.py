"""Step of a scenario's loop by one instant, and the derivatives of this step.

The step is that of the simulation, without noise. z contains all real numbers of the loop's state, including samples
in transit.

Source: docs page, Time, for the order of computation.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.interfaces import optional_member
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace
from trimtab.core.rng import Key
from trimtab.core.time import Instant
from trimtab.links.fifo import Fifo
from trimtab.links.wire import DelayLine
from trimtab.loop.scenario import Scenario
from trimtab.loop.structure import cast_like, step_if
from trimtab.loop.walk import start
from trimtab.run.loop_coordinates import LoopCoordinates, is_real


class LoopStep:
    """Step of a loop by one instant, and the derivatives of this step.

    The report of the integration is not a state of the loop: each instant begins with the first report.
    """

    def __init__(self, loop: Scenario, tick: int) -> None:
        self.loop, self.tick = loop, tick
        self._report: Any = ()
        self._fly: Any = jax.jit(self._many, compiler_options=FAST_COMPILE_OPTIONS)
        self._slopes: Any = jax.jit(self._differentiate, static_argnums=3, compiler_options=FAST_COMPILE_OPTIONS)

    def coordinates(self, like: tuple[Any, Any]) -> LoopCoordinates:
        """Return the coordinates for states of world and autopilot. like: example of these states."""
        return LoopCoordinates(like)

    def start(self, x: Any) -> tuple[Any, Any]:
        """Return the initial states of world and autopilot. x: initial state of the vehicle."""
        s, a = start(self.loop.world, self.loop.autopilot, x, Key(np.uint32(0), np.uint32(0)))
        self._report = s.integrated
        return replace(s, integrated=()), a

    def fly(self, s: Any, a: Any, t: int, count: int) -> tuple[Any, Any, int]:
        """Return the states of world and autopilot, and the time (100 ns), after `count` instants."""
        s, a = self._fly(s, a, np.int64(t), np.int64(count))
        return s, a, t + count * self.tick

    def slopes(self, s: Any, a: Any, t: int, count: int) -> tuple[Any, Any, Any, Any, Any]:
        """Return the states of world and autopilot after `count` instants, and the matrices A_j, B_j, C_j of instants
        j."""
        (s, a), (A, B, C) = self._slopes(s, a, np.int64(t), count)
        return s, a, np.array(A), np.array(B), np.array(C)

    def align(self, s: Any, a: Any, span: int) -> tuple[Any, Any]:
        """Return the states with the ring buffers of the links rotated back by a time `span` (100 ns).

        The slot in which a sample is stored depends on the time. Therefore the states of different periods can be
        compared only after this rotation.
        """
        world = self.loop.world
        down = {n: _roll_ring(world.downlink, own, span) for n, own in s.downlink.items()}
        return replace(s, downlink=down, uplink=_roll_ring(world.uplink, s.uplink, span)), a

    def _step(self, s: Any, a: Any, t: Any, v: Any = None) -> tuple[Any, Any, Any]:
        """Return the states after one instant, and the command that the autopilot issues.

        v: command (m,) that is sent instead of the issued command, or None.
        """
        world, autopilot, clock = self.loop.world, self.loop.autopilot, Instant(t)
        seen, frame = world.sense(clock, s)
        due = clock.due(autopilot.period)
        new = step_if(due, lambda: autopilot.step(t, a, frame)[0], lambda: autopilot.hold(t, a))
        c = _vector(new.command.value)
        command = new.command if v is None else replace(new.command, value=_like_vector(new.command.value, v))
        acted = replace(world.act(clock, seen, command, due), integrated=self._report)
        acted = replace(world.advance(t, acted, np.int64(self.tick)), integrated=())
        return cast_like(acted, s), cast_like(new, a), c

    def _many(self, s: Any, a: Any, t: Any, count: int) -> tuple[Any, Any]:
        def body(j: Any, carry: Any) -> tuple[Any, Any]:
            s, a = carry
            return self._step(s, a, t + j * self.tick)[:2]

        return jax.lax.fori_loop(0, count, body, (s, a))

    def _differentiate(self, s: Any, a: Any, t: Any, count: int) -> Any:
        own = self.coordinates((s, a))
        zero = jnp.zeros(len(own.names((s, a))))

        def body(carry: Any, j: Any) -> tuple[Any, Any]:
            s, a = carry
            now = t + j * self.tick
            s1, a1, c = self._step(s, a, now)

            def issue(z: Any) -> Any:
                return self._step(*own.displace((s, a), z), now)[2]

            def go(z: Any, v: Any) -> Any:
                return own.deviation((s1, a1), self._step(*own.displace((s, a), z), now, v)[:2])

            A, B = jax.jacfwd(go, argnums=(0, 1))(zero, c)
            return (s1, a1), (A, B, jax.jacfwd(issue)(zero))

        return jax.lax.scan(body, (s, a), jnp.arange(count))


def _roll_ring(link: Any, state: Any, span: int) -> Any:
    if isinstance(state, Fifo):
        slots = span // (optional_member(link, "send_period") or link.period)
        ring = ("values", "measured", "due", "serial")
    elif isinstance(state, DelayLine):
        slots, ring = span // link.period, ("values", "measured")
    else:
        return state
    rolled = {n: jax.tree.map(lambda v: jnp.roll(v, -slots, axis=0), getattr(state, n)) for n in ring}
    return replace(state, **rolled)


def _vector(tree: Any) -> Any:
    return jnp.concatenate([jnp.ravel(v) for v in jax.tree.leaves(tree) if is_real(v)])


def _like_vector(tree: Any, v: Any) -> Any:
    values, structure = jax.tree.flatten(tree)
    new, begin = [], 0
    for own in values:
        size = int(np.size(own))
        new.append(v[begin : begin + size].reshape(np.shape(own)) if is_real(own) else own)
        begin += size if is_real(own) else 0
    return jax.tree.unflatten(structure, new)
