"""Coordinates for the linearisation of a loop: deviations of the loop's states from a reference.

Each real number has one coordinate, and each quaternion three. A quaternion q, which may be part of the true state, of
a sample in transit or of an estimate, is represented by the rotation e from the reference q_r, in body axes: q = q_r
exp(e). Therefore the length of the quaternion is not a state and causes no pole. Integers and flags have no
coordinates.

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
"""Names of the components of a rotation, in body axes."""


class LoopCoordinates:
    """Conversion between the states of a loop, a tree of records, and the vector z (n,) of their deviations."""

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
        """Return the name of each component of z: the path of the state, with an index or axis if needed."""
        names: list[str] = []
        for path, real, turn, v in zip(self._paths, self._real, self._turn, jax.tree.leaves(like), strict=True):
            if turn:
                count = int(np.size(v)) // 4
                names += [f"{path}{f'[{i}]' if count > 1 else ''}.{axis}" for i in range(count) for axis in AXES]
            elif real:
                names += [f"{path}{f'[{i}]' if np.ndim(v) else ''}" for i in range(int(np.size(v)))]
        return tuple(names)

    def sizes(self, like: Any) -> Any:
        """Return the magnitudes (n,) of the states. The magnitudes of rotations are zero."""
        parts = [np.ravel(v) * (not turn) for v, turn in self._tangent(like)]
        return np.abs(np.concatenate([np.zeros(0), *parts]))

    def deviation(self, reference: Any, states: Any) -> Any:
        """Return the deviations z (n,) of the states from reference states."""
        parts = []
        pairs = zip(jax.tree.leaves(reference), jax.tree.leaves(states), self._real, self._turn, strict=True)
        for r, v, real, turn in pairs:
            if turn:
                parts.append(jnp.ravel(_each_turn(lambda p, q: quaternion.local(_unit(p), _unit(q)), r, v)))
            elif real:
                parts.append(jnp.ravel(v - r))
        return jnp.concatenate([jnp.zeros(0), *parts])

    def displace(self, reference: T, z: Any) -> T:
        """Return the states whose deviations from the reference states are z."""
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
        """Return a tree in which each number is replaced by the number's index in z.

        A function that permutes states can be applied to this tree to find the permutation.
        """
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
        """Return the indices in a tree made by `place_indices` as one vector (n,)."""
        parts = [np.ravel(v) for v, real in zip(jax.tree.leaves(marks), self._real, strict=True) if real]
        return np.concatenate([np.zeros(0, int), *parts]).astype(int)

    def _tangent(self, like: Any) -> list[tuple[Any, bool]]:
        """Return the numbers of each real leaf, and a flag that is True for a leaf of quaternions.

        Of a quaternion, only the first three numbers are returned, so that the count equals that of the coordinates.
        """
        found = zip(jax.tree.leaves(like), self._real, self._turn, strict=True)
        return [(np.asarray(v)[..., :3] if turn else np.asarray(v), turn) for v, real, turn in found if real]


def is_real(v: Any) -> bool:
    """Return True for an array of real numbers, and False for integers, random keys and flags."""
    return jnp.issubdtype(jnp.result_type(v), jnp.floating)


def _each_turn(function: Any, r: Any, v: Any) -> Any:
    """Return function(quaternion, vector) for each quaternion in r (…, 4) and the corresponding vector in v."""
    whole = jax.vmap(function)(jnp.reshape(r, (-1, 4)), jnp.reshape(v, (-1, jnp.shape(v)[-1])))
    return jnp.reshape(whole, (*jnp.shape(r)[:-1], whole.shape[-1]))


def _unit(q: Any) -> Any:
    """Return the quaternion q normalised, or the identity if q is zero, as in an empty slot of a ring buffer."""
    length2 = q @ q
    is_any = length2 > 1e-6
    return jnp.where(is_any, q / jnp.sqrt(jnp.where(is_any, length2, 1.0)), jnp.array([1.0, 0.0, 0.0, 0.0]))
