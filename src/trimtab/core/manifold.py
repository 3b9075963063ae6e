"""State ± error, by field kind: angles wrap, all else is a vector space.

`retract(x, e)` moves a state by an error vector, `local_error(x, y)` is the error from x to y. They are inverse to
each other for errors below half a turn, so any estimator works on any record of floats.

Source: Hertzberg, Wagner, Frese, Schröder, "Integrating generic sensor fusion algorithms with sound state
representations through encapsulation of manifolds", Information Fusion 14 (2013).
"""

from typing import Any, TypeVar

from trimtab.core.float64 import jnp
from trimtab.core.record import Quantity, leaves, with_leaf
from trimtab.core.rotation import wrap

X = TypeVar("X")


def _real_leaves(x: Any) -> list[tuple[str, Any, Quantity]]:
    return [(p, v, d) for p, v, d in leaves(x) if isinstance(d, Quantity) and d.kind in ("real", "angle")]


def dimension(x: Any) -> int:
    """Length of the error vector of a record: its reals and angles, in declared order."""
    return sum(jnp.asarray(v).size for _, v, _ in _real_leaves(x))


def error_names(x: Any) -> tuple[str, ...]:
    """What each entry of the error vector is, e.g. ("surge_velocity", "heading")."""
    found: list[str] = []
    for path, value, _ in _real_leaves(x):
        size = jnp.asarray(value).size
        found += [path] if jnp.ndim(value) == 0 else [f"{path}[{i}]" for i in range(size)]
    return tuple(found)


def retract(x: X, error: Any) -> X:
    """x moved by an error vector (n,); angles come back in [-pi, pi)."""
    start, moved = 0, x
    for path, value, declared in _real_leaves(x):
        old = jnp.asarray(value)
        new = old + error[start : start + old.size].reshape(old.shape)
        start += old.size
        new = wrap(new) if declared.kind == "angle" else new
        moved = with_leaf(moved, path, lambda _old, _d, new=new: new)
    return moved


def local_error(x: X, y: X) -> Any:
    """The error vector (n,) that takes x to y: y - x, the short way round for angles."""
    parts: list[Any] = []
    for (_, a, declared), (_, b, _) in zip(_real_leaves(x), _real_leaves(y), strict=True):
        difference = jnp.asarray(b) - jnp.asarray(a)
        parts.append((wrap(difference) if declared.kind == "angle" else difference).reshape(-1))
    return jnp.concatenate(parts)
