"""One shared radio channel: beacons listen before they send, wait at random, and sometimes collide.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record
from trimtab.core.rng import Key, uniform2

FIRST, AGAIN = 100, 101
"""Identifiers of two random streams: one for the first wait of a station, one for the station's later waits."""
ATTEMPTS = 256
"""Maximum number of random draws in one exchange, so that different exchanges use different random numbers."""


@record
class CarrierSense:
    """Rules by which the stations share the channel.

    A station waits a whole number of byte times, uniform from 1 to `longest_wait`, then looks for a carrier. If the
    channel is busy, it waits again for a newly drawn time. If the channel is free, it sends. No station detects a
    message that began less than `blind_time` ago. Two stations that begin within this time collide, and both messages
    are lost.

    Source:  [1] section 5.5.1 for the waits; byte time (19.2 kb/s, 8 bits), length of a message and blind time are
             reconstructed, see docs Errata.
    """

    byte_time: Scalar = quantity("s", "Time to send one byte.", default=1 / 2400, above=0)
    message_bytes: Scalar = quantity("1", "Length of a message in bytes.", default=24.0, above=0)
    longest_wait: Scalar = quantity(
        "1", "Longest random wait of a station, in byte times.", default=64.0, low=1, source="[1] section 5.5.1"
    )
    blind_time: Scalar = quantity(
        "s", "Time after the start of a message during which no other station detects it.", default=0.9 / 2400, low=0
    )
    attempts: int = option(
        "Number of random draws simulated in one exchange, over all stations; at most 256.", default=48
    )


@record
class Exchange:
    """Result of one exchange for each station. Source: this module."""

    received: Scalar = quantity("1", "True if the station's message arrived complete and in time.", kind="flag")
    end: Scalar = quantity("s", "Time at which the station's message ended; 0 if it sent no message.")
    collided: Scalar = quantity("1", "True if the station's message collided with another message.", kind="flag")


def simulate_exchange(sense: CarrierSense, key: Key, number: Any, ready: Any, speaks: Any, window: Any) -> Exchange:
    """Simulate one exchange, in which stations reply over one shared channel.

    Args:     number: number of the exchange, an integer. Each number gives different random draws.
              ready: time at which each station starts to wait (s), shape (n,).    speaks: True for each station that
              has a message (n,). window: time at which the exchange ends (s). Messages that have not ended by then are
              lost.
    Returns:  an Exchange, fields of shape (n,).
    """
    n = ready.shape[0]
    base = jnp.asarray(number) * ATTEMPTS
    first = jax.lax.map(lambda i: uniform2(key, base + i, FIRST)[0], jnp.arange(n))
    message = sense.message_bytes * sense.byte_time

    def attempt(k: Any, carry: Any) -> Any:
        when, waiting, busy, end, hit, collided = carry
        turn = jnp.where(waiting, when, jnp.inf)
        now = jnp.min(turn)
        own = jnp.arange(n) == jnp.argmin(turn)
        again, _ = uniform2(key, base + k, AGAIN)
        blocked = now < busy
        together = waiting & (when <= now + sense.blind_time) & ~blocked
        alone = jnp.sum(together) == 1
        over = when + message
        when = jnp.where(own & waiting & blocked, now + random_wait(sense, again), when)
        return (
            when,
            waiting & ~together,
            jnp.where(blocked, busy, jnp.max(jnp.where(together, over, busy))),
            jnp.where(together, over, end),
            hit | (together & alone & (over <= window)),
            collided | (together & ~alone),
        )

    no = jnp.zeros(n, np.bool_)
    start = (ready + random_wait(sense, first), jnp.asarray(speaks), jnp.asarray(-1.0), jnp.zeros(n), no, no)
    _, _, _, end, hit, collided = jax.lax.fori_loop(0, sense.attempts, attempt, start)
    return Exchange(received=hit, end=end, collided=collided)


def random_wait(sense: CarrierSense, u: Any) -> Any:
    """Return the random wait (s) of a station for a uniform random number u in (0, 1)."""
    return (1.0 + jnp.floor(u * sense.longest_wait)) * sense.byte_time
