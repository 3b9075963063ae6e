"""The radio between the craft of a swarm: one channel, shared by time slots; late, and lossy pair by pair."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, imperfection, option, part, period, quantity, record
from trimtab.core.rng import Key, uniform2
from trimtab.core.signals import PeerMessage, Peers, PeerView, Sample, SwarmMotion, new_sample
from trimtab.core.time import NEVER, ms
from trimtab.links.fifo import empty_slots, read_slot, write_slot
from trimtab.loop.structure import strengthen_types


@record
class PeerRadioState:
    """What is on its way, and what has been heard. Frames: those of the messages. Source: docs page, Swarms."""

    key: Any = part("Of the losses.")
    on_the_way: Any = part("Messages, fields (delay,), by slot.")
    heard: Any = part("Newest message of each sender at each receiver, fields (receiver, sender).")


@record
class PeerRadio:
    """One channel for all: time is cut into slots, in each of which one craft speaks to all others, by turns.

        slot k: craft k mod n says what it has to say;   heard by each other one `delay` slots later, if not lost

    A craft that has nothing to say yet leaves its slot empty. Losses are drawn for each receiver and slot, alone.
    A craft is heard once a round, n slots: with more craft, more rarely. Each receiver holds the newest message of each
    sender; the time at which that was true is in it.

    Frames: those of the messages. Not modelled: collisions (the slots keep the clocks' differences apart), jitter,
    bursts of loss. Source: docs page, Swarms.
    """

    count: int = option("How many craft.", default=3)
    slot: int = period("Length of a slot.", default=ms(5))
    delay: int = option("Slots from speaking to hearing; 0: at once.", default=4, off={"peer-delay": 0})
    loss: Scalar = imperfection("1", "Probability that a receiver misses a message.", "peer-loss", high=1)

    def init(self, key: Key) -> PeerRadioState:
        """Nothing heard."""
        silence = strengthen_types(PeerMessage())
        heard = jax.tree.map(lambda v: jnp.full((self.count, self.count), v, v.dtype), silence)
        return PeerRadioState(key=key, on_the_way=empty_slots(silence, self.delay), heard=heard)

    def step(self, t: Any, state: PeerRadioState, say: PeerMessage) -> tuple[PeerRadioState, Peers]:
        """What each craft has heard by integer time t, the begin of a slot; arrays (receiver, sender)."""
        number = t // self.slot
        sender = (number - self.delay) % self.count
        message = jax.tree.map(lambda v: v[number % self.count], say)
        ring = state.on_the_way
        if self.delay:
            place = number % self.delay
            arrived, ring = read_slot(ring, place), write_slot(ring, place, message)
            some = number >= self.delay
        else:
            arrived, some = message, True
        receivers = jnp.arange(self.count)
        u, _ = uniform2(state.key, (number - self.delay) * self.count + receivers)
        hears = some & (arrived.t != NEVER) & (u >= self.loss) & (receivers != sender)

        def write(table: Any, value: Any) -> Any:
            return table.at[:, sender].set(jnp.where(hears, value, table[:, sender]))

        heard = jax.tree.map(write, state.heard, arrived)
        return PeerRadioState(key=state.key, on_the_way=ring, heard=heard), _peers(heard)


def _peers(heard: PeerMessage) -> Peers:
    return Peers(messages=tuple(jax.tree.leaves(heard)))


@record
class SwarmNavigation:
    """What each craft of a swarm knows: its own navigation, and what its radio has heard. Looks once a slot.

    Frames: those of the two. Source: docs page, Swarms.
    """

    each: Any = part("Navigation of each craft.")
    radio: PeerRadio = part("Between them.")

    @property
    def period(self) -> int:
        """A slot of the radio."""
        return self.radio.slot

    def init(self, key: Key) -> tuple[Any, PeerRadioState]:
        """Nothing measured, nothing heard."""
        return self.each.init(key.at("each")), self.radio.init(key.at("radio"))

    def step(self, t: Any, state: tuple[Any, Any], motion: SwarmMotion) -> tuple[tuple[Any, Any], Sample]:
        """The sample at integer time t."""
        own, sample = self.each.step(t, state[0], motion.each)
        radio, peers = self.radio.step(t, state[1], motion.say)
        return (own, radio), Sample(PeerView(sample.value, peers), sample.t, sample.age, sample.fresh, sample.valid)


@record
class PerfectSwarmNavigation:
    """What each craft would know if nothing were noisy, late or lost. Frames: W and B. Source: docs page, Swarms."""

    each: Any = part("Navigation of each craft, without error.")
    period: int = period("Time between samples.", default=ms(20))

    def init(self, key: Key) -> Any:
        """That of the navigation."""
        return self.each.init(key)

    def step(self, t: Any, state: Any, motion: SwarmMotion) -> tuple[Any, Sample]:
        """The sample at integer time t: every message has reached everybody."""
        state, sample = self.each.step(t, state, motion.each)
        count = motion.say.north.shape[0]
        table = jax.tree.map(lambda v: jnp.broadcast_to(v, (count, count)), motion.say)
        return state, new_sample(t, PeerView(sample.value, _peers(table)))


@record
class ArenaReading:
    """What an observer sees of a swarm. Frames: W. Source: docs page, Swarms."""

    spacing: Scalar = quantity("m", "Least distance between two craft, of their centres of mass.")
    astray: Scalar = quantity("m", "Largest distance of a craft from its place beside craft 0.")


@record
class Arena:
    """The observer of a swarm: sees where all craft really are; no autopilot listens to it.

    Frames: W. Source: docs page, Swarms.
    """

    north: Any = quantity("m", "Place of each craft beside craft 0, (n,).", frame="W")
    east: Any = quantity("m", "Place of each craft beside craft 0, (n,).", frame="W")
    period: int = period("Time between looks.", default=ms(20))

    OBSERVES: ClassVar[bool] = True

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, motion: SwarmMotion) -> ArenaReading:
        """Distances of a motion."""
        north, east = motion.each.p_WB[:, 0], motion.each.p_WB[:, 1]
        apart = (north[:, None] - north) ** 2 + (east[:, None] - east) ** 2
        same = np.eye(len(north), dtype=bool)
        off = (north - north[0] - self.north) ** 2 + (east - east[0] - self.east) ** 2
        return ArenaReading(spacing=jnp.sqrt(jnp.min(jnp.where(same, np.inf, apart))), astray=jnp.sqrt(jnp.max(off)))

    def step(self, t: Any, state: tuple[()], motion: SwarmMotion) -> tuple[tuple[()], Sample]:
        """The sample at integer time t."""
        return state, new_sample(t, self.measure(motion))
