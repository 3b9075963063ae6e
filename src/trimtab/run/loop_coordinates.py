"""Coordinates of a loop's states: deviations from a reference, one for each real number, three for each quaternion.

A quaternion in the true state, in a sample in transit or in an estimate is replaced by its rotation e from the
reference, in body axes: q = q_r exp(e). The length of the quaternion is therefore not a state and has no pole. Whole
numbers and flags have no coordinates.

Source: J. Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508, chapter 5.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.quantity import Quantity, leaves

T = TypeVar("T")

AXES = ("x", "y", "z")
"""Names of the axes of a rotation, in the body frame."""


class LoopCoordinates:
    """Conversion between a tree of states and the vector z (n,) of its deviations. like: example of the tree."""

    def __init__(self, like: Any) -> None:
        declared = [(path, d) for path, _, d in leaves(like) if isinstance(d, Quantity)]
        turns = {path for path, d in declared if d.shape == (4,) and len(d.frame) == 2 and d.unit == "1"}
        self._paths = [
            jax.tree_util.keystr(keys, simple=True, separator=".")
            for keys, _ in jax.tree_util.tree_flatten_with_path(like)[0]
        ]
        self._real = [is_real(v) for v in jax.tree.leaves(like)]
        self._turn = [
            path in turns and np.shape(v)[-1:] == (4,)
            for path, v in zip(self._paths, jax.tree.leaves(like), strict=True)
        ]

    def names(self, like: Any) -> tuple[str, ...]:
        """Return the name of each component of z: path in the tree, with an index or axis if needed."""
        names: list[str] = []
        for path, real, turn, v in zip(self._paths, self._real, self._turn, jax.tree.leaves(like), strict=True):
            if turn:
                count = int(np.size(v)) // 4
                names += [f"{path}{f'[{i}]' if count > 1 else ''}.{axis}" for i in range(count) for axis in AXES]
            elif real:
                names += [f"{path}{f'[{i}]' if np.ndim(v) else ''}" for i in range(int(np.size(v)))]
        return tuple(names)

    def sizes(self, like: Any) -> Any:
        """Return the magnitudes (n,) of the numbers in a tree; zero for rotations."""
        parts = [np.ravel(v) * (not turn) for v, turn in self._tangent(like)]
        return np.abs(np.concatenate([np.zeros(0), *parts]))

    def deviation(self, reference: Any, states: Any) -> Any:
        """Return the deviation z (n,) of states from a reference."""
        parts = []
        pairs = zip(jax.tree.leaves(reference), jax.tree.leaves(states), self._real, self._turn, strict=True)
        for r, v, real, turn in pairs:
            if turn:
                parts.append(jnp.ravel(_each_turn(lambda p, q: quaternion.local(_unit(p), _unit(q)), r, v)))
            elif real:
                parts.append(jnp.ravel(v - r))
        return jnp.concatenate([jnp.zeros(0), *parts])

    def displace(self, reference: T, z: Any) -> T:
        """Return the states that deviate from a reference by z."""
        values, tree = jax.tree.flatten(reference)
        new, begin = [], 0
        for r, real, turn in zip(values, self._real, self._turn, strict=True):
            size = 0 if not real else int(np.size(r)) // 4 * 3 if turn else int(np.size(r))
            own = z[begin : begin + size]
            begin += size
            if turn:
                new.append(_each_turn(lambda p, e: quaternion.retract(_unit(p), e), r, jnp.reshape(own, (-1, 3))))
            else:
                new.append(r + jnp.reshape(own, jnp.shape(r)) if real else r)
        return jax.tree.unflatten(tree, new)

    def place_indices(self, like: T) -> T:
        """Return the tree with each number replaced by its index in z. It shows how a function permutes the numbers."""
        values, tree = jax.tree.flatten(like)
        places = iter(self._tangent(like))
        new, begin = [], 0
        for v, real in zip(values, self._real, strict=True):
            own = next(places)[0] if real else v
            size = int(np.size(own)) if real else 0
            new.append(np.arange(begin, begin + size).reshape(np.shape(own)) if real else v)
            begin += size
        return jax.tree.unflatten(tree, new)

    def flatten(self, marks: Any) -> Any:
        """Return the indices in a tree from `place_indices` as one vector (n,)."""
        parts = [np.ravel(v) for v, real in zip(jax.tree.leaves(marks), self._real, strict=True) if real]
        return np.concatenate([np.zeros(0, int), *parts]).astype(int)

    def _tangent(self, like: Any) -> list[tuple[Any, bool]]:
        """Return, for each real leaf, its numbers and False, or the first three numbers of its quaternions and True."""
        found = zip(jax.tree.leaves(like), self._real, self._turn, strict=True)
        return [(np.asarray(v)[..., :3] if turn else np.asarray(v), turn) for v, real, turn in found if real]


def is_real(v: Any) -> bool:
    """Return True for an array of real numbers, and False for whole numbers, keys or flags."""
    return jnp.issubdtype(jnp.result_type(v), jnp.floating)


def _each_turn(function: Any, r: Any, v: Any) -> Any:
    """Return function(quaternion, v) for each quaternion in an array r (…, 4) and the corresponding vector in v."""
    whole = jax.vmap(function)(jnp.reshape(r, (-1, 4)), jnp.reshape(v, (-1, jnp.shape(v)[-1])))
    return jnp.reshape(whole, (*jnp.shape(r)[:-1], whole.shape[-1]))


def _unit(q: Any) -> Any:
    """Return q normalised, or the identity if q is zero, as in a slot that contains no quaternion yet."""
    length2 = q @ q
    is_any = length2 > 1e-6
    return jnp.where(is_any, q / jnp.sqrt(jnp.where(is_any, length2, 1.0)), jnp.array([1.0, 0.0, 0.0, 0.0]))
