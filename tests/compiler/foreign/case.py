"""A function of somebody else's library, as a user of it would compile it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class Case(NamedTuple):
    """A function and its arguments.

    name: unique in its file.  function: pure, of arrays and trees of them.  arguments: drawn anew by each call.
    sensitive: jax.jit's own results move by more than 1e-13 where an input moves in its last place.
    refused: the primitive or type that the refusal names, where there is no C text; empty where it compiles.
    """

    name: str
    function: Callable[..., Any]
    arguments: Callable[[np.random.Generator], tuple[Any, ...]]
    refused: str = ""
    sensitive: bool = False


def normal(*shapes: tuple[int, ...]) -> Callable[[np.random.Generator], tuple[Any, ...]]:
    """Arrays of these shapes, standard normal."""
    return lambda rng: tuple(rng.normal(size=shape) for shape in shapes)


def uniform(low: float, high: float, *shapes: tuple[int, ...]) -> Callable[[np.random.Generator], tuple[Any, ...]]:
    """Arrays of these shapes, uniform between two numbers."""
    return lambda rng: tuple(rng.uniform(low, high, size=shape) for shape in shapes)
