"""Swarm of n craft in one control loop. Each craft has a separate copy of every part, a state and a random key.

The parts are defined for one craft. `Each` steps n copies of a part with jax.vmap. Copy i receives only element i of
the inputs. Therefore a craft can depend on other craft only through received radio messages (`loop.peer_radio`).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import declarations, option, part, record, replace, tree_where
from trimtab.core.rng import Key, split
from trimtab.core.signals import Estimate, Sample, SwarmInput, SwarmMotion
from trimtab.loop.structure import strengthen_types


@record
class Each:
    """Copies of a part, one for each of n craft. The part is a sensor, estimator, law, allocation or actuators.

    The first axis of input arrays is the craft. A scalar input is the same for every craft. All copies have the
    parameters of the part `one`, except the fields named in `own`. These fields are arrays whose first axis is the
    craft.

    Frames: those of the part. Source: docs page, Swarms.
    """

    one: Any = part("Part of which each craft has a copy.")
    count: int = option("Number of craft.", default=3)
    own: tuple[str, ...] = option("Names of the part's fields that differ from craft to craft.", default=())

    @property
    def period(self) -> int:
        """Return the period (unit: 100 ns) at which the copies of the part are updated."""
        return self.one.period

    @property
    def reads(self) -> tuple[str, ...]:
        """Return the names of the state fields that the law of each craft reads."""
        return self.one.reads

    @property
    def stick(self) -> str:
        """Return the name of the stick that the law of each craft reads."""
        return optional_member(self.one, "stick")

    @property
    def frame(self) -> Any:
        """Return the period of the actuators' frames, or None if the actuators have no frames."""
        return optional_member(self.one, "frame")

    def check(self) -> None:
        """Raise InputError unless each name in `own` is a field of the part with one value for each craft."""
        for name in self.own:
            if name not in declarations(self.one):
                problem = f"{type(self.one).__name__} has no field {name!r}"
                raise InputError("Each.own", problem, choices=declarations(self.one), fix="use names of fields")
            shape = jnp.shape(getattr(self.one, name))
            if shape[:1] != (self.count,):
                problem = f"has shape {shape}, but must have one value for each of the {self.count} craft"
                raise InputError(f"one.{name}", problem, fix=f"write an array with {self.count} values")

    def neutral(self) -> Any:
        """Return the neutral output of the actuators of each craft."""
        return jax.tree.map(lambda v: jnp.broadcast_to(v, (self.count, *jnp.shape(v))), self.one.neutral())

    def init(self, key: Key) -> Any:
        """Return the initial states of the copies of the part, one for each craft."""
        return self._of_each(lambda one, k: strengthen_types(one.init(k)), split(key, self.count))

    def measure(self, motion: Any) -> Any:
        """Return the measurement of each craft's sensor."""
        return self._of_each(lambda one, m: one.measure(m), motion)

    def step(self, t: Any, state: Any, given: Any) -> tuple[Any, Any]:
        """Return the new states and the outputs of the copies of the part.

        If the output is a sample or an estimate, its time is the same for all craft, and it is valid only if the
        outputs of all craft are valid.
        """
        new, out = self._of_each(lambda one, s, x: strengthen_types(one.step(t, s, x)), state, given)
        if isinstance(out, Sample | Estimate):
            same = {"t": out.t[0], "age": jnp.max(out.age), "fresh": jnp.any(out.fresh), "valid": jnp.all(out.valid)}
            out = replace(out, **same)
        return new, out

    def _of_each(self, call: Callable[..., Any], *given: Any) -> Any:
        """Return the results of call(part, inputs) for all craft.

        An array in the inputs is split along its first axis, so that each craft receives one element. A scalar is the
        same for every craft.
        """
        leaves, tree = jax.tree.flatten(({n: getattr(self.one, n) for n in self.own}, given))
        differs = [jnp.ndim(v) > 0 for v in leaves]

        def of_one(rows: list[Any]) -> Any:
            mine = iter(rows)
            own, row = jax.tree.unflatten(tree, [next(mine) if d else v for v, d in zip(leaves, differs, strict=True)])
            return call(replace(self.one, **own), *row)

        rows = [v for v, d in zip(leaves, differs, strict=True) if d]
        return jax.vmap(of_one, axis_size=self.count)(rows)


@record
class Swarm:
    """Swarm of n vehicles. Each vehicle moves as if it were alone.

    State and input have the fields of a single vehicle's state and input, with shape (n,).

    Frames: those of the vehicle. Not modelled: contact between craft, and the effect of a craft's air flow on other
    craft. Source: docs page, Swarms.
    """

    craft: Any = part("Model of one craft.")
    count: int = option("Number of craft.", default=3)

    def dynamics(self, t: Any, x: Any, u: SwarmInput) -> Any:
        """Return the derivative of the state x at time t (s)."""
        return jax.vmap(lambda x, u: self.craft.dynamics(t, x, u))(x, u.act)

    def motion(self, t: Any, x: Any, u: SwarmInput) -> SwarmMotion:
        """Return the motion of each craft, which the craft's sensors measure, at integer time t."""
        return SwarmMotion(each=jax.vmap(lambda x, u: self.craft.motion(t, x, u))(x, u.act), message=u.message)


@record
class SwarmOutput:
    """Output of the actuators of a swarm. Frames: those of the actuators. Source: docs page, Swarms."""

    u: SwarmInput = part("Input of the swarm.")
    each: Any = part("Other outputs of each craft's actuators.")


@record
class SwarmAllocation:
    """Allocation of each craft. Radio messages pass unchanged. Frames: the allocation's. Source: docs page, Swarms."""

    each: Each = part("Allocation of each craft.")

    def init(self, key: Key) -> Any:
        """Return the initial state of each craft's part."""
        return self.each.init(key)

    def step(self, t: Any, state: Any, demand: SwarmInput) -> tuple[Any, SwarmInput]:
        """Return the new states, and the commands that realise a demand."""
        state, act = self.each.step(t, state, demand.act)
        return state, SwarmInput(act=act, message=demand.message)


@record
class SwarmActuators:
    """Actuators of each craft.

    Before the first command no craft sends a message.

    Frames:  those of the actuators.
    Source:  docs page, Swarms.
    """

    each: Each = part("Actuators of each craft.")
    silence: Any = part("Empty message that is used before the first valid command, with fields of shape (n,).")

    @property
    def period(self) -> int:
        """Return the period of the actuators."""
        return self.each.period

    @property
    def frame(self) -> Any:
        """Return the period of the actuators' frames, or None if the actuators have no frames."""
        return self.each.frame

    def neutral(self) -> SwarmOutput:
        """Return the output with a neutral input and an empty message for every craft."""
        return SwarmOutput(u=SwarmInput(act=self.each.neutral().u, message=self.silence), each=())

    def init(self, key: Key) -> Any:
        """Return the initial state of each craft's part."""
        return self.each.init(key)

    def step(self, t: Any, state: Any, command: Sample) -> tuple[Any, SwarmOutput]:
        """Return the new states, and the output and message of each craft from integer time t on."""
        state, out = self.each.step(t, state, replace(command, value=command.value.act))
        message = tree_where(command.valid, command.value.message, self.silence)
        return state, SwarmOutput(u=SwarmInput(act=out.u, message=message), each=())
