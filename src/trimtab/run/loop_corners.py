"""Search for corners of a loop at rest, e.g. the edge of a saturation or a node of a table that is interpolated.

At a corner the automatic derivative is the slope of one side, or the mean of both slopes. A linear map with this slope
describes the loop on no side, or on one side only. This code runs offline.

Source: this module; one-sided derivatives as in A. Griewank, A. Walther, "Evaluating Derivatives", SIAM 2008, chapter
14.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

FAR, NEAR = 1e-4, 1e-6
"""Distances from rest, relative to max(1, |state|), at which changes of the loop's state are compared with its map."""
DIRECTIONS = 4
"""Number of tested directions. Each direction changes all states together, so that it crosses every corner at rest."""
SMOOTH_RATIO = 0.3
"""Largest ratio of the map's errors at the distances NEAR and FAR at which the loop counts as smooth. For a smooth
loop, the ratio is about 0.01."""
ERROR_MIN = 1e-4
"""Smallest error of the map that counts as a corner, relative to the change of the same state."""
ROUNDING = 1e-5
"""Largest error of the map that always counts as rounding, relative to the displacement of the same state."""
JUMP_RATIO = 10.0
"""Smallest ratio of the map's errors at NEAR and FAR that belongs to a jump or to rounding, whose ratio is about 100.
The ratio of a corner is about 1."""
JUMP_MIN = 1e-9
"""Smallest jump, relative to max(1, |state|). Smaller jumps count as rounding that many time steps have amplified."""


def find_loop_corner(
    change: Callable[[Any], Any], whole: Any, size: Any, keep: Any, names: Sequence[str]
) -> str | None:
    """Return the state with a corner and its changes on both sides of rest as a text, or None if the loop is smooth.

    Args:
        change: function that returns the change of the loop's state (n,) over one period, for an initial displacement
            (n,) from rest.
        whole: linear map of a displacement over one period (n, n).
        size: sizes of the states (n,), positive.
        keep: mask (n,) of the states on which a command depends. Only these states are displaced and compared.
        names: names of the states (n).
    """
    draws = np.random.default_rng(0)
    for _ in range(DIRECTIONS):
        way = draws.uniform(0.5, 1.0, len(size)) * draws.choice([-1.0, 1.0], len(size)) * size * keep
        wanted = whole @ way
        reach = (np.abs(whole) * np.abs(way)).sum(axis=1)
        least = np.maximum(ERROR_MIN * reach, ROUNDING * size)
        sides = [[change(sign * h * way) / h - sign * wanted for h in (FAR, NEAR)] for sign in (1.0, -1.0)]
        for far, near in np.abs(sides):
            rounding = (near > JUMP_RATIO * far) & (near * NEAR < JUMP_MIN * size)
            bad = keep & ~((near <= least) | (near <= SMOOTH_RATIO * far) | rounding)  # NaN is bad
            if bad.any():
                i = int(np.argmax(np.where(bad, near / np.maximum(reach, 1e-300), 0.0)))
                after, before = (sign * wanted[i] + side[1][i] for sign, side in zip((1.0, -1.0), sides, strict=True))
                return f"{names[i]} changes by {-before:.4g} on one side and by {after:.4g} on the other side of rest"
    return None
