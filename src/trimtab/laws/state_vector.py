"""Conversion of the estimated state to the vector that a linear law multiplies, and of a vector to the input record.

A field of four numbers without a unit is a quaternion. Its deviation has three elements: the rotation vector from the
set-point, in body axes.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from trimtab.core import quaternion
from trimtab.core.quantity import Quantity, declarations


def state_error(
    state: Any,
    names: Sequence[str],
    point: Any,
    attitude: str = "",
    turned: Sequence[str] = (),
    places: Sequence[str] = (),
) -> Any:
    """Return the deviation (n,) of the named fields of a state from a set-point with the same fields.

    Args:
        state: estimated state, a record.
        names: names of the fields of the state, in the order of the result. Each is a number, a vector or a quaternion.
        point: set-point (k,): the values of these fields, concatenated. A quaternion has four numbers.
        attitude: name of the quaternion field q_XB. Needed only if `turned` or `places` is not empty.
        turned: vector fields in the frame X, such as velocities, that are compared in body axes. The deviation is the
        state's value in the state's body axes, minus the set-point's value in the set-point's body axes.
        places: fields in the frame X whose deviation is taken in the body axes of the set-point.
    """
    wanted = _split_point(state, names, point)
    parts = []
    for name in names:
        own = jnp.asarray(getattr(state, name), jnp.float64)
        if own.shape == (4,) and _has_no_unit(state, name):
            parts.append(quaternion.local(wanted[name], own))
        elif name in turned:
            here, there = (quaternion.to_matrix(q).T for q in (getattr(state, attitude), wanted[attitude]))
            parts.append(here @ own - there @ wanted[name])
        elif name in places:
            parts.append(quaternion.to_matrix(wanted[attitude]).T @ (own - wanted[name]))
        else:
            parts.append(jnp.ravel(own - wanted[name]))
    return jnp.concatenate(parts)


def _has_no_unit(state: Any, name: str) -> bool:
    declared = declarations(state)[name]
    return isinstance(declared, Quantity) and declared.unit == "1"


def add_to_input(trim: Any, change: Any) -> Any:
    """Return the input record `trim` with the elements of `change` (m,) added to the record's values, in the order of
    the fields."""
    values, tree = jax.tree.flatten(trim)
    new, begin = [], 0
    for own in values:
        size = jnp.size(own)
        new.append(own + jnp.reshape(change[begin : begin + size], jnp.shape(own)))
        begin += size
    return jax.tree.unflatten(tree, new)


def _split_point(state: Any, names: Sequence[str], point: Any) -> dict[str, Any]:
    wanted, begin = {}, 0
    for name in names:
        shape = jnp.shape(getattr(state, name))
        size = 1
        for edge in shape:
            size *= edge
        wanted[name] = jnp.reshape(jnp.asarray(point)[begin : begin + size], shape)
        begin += size
    return wanted
