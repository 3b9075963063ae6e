"""Checks of a sensor's samples, without other sensors: frozen sensor, repeated sample, or wrong time.

Source: docs page, Sensor watch.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Sample
from trimtab.core.time import FOREVER

NEVER = -FOREVER
"""Time that means never. It is earlier than any instant."""
WIDTH = 3
"""Smallest number of values that are stored for a sensor's sample. Shorter samples are padded with zeros."""


@record
class SensorWatch:
    """Checks of one sensor's samples: last sample, flags and counters. Source: docs page, Sensor watch."""

    last: Scalar = quantity("100 ns", "Time at which the sensor's newest sample was measured.", kind="time")
    value: Any = quantity("1", "Last sample of the sensor, in the sensor's units, padded with zeros.")
    repeats: Scalar = quantity(
        "1", "Number of consecutive samples with exactly the same value as the sample before.", kind="count"
    )
    frozen: Scalar = quantity(
        "1", "True if the sensor is frozen, i.e. its samples repeat more often than noise allows.", kind="flag"
    )
    saturated: Scalar = quantity(
        "1", "True if the last sample was saturated, i.e. at the end of the sensor's range.", kind="flag"
    )
    backwards: Scalar = quantity(
        "1", "True if the last sample was measured before a sample that had arrived earlier.", kind="flag"
    )
    samples: Scalar = quantity("1", "Number of samples that have arrived.", kind="count")
    invalid: Scalar = quantity(
        "1", "Number of samples not used because they were not finite, or from the future.", kind="count"
    )
    duplicates: Scalar = quantity("1", "Number of repeated samples, which are not used.", kind="count")
    disordered: Scalar = quantity("1", "Number of samples that arrived after a newer sample.", kind="count")
    late: Scalar = quantity("1", "Number of samples not used because they were older than the history.", kind="count")


class SampleValidation(NamedTuple):
    """Result of checking a sample.

    watch: updated checks of the sensor.  usable: True if the sample may be used.  value: finite values, padded with
    zeros.  t: time at which the sample was measured.
    """

    watch: SensorWatch
    usable: Any
    value: Any
    t: Any


def initial_watch(width: int = WIDTH) -> SensorWatch:
    """Return the checks of a sensor before its first sample. width: number of values stored for a sample."""
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
    """Check a sensor's sample of the current frame.

    Args:
        watch: previous checks of the sensor.
        now: present integer time at the autopilot; a sample measured later is invalid.
        sample: the sample, with its time and a flag that it arrived at this instant.
        numbers: values of the sample, at most as many as the watch stores.
        frozen_after: number of consecutive equal samples after which the sensor counts as frozen; 0 for never.
        ordered: True to reject samples older than the newest, e.g. for an IMU; False to count and accept them.
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
    """Return a counter, increased by 1 if `one` is True. It stays at its largest value instead of overflowing."""
    return jnp.where(one & (count < np.iinfo(np.int32).max), count + 1, count).astype(np.int32)
