"""Radio between the craft of a swarm: one channel that the craft share in time slots, with delay and losses."""

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
    """State of a swarm's radio: messages in transit and received messages.

    Frames:  those of the messages.
    Source:  docs page, Swarms.
    """

    key: Any = part("Random key of the message losses.")
    in_transit: Any = part("Ring buffer of the messages in transit, with fields of shape (delay,).")
    received: Any = part("Newest message of each sender at each receiver, with fields of shape (receiver, sender).")


@record
class PeerRadio:
    """One radio channel for all n craft. In each time slot, one craft sends a message to all others.

        In slot k, craft k mod n sends. Each other craft receives the message `delay` slots later, unless it is lost.

    A craft without a message leaves its slot empty. Losses are drawn independently for each receiver and slot. Each
    craft sends once in n slots, i.e. less often if there are more craft. Each receiver stores the newest message of
    each sender. A message contains the time at which its content was valid.

    Frames: those of the messages. Not modelled: collisions (slots are assumed longer than the differences of the
    clocks), jitter, bursts of loss. Source: docs page, Swarms.
    """

    count: int = option("Number of craft.", default=3)
    slot: int = period("Length of a time slot.", default=ms(5))
    delay: int = option(
        "Delay from sending to reception, in slots. 0: a message is received in the slot in which it is sent.",
        default=4,
        off={"peer-delay": 0},
    )
    loss: Scalar = imperfection("1", "Probability that a receiver does not receive a message.", "peer-loss", high=1)

    def init(self, key: Key) -> PeerRadioState:
        """Return the initial state of the radio, with no message received."""
        silence = strengthen_types(PeerMessage())
        received = jax.tree.map(lambda v: jnp.full((self.count, self.count), v, v.dtype), silence)
        return PeerRadioState(key=key, in_transit=empty_slots(silence, self.delay), received=received)

    def step(self, t: Any, state: PeerRadioState, messages: PeerMessage) -> tuple[PeerRadioState, Peers]:
        """Return the radio's state, and the newest message of each sender at each receiver, at integer time t.

        t: start of a slot.  messages: present message of each craft. The fields of the result have shape (receiver,
        sender).
        """
        number = t // self.slot
        sender = (number - self.delay) % self.count
        message = jax.tree.map(lambda v: v[number % self.count], messages)
        ring = state.in_transit
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

        received = jax.tree.map(write, state.received, arrived)
        return PeerRadioState(key=state.key, in_transit=ring, received=received), _peers(received)


def _peers(received: PeerMessage) -> Peers:
    return Peers(messages=tuple(jax.tree.leaves(received)))


@record
class SwarmNavigation:
    """Sensor of a swarm: navigation of each craft, and messages received by each craft. One sample per time slot.

    Frames: those of navigation and messages. Source: docs page, Swarms.
    """

    each: Any = part("Navigation of each craft.")
    radio: PeerRadio = part("Radio between the craft.")

    @property
    def period(self) -> int:
        """Return the period of the sensor: the length of a slot of the radio."""
        return self.radio.slot

    def init(self, key: Key) -> tuple[Any, PeerRadioState]:
        """Return the initial state, with no measurement and no received message."""
        return self.each.init(key.at("each")), self.radio.init(key.at("radio"))

    def step(self, t: Any, state: tuple[Any, Any], motion: SwarmMotion) -> tuple[tuple[Any, Any], Sample]:
        """Return the state and the sample at integer time t."""
        own, sample = self.each.step(t, state[0], motion.each)
        radio, peers = self.radio.step(t, state[1], motion.message)
        return (own, radio), Sample(PeerView(sample.value, peers), sample.t, sample.age, sample.fresh, sample.valid)


@record
class PerfectSwarmNavigation:
    """Navigation of a swarm without noise, delay or loss. Frames: W and B. Source: docs page, Swarms."""

    each: Any = part("Navigation of each craft, without error.")
    period: int = period("Time between samples.", default=ms(20))

    def init(self, key: Key) -> Any:
        """Return the initial state of the navigation."""
        return self.each.init(key)

    def step(self, t: Any, state: Any, motion: SwarmMotion) -> tuple[Any, Sample]:
        """Return the state and the sample at integer time t. Each craft receives all messages, without delay or
        loss."""
        state, sample = self.each.step(t, state, motion.each)
        count = motion.message.north.shape[0]
        table = jax.tree.map(lambda v: jnp.broadcast_to(v, (count, count)), motion.message)
        return state, new_sample(t, PeerView(sample.value, _peers(table)))


@record
class ArenaReading:
    """Distances measured by a swarm's observer. Frames: W. Source: docs page, Swarms."""

    spacing: Scalar = quantity("m", "Smallest distance between the centres of mass of any two craft.")
    formation_error: Scalar = quantity("m", "Largest distance of any craft from its desired position in the formation.")


@record
class Arena:
    """Observer of a swarm, which measures the true positions of all craft. No autopilot reads its samples.

    Frames: W. Source: docs page, Swarms.
    """

    north: Any = quantity("m", "Desired position of each craft (n,) relative to craft 0: north component.", frame="W")
    east: Any = quantity("m", "Desired position of each craft (n,) relative to craft 0: east component.", frame="W")
    period: int = period("Time between samples of the observer.", default=ms(20))

    OBSERVES: ClassVar[bool] = True

    def init(self, key: Key) -> tuple[()]:
        """Return an empty state."""
        return ()

    def measure(self, motion: SwarmMotion) -> ArenaReading:
        """Return the distances that the observer measures for a given motion of the swarm."""
        north, east = motion.each.p_WB[:, 0], motion.each.p_WB[:, 1]
        apart = (north[:, None] - north) ** 2 + (east[:, None] - east) ** 2
        same = np.eye(len(north), dtype=bool)
        off = (north - north[0] - self.north) ** 2 + (east - east[0] - self.east) ** 2
        return ArenaReading(
            spacing=jnp.sqrt(jnp.min(jnp.where(same, np.inf, apart))), formation_error=jnp.sqrt(jnp.max(off))
        )

    def step(self, t: Any, state: tuple[()], motion: SwarmMotion) -> tuple[tuple[()], Sample]:
        """Return the state and the sample at integer time t."""
        return state, new_sample(t, self.measure(motion))
