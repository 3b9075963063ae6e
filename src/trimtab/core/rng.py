"""Counter-based random numbers: threefry 2x32 in plain integer arithmetic.

A random number depends only on (seed, run), on the sample's index and on the block's stream. Therefore all backends
draw the same bits, any run can be repeated alone, and the noise of a part does not change when another part is switched
off.

The draws may be divided into groups. Each group then has its own 32-bit word, used in place of the run number. A new
word for a group changes the noise of this group only. A Markov chain towards a rare failure changes these words (docs
page, Rare failures).

Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (20 rounds).
"""

import functools
import math
import zlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record

ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
PARITY = 0x1BD11BDA
TERMS = 8
"""Number of normal numbers whose scaled sum is one drawn number, if the draws are divided into groups."""
TERM_STRIDE = 0x9E3779B1
"""Difference of the stream numbers of the summed normal numbers. The difference is odd, so that the summed numbers are
in different groups."""


@record
class Key:
    """Key of a block's random numbers: the 32-bit words (seed, run), and a stream. Frames: none. Source: this
    module."""

    seed: Scalar = quantity("1", "First key word: the seed of a study.", kind="word")
    run: Any = quantity("1", "Second key word: the run number; or one word for each group of draws.", kind="word")
    stream: int = option("First stream number of the block, derived from its path.", default=0)

    def at(self, name: str) -> "Key":
        """Return the key of a named sub-block. Streams depend only on the sub-block's path, not on other parts of the
        loop."""
        return Key(self.seed, self.run, zlib.crc32(name.encode(), self.stream))


def key(seed: int, run: int = 0) -> Key:
    """Return the root key of a run; seed and run are taken modulo 2**32."""
    return Key(np.uint32(seed % 2**32), np.uint32(run % 2**32))


def split(key: Key, n: int) -> Key:
    """Return the keys of n equal blocks, as a Key with fields (n,). Each block gets different random numbers."""
    a, b = threefry2x32(key.seed, key.run, np.arange(n, dtype=np.uint32), np.uint32(key.stream))
    return Key(a, b, key.stream)


@functools.partial(jax.jit, inline=True)  # traced once for each shape: tracing takes long
def threefry2x32(k0: Any, k1: Any, c0: Any, c1: Any) -> tuple[Any, Any]:
    """Return two random 32-bit words for a key (k0, k1) and a counter (c0, c1); all uint32, of any shape."""
    k0, k1, c0, c1 = (jnp.asarray(word, np.uint32) for word in (k0, k1, c0, c1))
    words = (k0, k1, k0 ^ k1 ^ np.uint32(PARITY))
    x0, x1 = c0 + words[0], c1 + words[1]
    for i in range(5):
        for r in ROTATIONS[i % 2]:
            x0 = x0 + x1
            x1 = x0 ^ ((x1 << np.uint32(r)) | (x1 >> np.uint32(32 - r)))
        x0 = x0 + words[(i + 1) % 3]
        x1 = x1 + words[(i + 2) % 3] + np.uint32(i + 1)
    return x0, x1


def _group_word(run: Any, counter: Any, streams: Any) -> Any:
    """Return the second key word of draws: the run's number, or the word of each draw's group.

    counter, streams: uint32, of shapes that broadcast.
    """
    if not jnp.ndim(run):
        return run
    group = (counter + streams) % np.uint32(jnp.shape(run)[0])
    return jnp.asarray(run).at[group.astype(np.int32)].get(mode="promise_in_bounds")


def _uniform(word: Any) -> Any:
    return (word.astype(np.float64) + 0.5) * 2.0**-32


def uniform2(key: Key, index: Any, stream: int = 0) -> tuple[Any, Any]:
    """Return two independent uniform random numbers in (0, 1).

    Args:
        key: key of the block.
        index: number of the sample, e.g. the instant divided by the block's period; any integer.
        stream: number of the draw within a sample. Each stream yields an independent pair.
    """
    c0, c1 = jnp.asarray(index).astype(np.uint32), np.uint32((key.stream + stream) % 2**32)
    a, b = threefry2x32(key.seed, _group_word(key.run, c0, c1), c0, c1)
    return _uniform(a), _uniform(b)


def normal2(key: Key, index: Any, stream: int = 0) -> tuple[Any, Any]:
    """Return two independent standard normal numbers (Box and Muller 1958). The arguments are those of `uniform2`."""
    c0, c1 = jnp.asarray(index).astype(np.uint32), np.uint32((key.stream + stream) % 2**32)
    return _normal_pair(key, c0, c1)


def normals(key: Key, index: Any, n: int) -> Any:
    """Return n independent standard normal numbers, of shape (n,) + shape of index, from the key's streams 0, 1, …."""
    pairs = (n + 1) // 2
    counter = jnp.asarray(index).astype(np.uint32)
    streams = np.array([(key.stream + i) % 2**32 for i in range(pairs)], np.uint32).reshape(-1, *[1] * counter.ndim)
    both = jnp.stack(_normal_pair(key, counter, streams), axis=1)
    return both.reshape(2 * pairs, *counter.shape)[:n]


def _normal_pair(key: Key, counter: Any, streams: Any) -> tuple[Any, Any]:
    """Return two standard normal numbers for each draw.

    If the draws are divided into groups, each number is a scaled sum of TERMS normal numbers of different groups. A new
    word of one group then changes the number only a little.
    """
    if not jnp.ndim(key.run):
        return _box_muller(*threefry2x32(key.seed, key.run, counter, streams))
    x, y = 0.0, 0.0
    for term in range(TERMS):
        own = ((np.asarray(streams, np.uint64) + term * TERM_STRIDE) % 2**32).astype(np.uint32)
        a, b = _box_muller(*threefry2x32(key.seed, _group_word(key.run, counter, own), counter, own))
        x, y = x + a, y + b
    return x / math.sqrt(TERMS), y / math.sqrt(TERMS)


def _box_muller(a: Any, b: Any) -> tuple[Any, Any]:
    u, v = _uniform(a), _uniform(b)
    r = jnp.sqrt(-2.0 * jnp.log(u))
    return r * jnp.cos(2 * np.pi * v), r * jnp.sin(2 * np.pi * v)
