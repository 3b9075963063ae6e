"""Swarm of n craft in one loop. Each craft has its own vehicle, sensors, law, allocation, actuators, state and key.

The parts are defined for one craft. `Each` steps n copies of a part by vmap: copy i gets only row i of the inputs. So a
craft can depend on others only through the messages that its radio has received (`loop.peer_radio`).
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

    Input arrays have the craft as first axis. A scalar input is the same for every craft. All copies have the
    parameters of `one`. Only the fields named in `own` differ, and have the craft as first axis.

    Frames: the part's. Source: docs page, Swarms.
    """

    one: Any = part("Part of which each craft has a copy.")
    count: int = option("Number of craft.", default=3)
    own: tuple[str, ...] = option("Names of the part's fields that differ from craft to craft.", default=())

    @property
    def period(self) -> int:
        """Return the part's period."""
        return self.one.period

    @property
    def reads(self) -> tuple[str, ...]:
        """Return the fields that the law reads."""
        return self.one.reads

    @property
    def stick(self) -> str:
        """Return the name of the stick that the law reads."""
        return optional_member(self.one, "stick")

    @property
    def frame(self) -> Any:
        """Return the period of the actuators' frames, or None."""
        return optional_member(self.one, "frame")

    def check(self) -> None:
        """Raise InputError unless each name in `own` is a field of the part that has a number for each craft."""
        for name in self.own:
            if name not in declarations(self.one):
                problem = f"{type(self.one).__name__} has no field {name!r}"
                raise InputError("Each.own", problem, choices=declarations(self.one), fix="use names of fields")
            shape = jnp.shape(getattr(self.one, name))
            if shape[:1] != (self.count,):
                problem = f"has shape {shape}, but there are {self.count} craft"
                raise InputError(f"one.{name}", problem, fix=f"give {self.count} numbers")

    def neutral(self) -> Any:
        """Return the neutral output of the actuators of each craft."""
        return jax.tree.map(lambda v: jnp.broadcast_to(v, (self.count, *jnp.shape(v))), self.one.neutral())

    def init(self, key: Key) -> Any:
        """Return the initial state of each craft's part."""
        return self._of_each(lambda one, k: strengthen_types(one.init(k)), split(key, self.count))

    def measure(self, motion: Any) -> Any:
        """Return the measurement of each craft's sensor."""
        return self._of_each(lambda one, m: one.measure(m), motion)

    def step(self, t: Any, state: Any, given: Any) -> tuple[Any, Any]:
        """Return state and output of each craft's part.

        A sample or an estimate has one time for all craft. It is valid only if it is valid for every craft.
        """
        new, out = self._of_each(lambda one, s, x: strengthen_types(one.step(t, s, x)), state, given)
        if isinstance(out, Sample | Estimate):
            same = {"t": out.t[0], "age": jnp.max(out.age), "fresh": jnp.any(out.fresh), "valid": jnp.all(out.valid)}
            out = replace(out, **same)
        return new, out

    def _of_each(self, call: Callable[..., Any], *given: Any) -> Any:
        """Return call(part, row) for each craft.

        Arrays in the inputs are split into rows. Scalars are the same for every craft.
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
    """Vehicles without contact, each of which moves as if it were alone.

    State and input are those of one vehicle, with fields of shape (n,) for n vehicles.

    Frames: the vehicle's. Not modelled: contact, the air flow of one craft at another. Source: docs page, Swarms.
    """

    craft: Any = part("Model of one craft.")
    count: int = option("Number of craft.", default=3)

    def dynamics(self, t: Any, x: Any, u: SwarmInput) -> Any:
        """Return the derivative of x at time t (s)."""
        return jax.vmap(lambda x, u: self.craft.dynamics(t, x, u))(x, u.act)

    def motion(self, t: Any, x: Any, u: SwarmInput) -> SwarmMotion:
        """Return the motion of each craft, for its sensors, at integer time t."""
        return SwarmMotion(each=jax.vmap(lambda x, u: self.craft.motion(t, x, u))(x, u.act), message=u.message)


@record
class SwarmOutput:
    """Output of the actuators of a swarm. Frames: those of the actuators. Source: docs page, Swarms."""

    u: SwarmInput = part("Input of the swarm.")
    each: Any = part("Output of each craft's actuators, without the vehicle's input.")


@record
class SwarmAllocation:
    """Allocation of each craft. Radio messages pass unchanged. Frames: the allocation's. Source: docs page, Swarms."""

    each: Each = part("Allocation of each craft.")

    def init(self, key: Key) -> Any:
        """Return the initial state of each craft."""
        return self.each.init(key)

    def step(self, t: Any, state: Any, demand: SwarmInput) -> tuple[Any, SwarmInput]:
        """Return the states and the commands for a demand."""
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
    silence: Any = part("Empty message used without a command; fields of shape (n,).")

    @property
    def period(self) -> int:
        """Return the period of the actuators."""
        return self.each.period

    @property
    def frame(self) -> Any:
        """Return the period of the actuators' frames, or None."""
        return self.each.frame

    def neutral(self) -> SwarmOutput:
        """Return the output with the neutral input and no message for every craft."""
        return SwarmOutput(u=SwarmInput(act=self.each.neutral().u, message=self.silence), each=())

    def init(self, key: Key) -> Any:
        """Return the initial state of each craft."""
        return self.each.init(key)

    def step(self, t: Any, state: Any, command: Sample) -> tuple[Any, SwarmOutput]:
        """Return the new states, and the output and message of each craft from integer time t on."""
        state, out = self.each.step(t, state, replace(command, value=command.value.act))
        message = tree_where(command.valid, command.value.message, self.silence)
        return state, SwarmOutput(u=SwarmInput(act=out.u, message=message), each=())
