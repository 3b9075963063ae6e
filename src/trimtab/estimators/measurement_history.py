"""Measurements fused at the time they were taken, however late they come: past states are kept, and replayed.

A ring holds the last events in the order in which they were measured: samples of the IMU, headings, positions, each
with the filter's state after it. A late measurement is put where it belongs, and everything from there on is computed
again, so the result is that of a filter which had got all in time. An aiding measurement newer than the newest IMU
sample waits for the next one; between two samples the IMU is taken as running straight.

Without a late measurement there is one turn of the loop for each event. Nothing is approximated, and the only limit is
the ring's length.

Source: docs page, Measurement history.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax

from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import FOREVER, to_seconds
from trimtab.estimators.sensor_watch import NEVER, WIDTH

EMPTY, IMU, HEADING, POSITION = range(4)
"""Kinds of event."""
KINDS = ("empty", "imu", "heading", "position")


@record
class History:
    """The ring; every leaf has a leading axis of slots, the oldest at `head`. Source: docs page."""

    head: Scalar = quantity("1", "Slot of the oldest event.", kind="count")
    t: Any = quantity("100 ns", "When each event was measured; never falls from the oldest on.", kind="time")
    kind: Any = quantity("1", "What it is.", kind="mode", modes=KINDS)
    value: Any = quantity("1", "What was measured, in the sensor's units.")
    doubt: Any = quantity("1", "1 where the gyro, or the accelerometers, of this sample can't be trusted; (slots, 2).")
    nodes: Any = part("State of the filter after each event; its fields t, felt and doubt are used here.")


class Event(NamedTuple):
    """One measurement: integer time, kind, value (3,), doubt (2,)."""

    t: Any
    kind: int
    value: Any
    doubt: Any


def empty(node: Any, slots: int) -> History:
    """A ring without events; node: state of the filter before any, with t = NEVER."""
    return History(
        head=np.int32(0),
        t=np.full(slots, NEVER, np.int64),
        kind=np.zeros(slots, np.int32),
        value=np.zeros((slots, WIDTH)),
        doubt=np.zeros((slots, 2)),
        nodes=jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * slots), node),
    )


def done(h: History) -> Any:
    """How far the filter has come: which event, from the oldest, is the newest of the IMU; the last where none is."""
    n = h.t.shape[0]
    order = _wrapped(jnp.arange(n, dtype=np.int32) - h.head, n)
    newest = jnp.max(jnp.where(h.kind == IMU, order, -1))
    return jnp.where(newest < 0, n - 1, newest).astype(np.int32)


def fits(h: History, reached: Any, event: Event) -> tuple[Any, Any]:
    """Whether an event can be put into the ring, and whether it is there already; reached: as `done` gives it.

    What was measured before all that is remembered has no state to start from. One slot is kept for the IMU.
    """
    before = h.t <= event.t
    known = jnp.any((h.t == event.t) & (h.kind == event.kind))
    if event.kind == IMU:
        return reached >= 1, known
    base = jnp.max(jnp.where(before, h.t, NEVER))
    return (jnp.sum(before) >= 2) & (base > NEVER) & (reached >= 2), known


def insert(h: History, reached: Any, event: Event) -> tuple[History, Any]:
    """The ring with one event more and the oldest dropped, and how far the filter's states still hold.

    Events of one instant are ordered as they came, the IMU's first.
    """
    n = h.t.shape[0]
    before = h.t < event.t if event.kind == IMU else h.t <= event.t
    place = (jnp.sum(before) - 1).astype(np.int32)
    head = _wrapped(h.head + 1, n)
    order = _wrapped(jnp.arange(n, dtype=np.int32) - head, n)

    def put(ring: Any, new: Any) -> Any:
        shape = (n,) + (1,) * (ring.ndim - 1)
        at, after = (order == place).reshape(shape), (order > place).reshape(shape)
        moved = jnp.concatenate([ring[-1:], ring[:-1]])
        return jnp.where(after, moved, jnp.where(at, jnp.asarray(new, ring.dtype), ring))

    changed = {name: put(getattr(h, name), getattr(event, name)) for name in ("t", "kind", "value", "doubt")}
    return replace(h, head=head, **changed), jnp.minimum(reached - 1, place - 1)


def replay(form: Any, h: History, reached: Any) -> tuple[History, Any]:
    """The ring with every state after the first `reached` computed up to the newest IMU sample, and that state.

    form: gives propagate(node, dt, felt, doubt), correct_heading(node, z, variance) and correct_position.
    """
    n, last = h.t.shape[0], done(h)

    def body(carry: Any) -> Any:
        i, nodes, node = carry
        slot = _wrapped(h.head + i, n)
        node = _processed(form, h, node, slot)
        return i + 1, _put(nodes, slot, node), node

    start = reached + 1, h.nodes, _take(h.nodes, _wrapped(h.head + reached, n))
    _, nodes, node = lax.while_loop(lambda carry: carry[0] <= last, body, start)
    return replace(h, nodes=nodes), node


def newest(h: History) -> Any:
    """The filter's state after the newest IMU sample."""
    return _take(h.nodes, _wrapped(h.head + done(h), h.t.shape[0]))


def state_before(h: History, t: Any) -> Any:
    """The filter's state after the last event measured at integer time t or before; the oldest where all are later."""
    n = h.t.shape[0]
    last = jnp.minimum(jnp.sum(h.t <= t) - 1, done(h))
    return _take(h.nodes, _wrapped(h.head + jnp.maximum(last, 0).astype(np.int32), n))


def _processed(form: Any, h: History, node: Any, slot: Any) -> Any:
    """The state after the event in a slot, from that after the event before it."""
    t, kind, value = (_take(x, slot) for x in (h.t, h.kind, h.value))
    imu = h.kind == IMU
    ahead = jnp.min(jnp.where(imu & (h.t >= t), h.t, FOREVER))  # the IMU sample at or after this event
    there = (imu & (h.t == ahead))[:, None]
    felt, doubt = (jnp.sum(jnp.where(there, x, 0.0), axis=0) for x in (h.value, h.doubt))
    span = (ahead - node.t).astype(np.float64)
    share = jnp.where(ahead > node.t, (t - node.t).astype(np.float64) / jnp.where(span > 0, span, 1.0), 1.0)
    dt = jnp.where(node.t > NEVER, to_seconds(t - node.t), 0.0)
    is_imu = kind == IMU
    now = jnp.where(is_imu, felt, node.felt + share * (felt - node.felt))
    moved = form.propagate(node, dt, now, jnp.maximum(node.doubt, doubt))
    moved = replace(moved, t=t, doubt=jnp.where(is_imu, doubt, node.doubt))
    if form.intake.heading:
        moved = lax.cond(kind == HEADING, lambda: form.correct_heading(moved, value[0], value[1]), lambda: moved)
    if form.intake.position:
        moved = lax.cond(kind == POSITION, lambda: form.correct_position(moved, value[:2], value[2]), lambda: moved)
    return moved


def _wrapped(i: Any, n: int) -> Any:
    """An index in [-n, 2 n) brought into [0, n)."""
    return jnp.where(i >= n, i - n, jnp.where(i < 0, i + n, i)).astype(np.int32)


def _take(ring: Any, slot: Any) -> Any:
    return jax.tree.map(lambda leaf: lax.dynamic_index_in_dim(leaf, slot, keepdims=False), ring)


def _put(ring: Any, slot: Any, value: Any) -> Any:
    def one(leaf: Any, new: Any) -> Any:
        return lax.dynamic_update_index_in_dim(leaf, jnp.asarray(new, leaf.dtype), slot, 0)

    return jax.tree.map(one, ring, value)
