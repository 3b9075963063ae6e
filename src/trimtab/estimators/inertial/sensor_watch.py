"""Is this sample fit for use? What is frozen, repeated or from the wrong time, told from the samples alone.

Source: docs page, Sensor watch.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Sample
from trimtab.core.time import FOREVER

NEVER = -FOREVER
"""Before any instant."""
WIDTH = 3
"""Numbers in a watched value unless it is wider; shorter ones are filled up with zeros."""


@record
class SensorWatch:
    """What one sensor has done so far. Source: docs page, Sensor watch."""

    last: Scalar = quantity("100 ns", "When its newest sample so far was measured.", kind="time")
    value: Any = quantity("1", "Its last sample, in the sensor's units, filled up with zeros.")
    repeats: Scalar = quantity("1", "How many samples in a row had exactly the same value.", kind="count")
    frozen: Scalar = quantity("1", "Whether that is more than noise allows: not used, or distrusted.", kind="flag")
    saturated: Scalar = quantity("1", "Whether the last sample lay at the end of its range.", kind="flag")
    backwards: Scalar = quantity("1", "Whether the last to arrive was older than one before it.", kind="flag")
    samples: Scalar = quantity("1", "How many have arrived.", kind="count")
    invalid: Scalar = quantity("1", "How many of these were not finite, or from the future: not used.", kind="count")
    duplicates: Scalar = quantity("1", "How many had been here before: not used.", kind="count")
    disordered: Scalar = quantity("1", "How many came after a newer one.", kind="count")
    late: Scalar = quantity("1", "How many were older than all that is remembered: not used.", kind="count")


class SampleValidation(NamedTuple):
    """What was found: the watch as it now stands; usable; value, finite and as wide as the watch; t, when measured."""

    watch: SensorWatch
    usable: Any
    value: Any
    t: Any


def initial_watch(width: int = WIDTH) -> SensorWatch:
    """Before the first sample; width: of its values."""
    none, no = np.int32(0), np.bool_(False)
    return SensorWatch(
        last=np.int64(NEVER),
        value=np.zeros(width),
        repeats=none,
        frozen=no,
        saturated=no,
        backwards=no,
        samples=none,
        invalid=none,
        duplicates=none,
        disordered=none,
        late=none,
    )


def validate_sample(
    watch: SensorWatch, now: Any, sample: Sample, numbers: tuple[Any, ...], *, frozen_after: Any, ordered: bool
) -> SampleValidation:
    """Look at a sample as the frame holds it.

    Args:
        watch: what the sensor has done so far.
        now: integer time at the autopilot; a sample from later than that is invalid.
        sample: with its time and whether it arrived at this instant.
        numbers: its value, at most as many as the watch is wide.
        frozen_after: so many equal samples in a row mean frozen; 0: never.
        ordered: refuse samples older than the newest, e.g. of an IMU; otherwise they are usable and counted.
    """
    filled = [jnp.asarray(n, np.float64) for n in numbers] + [jnp.zeros(())] * (watch.value.shape[0] - len(numbers))
    value = jnp.stack(filled)
    arrived = jnp.asarray(sample.fresh & sample.valid)
    sound = jnp.all(jnp.isfinite(value)) & (sample.t <= now)
    duplicate = arrived & sound & (sample.t == watch.last)
    older = arrived & sound & (sample.t < watch.last)
    new = arrived & sound & ~duplicate
    same = jnp.all(value == watch.value) & (watch.samples > watch.invalid)
    repeats = jnp.where(new, jnp.where(same, watch.repeats + 1, 0), watch.repeats).astype(np.int32)
    new_watch = SensorWatch(
        last=jnp.where(new & ~older, sample.t, watch.last),
        value=jnp.where(new, value, watch.value),
        repeats=repeats,
        frozen=(repeats >= frozen_after) & (jnp.asarray(frozen_after) > 0),
        saturated=watch.saturated,
        backwards=jnp.where(arrived & sound, older, watch.backwards),
        samples=increment(watch.samples, arrived),
        invalid=increment(watch.invalid, arrived & ~sound),
        duplicates=increment(watch.duplicates, duplicate),
        disordered=increment(watch.disordered, older),
        late=watch.late,
    )
    usable = new & ~older if ordered else new
    return SampleValidation(new_watch, usable, jnp.where(jnp.isfinite(value), value, 0.0), sample.t)


def increment(count: Any, one: Any) -> Any:
    """A counter, one higher where `one` holds; it stays at its largest value rather than turn over."""
    return jnp.where(one & (count < np.iinfo(np.int32).max), count + 1, count).astype(np.int32)
