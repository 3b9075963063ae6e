"""Search for corners and jumps of a model at a point. At a corner, automatic differentiation returns the derivative of
one side, or the mean of both sides. Near a corner, derivatives do not approach the derivative at the point, however
small the distance. Near a jump, values do not approach the value at the point. This code runs offline.

Source: this module; one-sided derivatives as in A. Griewank, A. Walther, "Evaluating Derivatives", SIAM 2008, chapter
14.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from trimtab.design.model import StateSpaceModel

FAR, NEAR = 1e-5, 1e-7
"""Distances from the point, relative to max(1, |value|), at which slopes and values are compared."""
SMOOTH_RATIO = 0.3
"""Largest ratio of a slope's changes at the distances NEAR and FAR at which the slope counts as smooth. For a smooth
function, the ratio is about 0.01."""
SLOPE_CHANGE_MIN = 1e-6
"""Smallest change of a slope that counts as a corner, relative to the largest slope of the same output."""
ROUNDING = 1e-10
"""Largest change of a slope that counts as rounding, relative to the largest slope of all outputs."""
JUMP_MIN = 1e-10
"""Smallest change of an output that counts as a jump, relative to the output's value or its largest slope, whichever is
larger."""
VALUE_ROUNDING = 1e-14
"""Largest change of an output that counts as rounding, relative to the largest of all values and slopes."""
MIXED = 8
"""Number of tested directions in which all states and inputs change together."""


class Corner(NamedTuple):
    """Corner or jump. row: name of the state derivative or output.  reason: text with the slopes or values on both
    sides of the point.
    """

    row: str
    reason: str


class _Side(NamedTuple):
    """Changes of slopes (rows, columns) and values (rows,) on one side of the point, at the distances FAR and NEAR."""

    far: Any
    near: Any
    far_value: Any
    near_value: Any


def find_corner(model: StateSpaceModel, x: Any, u: Any) -> Corner | None:
    """Return the first corner or jump at a point, or None if the model is smooth there.

    The model is evaluated near the point along each state and input, and along some directions that change all of them.

    Args:
        model: the system.
        x: state (n,).
        u: input (m,).
    """
    z0, n = np.concatenate([np.asarray(x, float), np.asarray(u, float)]), len(x)
    size = np.maximum(np.abs(z0), 1.0)
    names, rows = (*model.states, *model.inputs), (*(f"{name}'" for name in model.states), *model.outputs)
    J0, y0 = _slopes_and_values(model, z0, n, size)

    def change(step: Any) -> tuple[Any, Any]:
        J, y = _slopes_and_values(model, z0 + step, n, size)
        return J - J0, y - y0

    for way, name in _directions(names):
        sides = []
        for sign in (1.0, -1.0):
            (far, far_value), (near, near_value) = (change(sign * h * size * way) for h in (FAR, NEAR))
            sides.append(_Side(far, near, far_value, near_value))
        bad = _jump(sides, y0, J0)
        if bad is not None:
            below, above = (float(y0[bad] + side.near_value[bad]) for side in sides[::-1])
            reason = f"its value is {below:.6g} before, {y0[bad]:.6g} at and {above:.6g} after the point along {name}"
            return Corner(rows[bad], reason)
        entry = _corner(sides, J0)
        if entry is not None:
            i, j = entry
            below, at, above = (float(J[i, j] / size[j]) for J in (J0 + sides[1].near, J0, J0 + sides[0].near))
            reason = f"its slope by {names[j]} is {below:.6g} before and {above:.6g} after the point along {name}"
            return Corner(rows[i], f"{reason}; the automatic derivative at the point is {at:.6g}")
    return None


def _directions(names: tuple[str, ...]) -> Iterator[tuple[Any, str]]:
    """Yield directions (n,) with their names: each state and input, then combinations with random signs and lengths."""
    for k, name in enumerate(names):
        yield np.eye(len(names))[k], name
    if len(names) > 1:
        draws = np.random.default_rng(0)
        for _ in range(MIXED):
            way = draws.uniform(0.5, 1.0, len(names)) * draws.choice([-1.0, 1.0], len(names))
            parts = ", ".join(f"{v:+.2f} {name}" for v, name in zip(way, names, strict=True))
            yield way, f"the direction {parts}" if len(names) <= 4 else "a direction that changes all states and inputs"


def _slopes_and_values(model: StateSpaceModel, z: Any, n: int, size: Any) -> tuple[Any, Any]:
    """Return slopes (rows, columns), times the sizes of states and inputs, and values (rows,), all at z. The rows are
    the state derivatives and the outputs."""
    A, B, C, D = model.slopes(z[:n], z[n:])
    return np.block([[A, B], [C, D]]) * size, np.concatenate(model.evaluate(z[:n], z[n:]))


def _jump(sides: list[_Side], y0: Any, J0: Any) -> int | None:
    """Return the index of the first state derivative or output that jumps, or None. Values that are not finite don't
    count as jumps."""
    row = np.maximum(np.abs(y0), np.abs(J0).max(axis=1, initial=0.0))
    least = np.maximum(JUMP_MIN * row, VALUE_ROUNDING * row.max(initial=0.0))
    for side in sides:
        near, far = np.abs(side.near_value), np.abs(side.far_value)
        bad = np.flatnonzero((near > least) & (near > SMOOTH_RATIO * far))
        if len(bad):
            return int(bad[0])
    return None


def _corner(sides: list[_Side], J0: Any) -> tuple[int, int] | None:
    """Return the row and column of the first slope with a corner, or None. Slopes that are not finite don't count as
    corners."""
    around = [np.abs(J0), *(np.abs(J0 + side.near) for side in sides)]
    row = np.nanmax([np.nanmax(J, axis=1, initial=0.0) for J in around], axis=0)
    least = np.maximum(SLOPE_CHANGE_MIN * row, ROUNDING * row.max(initial=0.0))[:, None]
    for side in sides:
        near, far = np.abs(side.near), np.abs(side.far)
        bad = np.argwhere((near > least) & (near > SMOOTH_RATIO * far))
        if len(bad):
            i, j = bad[0].tolist()
            return i, j
    return None
