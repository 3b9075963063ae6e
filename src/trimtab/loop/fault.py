"""A fault: what goes wrong with a part, from when on, for how long, how badly. One vocabulary for every part.

What each word means for a sensor, a link and the actuators: docs page, Faults.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, period, quantity, record
from trimtab.core.rng import Key, normals, uniform2
from trimtab.core.time import FOREVER, ms, to_seconds
from trimtab.links.fifo import NEVER

WORDS = ("none", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
NONE, OFF, STUCK, GARBAGE, WRONG, SLOW, DELAYED, INTERMITTENT = range(len(WORDS))
NAN_BEYOND = 1.5
"""Garbage is no number at all where the standard normal draw is larger than this: 13 % of the time."""


@record
class Fault:
    """One fault of one part. All numbers can be set while a run goes on; the word too.

    It acts from `start` for `duration`; with a `watch`, from the first instant after `start` at which what it watches
    lies on the `side` of `level`. Until then, and after, the part is itself, bit for bit.

    Frames:  those of the part.
    Source:  docs page, Faults; the words are those of PX4's failure injection.
    """

    word: Scalar = quantity("1", "What goes wrong.", kind="mode", modes=WORDS, default=NONE, low=0, high=len(WORDS) - 1)
    start: Scalar = quantity("100 ns", "From when on.", kind="time", default=0)
    duration: Scalar = quantity("100 ns", "For how long.", kind="time", default=FOREVER, low=0)
    severity: Scalar = quantity("1", "How badly; what it means depends on the word.", default=1.0)
    bias: Scalar = quantity("1", "Wrong: added to every real number, in the unit of that number.", default=0.0)
    level: Scalar = quantity("1", "Threshold of what is watched, in its unit.", default=0.0)
    watch: str = option("Path of a number that the part sees; empty: time alone decides.", default="")
    side: str = option("On which side of the level it begins.", default="above", choices=("above", "below"))
    slot: int = period("Intermittent: how long it stays off, or on, at a time.", default=ms(100))

    def check(self) -> None:
        """Refuse a severity that the word can't have."""
        word, severity = int(self.word), float(self.severity)
        rules = {
            GARBAGE: (severity > 0, "how many times the plausible size, above 0"),
            SLOW: (severity >= 1, "every how manieth comes, at least 1"),
            DELAYED: (severity >= 0, "seconds, not negative"),
            INTERMITTENT: (0 <= severity <= 1, "the share of the time that it is off, 0 to 1"),
        }
        good, meaning = rules.get(word, (True, ""))
        if not good:
            problem = f"{severity:g} is not possible for {WORDS[word]!r}, where it is {meaning}"
            raise InputError("severity", problem, fix="choose another, e.g. by 0.5, by 2")

    def begin_time(self, t: Any, begun: Any, seen: Any) -> Any:
        """When it began (100 ns), NEVER before; seen: what the part sees at integer time t."""
        if not self.watch:
            return jnp.where(t >= self.start, jnp.asarray(self.start, np.int64), NEVER)
        number = jnp.asarray(signal_value(seen, self.watch), np.float64)
        met = number > self.level if self.side == "above" else number < self.level
        waiting = begun == NEVER
        return jnp.where(t < self.start, NEVER, jnp.where(waiting & met, t, begun))

    def active_word(self, t: Any, begun: Any) -> Any:
        """The word that acts at integer time t."""
        acts = (begun != NEVER) & (t >= begun) & (t - begun < self.duration)
        return jnp.where(acts, self.word, NONE)

    def is_off(self, key: Key, t: Any) -> Any:
        """Intermittent: whether this slot of time is one of those without."""
        u, _ = uniform2(key, t // self.slot, 7)
        return u < self.severity

    def is_skipped(self, number: Any) -> Any:
        """Slow: whether the number-th of a row is left out."""
        n = jnp.maximum(jnp.round(self.severity), 1.0).astype(np.int32)
        return number % n != 0

    def delay_steps(self, step: int, capacity: int) -> Any:
        """Delayed: by how many steps of this length (100 ns), as far as a ring of this capacity reaches."""
        return jnp.clip(jnp.round(self.severity / to_seconds(step)), 0, capacity - 1).astype(np.int32)

    def check_ring(self, step: int, capacity: int) -> None:
        """Refuse a delay that is longer than what a ring of this capacity holds, one slot a step (100 ns)."""
        longest = to_seconds(step) * (capacity - 1)
        if int(self.word) == DELAYED and float(self.severity) > longest + 1e-9:
            needed = delay_slots(float(self.severity), step)
            problem = f"{float(self.severity):g} s is longer than the {longest:g} s that {capacity} slots hold"
            raise InputError("fault.severity", problem, fix=f"set capacity to {needed} or more")

    def distort_value(self, value: Any) -> Any:
        """The value with every real number scaled by 1 + severity, and biased."""

        def leaf(v: Any) -> Any:
            v = jnp.asarray(v)
            return v * (1 + self.severity) + self.bias if jnp.issubdtype(v.dtype, jnp.floating) else v

        return jax.tree.map(leaf, value)

    def garbage_value(self, key: Key, index: Any, value: Any) -> Any:
        """Random numbers, `severity` times as large as the value or as 1, or NaN; random flags and integers."""
        flat, tree = jax.tree.flatten(value)
        shapes = [np.shape(v) for v in flat]
        draws, made, k = normals(key, index, sum(int(np.prod(s)) for s in shapes)), [], 0
        for v, shape in zip(flat, shapes, strict=True):
            size = int(np.prod(shape))
            made.append(self._garbage_leaf(jnp.asarray(v), jnp.reshape(draws[k : k + size], shape)))
            k += size
        return jax.tree.unflatten(tree, made)

    def _garbage_leaf(self, v: Any, z: Any) -> Any:
        if v.dtype == np.bool_:
            return z > 0
        if jnp.issubdtype(v.dtype, jnp.floating):
            return jnp.where(abs(z) > NAN_BEYOND, jnp.nan, self.severity * jnp.maximum(abs(v), 1.0) * z)
        return jnp.round(abs(z) * 1000).astype(v.dtype)


def delay_slots(delay: float, step: int) -> int:
    """How many slots of a ring, one a step (100 ns), hold what is `delay` (s) old."""
    return 1 + int(np.ceil(delay / to_seconds(step) - 1e-9))


def signal_value(tree: Any, path: str) -> Any:
    """The number at a dotted path of a tree of records and arrays, e.g. "p_WB.0"."""
    for name in path.split("."):
        if name.isdigit():
            tree = jnp.asarray(tree)[int(name)]
        else:
            tree = tree[name] if isinstance(tree, dict) else getattr(tree, name)
    return tree
