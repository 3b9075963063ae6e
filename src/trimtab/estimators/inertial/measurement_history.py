"""Fusion of late measurements at the time at which they were measured: past filter states are stored and replayed.

A ring buffer contains the last events, sorted by the time of measurement: IMU samples, headings, positions and pings.
Each event is stored with the filter's state after it. A late measurement is inserted at its time, and all later states
are computed again. The result therefore equals that of a filter that received everything in time. An aiding measurement
that is newer than the newest IMU sample waits for the next IMU sample. Between two IMU samples, the IMU's reading is
interpolated linearly.

Without late measurements, each event is processed once. Nothing is approximated. The only limit is the length of the
ring buffer.

Source: docs page, Measurement history.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.interfaces import InertialForm
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.sensor_watch import NEVER

EMPTY, IMU, HEADING, POSITION, RANGES = range(5)
"""Kinds of events in the history; EMPTY marks an unused slot."""
KINDS = ("empty", "imu", "heading", "position", "ranges")
AIDING_KINDS = {"positions": POSITION, "ranges": RANGES}
"""Kind of the events from the position sensor, keyed by the type of aiding (AIDED_BY of an inertial filter)."""
IMU_NUMBERS = 3
"""Number of values in an IMU event: yaw rate and two specific forces."""
LONGEST = 0.1
"""Longest time (s) for which a velocity is integrated between two events, or after the last event."""
POSITION_NUMBERS = 5
"""Number of values in a position event: north, east (m), and its covariance, north, mixed, east (m^2)."""


@record
class History:
    """Ring buffer of recent events and filter states. The first axis of every array is that of the slots.

    Source: docs page, Measurement history.
    """

    head: Scalar = quantity("1", "Slot of the oldest event in the ring buffer.", kind="count")
    t: Any = quantity(
        "100 ns", "Measurement time of each event; never decreases from the oldest event to the newest.", kind="time"
    )
    kind: Any = quantity("1", "Kind of each event: IMU sample, heading, position or ranges.", kind="mode", modes=KINDS)
    value: Any = quantity("1", "Measured values of each event, in the sensor's units.")
    untrusted: Any = quantity(
        "1", "Flags of gyro and accelerometers (slots, 2): 1 if the IMU sample cannot be trusted."
    )
    nodes: Any = part("State of the filter after each event, with fields t, imu_reading and untrusted.")


class Event(NamedTuple):
    """Measurement of one sensor at one instant.

    t: integer time.  kind: kind of event.  value: at most as many numbers as the history stores.  untrusted: flags of
    gyro and accelerometers (2,), 1 if not trusted.
    """

    t: Any
    kind: int
    value: Any
    untrusted: Any


def empty_history(node: Any, slots: int, width: int = POSITION_NUMBERS) -> History:
    """Return a history without events.

    node: filter state before the first event, with t = NEVER.  width: largest number of values in an event.
    """
    return History(
        head=np.int32(0),
        t=np.full(slots, NEVER, np.int64),
        kind=np.zeros(slots, np.int32),
        value=np.zeros((slots, width)),
        untrusted=np.zeros((slots, 2)),
        nodes=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (slots, *np.shape(leaf))), node),
    )


def newest_imu_index(h: History) -> Any:
    """Return the index, counted from the oldest event, of the newest IMU sample; the last index if no IMU sample is
    stored."""
    last = np.int32(h.t.shape[0] - 1)
    i = lax.while_loop(lambda i: (i >= 0) & (_read_slot(h.kind, _slot_index(h, i)) != IMU), lambda i: i - 1, last)
    return jnp.where(i < 0, last, i)


def check_room(h: History, reached: Any, event: Event) -> tuple[Any, Any]:
    """Return two flags: True if an event fits into the history, and True if the history already contains it.

    An event does not fit if it is older than the whole history, because no earlier filter state is stored. One slot is
    reserved for the IMU.  reached: index up to which the stored states are valid.
    """
    before = _last_index(h, event.t)

    def other(i: Any) -> Any:
        slot = _slot_index(h, i)
        return (i >= 0) & (_read_slot(h.t, slot) == event.t) & (_read_slot(h.kind, slot) != event.kind)

    same = lax.while_loop(other, lambda i: i - 1, before)
    known = (same >= 0) & (_read_slot(h.t, _slot_index(h, same)) == event.t)
    if event.kind == IMU:
        return reached >= 1, known
    return (before >= 1) & (_read_slot(h.t, _slot_index(h, before)) > NEVER) & (reached >= 2), known


def insert_event(h: History, reached: Any, event: Event) -> tuple[History, Any]:
    """Return the history with an event added and the oldest removed, and the index up to which its states stay valid.

    Events of the same instant are sorted by arrival, with the IMU sample first. Newer events move up by one slot, so
    that inserting the newest event moves nothing.
    """
    place = _last_index(h, event.t - 1 if event.kind == IMU else event.t)
    h = replace(h, head=_wrap_index(h.head + 1, h.t.shape[0]))

    def up(carry: Any) -> Any:
        i, rings = carry
        return i - 1, _write_slot(rings, _slot_index(h, i), _read_slot(rings, _slot_index(h, i - 1)))

    rings = {"t": h.t, "kind": h.kind, "value": h.value, "untrusted": h.untrusted}
    last = np.int32(h.t.shape[0] - 1)
    _, rings = lax.while_loop(lambda carry: carry[0] > place, up, (last, rings))
    new = event._asdict()
    short = h.value.shape[1] - np.shape(event.value)[0]
    if short:
        new["value"] = jnp.concatenate([event.value, jnp.zeros(short)])
    rings = _write_slot(rings, _slot_index(h, place), new)
    return replace(h, **rings), jnp.minimum(reached - 1, place - 1)


def enter_event(h: History, reached: Any, event: Event) -> tuple[History, Any, Any, Any]:
    """Insert an event if it fits and is not repeated.

    Returns: history, index up to which its states are valid, True if the event was too late, True if it was repeated.
    """
    room, known = check_room(h, reached, event)
    enters = room & ~known
    new, now = lax.cond(enters, lambda: insert_event(h, reached, event), lambda: (h, reached))
    return new, now, ~room & ~known, known


def replay_events(form: InertialForm, h: History, reached: Any) -> tuple[History, Any]:
    """Compute all filter states after index `reached` up to the newest IMU sample.

    Returns: the history and the newest state.
    """
    last = newest_imu_index(h)

    def body(carry: Any) -> Any:
        i, nodes, node = carry
        node = _process_event(form, h, node, i, last)
        return i + 1, _write_slot(nodes, _slot_index(h, i), node), node

    start = reached + 1, h.nodes, _read_slot(h.nodes, _slot_index(h, reached))
    _, nodes, node = lax.while_loop(lambda carry: carry[0] <= last, body, start)
    return replace(h, nodes=nodes), node


def newest_node(h: History) -> Any:
    """Return the filter's state after the newest IMU sample."""
    return _read_slot(h.nodes, _slot_index(h, newest_imu_index(h)))


def node_before(h: History, t: Any) -> Any:
    """Return the filter's state after the last event measured at or before integer time t, or after the oldest event if
    all are later."""
    return _read_slot(h.nodes, _slot_index(h, jnp.maximum(jnp.minimum(_last_index(h, t), newest_imu_index(h)), 0)))


def inertial_increment(form: InertialForm, h: History, start: Any, end: Any) -> tuple[Any, Any]:
    """Return the IMU's displacement (2,) (m, W) and turn (rad) between two integer times within the history.

    Velocities and yaw rates of the stored states are integrated, so that a jump of the estimated position at a fix does
    not count as motion. Nothing is added before the first state, or later than LONGEST after the last.
    """
    first, last = jnp.maximum(_last_index(h, start), 0), jnp.minimum(_last_index(h, end), newest_imu_index(h))

    def motion(i: Any) -> tuple[Any, Any]:
        node = _read_slot(h.nodes, _slot_index(h, i))
        x = form.belief(node).x
        return node.t, jnp.stack([x[1], x[2], node.imu_reading[0] - x[5]])

    def add(carry: Any) -> Any:
        i, (t, rate), total = carry
        after, following = motion(jnp.minimum(i + 1, last))
        begin, finish = jnp.maximum(t, start), jnp.where(i < last, jnp.minimum(after, end), end)
        span = (after - t).astype(np.float64)
        share = ((begin - t) + (finish - t)).astype(np.float64) / (2 * jnp.where(span > 0, span, 1.0))
        mean = rate + jnp.where(span > 0, share, 0.0) * (following - rate)
        seconds = jnp.clip(to_seconds(finish - begin), 0.0, LONGEST)
        known = (t > NEVER) & (finish > begin)
        return i + 1, (after, following), total + jnp.where(known, seconds * mean, 0.0)

    begun = (first, motion(first), jnp.zeros(3))
    total = lax.while_loop(lambda carry: carry[0] <= last, add, begun)[2]
    return total[:2], total[2]


def _process_event(form: Any, h: History, node: Any, i: Any, last: Any) -> Any:
    """Return the filter's state after event i, from the state after the previous event.

    last: index of the newest IMU sample.
    """
    t, kind, value = (_read_slot(x, _slot_index(h, i)) for x in (h.t, h.kind, h.value))
    # index of the IMU sample at or after this event; the bound `last` ends the loop under vmap
    j = lax.while_loop(lambda j: (j < last) & (_read_slot(h.kind, _slot_index(h, j)) != IMU), lambda j: j + 1, i)
    ahead, imu_reading, untrusted = (_read_slot(x, _slot_index(h, j)) for x in (h.t, h.value, h.untrusted))
    imu_reading = imu_reading[:IMU_NUMBERS]
    span = (ahead - node.t).astype(np.float64)
    share = jnp.where(ahead > node.t, (t - node.t).astype(np.float64) / jnp.where(span > 0, span, 1.0), 1.0)
    dt = jnp.where(node.t > NEVER, to_seconds(t - node.t), 0.0)
    is_imu = kind == IMU
    now = jnp.where(is_imu, imu_reading, node.imu_reading + share * (imu_reading - node.imu_reading))
    doubts = jnp.maximum(node.untrusted, untrusted)
    # no propagation between events of the same instant: most headings and fixes arrive with an IMU sample
    propagated = lax.cond(t > node.t, lambda: form.propagate(node, dt, now, doubts), lambda: node)
    new = replace(propagated, t=t, untrusted=jnp.where(is_imu, untrusted, node.untrusted))
    if form.intake.heading:
        new = lax.cond(kind == HEADING, lambda: form.correct_heading(new, value[0], value[1]), lambda: new)
    if form.intake.position and form.AIDED_BY == "ranges":
        return lax.cond(kind == RANGES, lambda: form.correct_ranges(new, value), lambda: new)
    if form.intake.position:
        R = jnp.stack([value[2:4], value[3:5]])
        return lax.cond(kind == POSITION, lambda: form.correct_position(new, value[:2], R), lambda: new)
    return new


def _last_index(h: History, t: Any) -> Any:
    """Return the index, counted from the oldest event, of the last event measured at or before t; -1 if none."""
    i = np.int32(h.t.shape[0] - 1)
    return lax.while_loop(lambda i: (i >= 0) & (_read_slot(h.t, _slot_index(h, i)) > t), lambda i: i - 1, i)


def _slot_index(h: History, i: Any) -> Any:
    """Return the slot of event i in the ring buffer; i is counted from the oldest event."""
    return _wrap_index(h.head + i, h.t.shape[0])


def _wrap_index(i: Any, n: int) -> Any:
    """Return an index from [-n, 2 n) wrapped to [0, n)."""
    return jnp.where(i >= n, i - n, jnp.where(i < 0, i + n, i)).astype(np.int32)


def _read_slot(ring: Any, slot: Any) -> Any:
    return jax.tree.map(lambda leaf: lax.dynamic_index_in_dim(leaf, slot, keepdims=False), ring)


def _write_slot(ring: Any, slot: Any, value: Any) -> Any:
    def one(leaf: Any, new: Any) -> Any:
        return lax.dynamic_update_index_in_dim(leaf, jnp.asarray(new, leaf.dtype), slot, 0)

    return jax.tree.map(one, ring, value)
