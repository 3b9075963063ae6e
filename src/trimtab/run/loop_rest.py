"""Search for the equilibrium of a loop: fly until the loop is nearly at rest, then apply Newton's method.

A loop at rest is periodic: after one period, all states are unchanged, except clocks and states on which no command
depends. This code runs offline.

Source: this module.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.time import seconds, to_seconds
from trimtab.design.loop_map import STABLE
from trimtab.run.loop_coordinates import LoopCoordinates
from trimtab.run.loop_corners import find_loop_corner
from trimtab.run.loop_step import LoopStep

REST = 1e-7
"""Tolerance for a loop at rest: largest change of a state over one period of the loop, relative to max(1, |state|)."""
SETTLE_TIMES = (10.0, 100.0, 1000.0)
"""Times of flight (s) after which the equilibrium is searched, one after the other, if no time is given. The search
ends when a loop changes as fast as after the time before."""

SETTLE_MAX = 1e5
"""Longest time of flight (s) before the search."""


class _Unrest(NamedTuple):
    """Largest relative change of a state over one period, and a text that names the state and its change."""

    change: float
    text: str


def find_rest(run: LoopStep, s: Any, a: Any, count: int, times: Sequence[float]) -> tuple[Any, Any, int, Any, Any]:
    """Fly a loop until it is at rest. Return its states, the time (100 ns), the mask of idle states, and the matrices.

    Args:
        run: step of the loop.
        s, a: initial states of world and autopilot.
        count: number of steps in a period of the loop.
        times: times of flight (s) after which the equilibrium is searched, one after the other.

    Raises: InputError if the loop is at rest after none of the times.
    """
    t, last, span = 0, _Unrest(math.inf, ""), count * run.tick
    for after in times:
        s, a, t = run.fly(s, a, t, count * max(1, round((seconds(after) - t) / span)))
        found = _search(run, s, a, t, count)
        if not isinstance(found, _Unrest):
            return found
        is_calmer, last = found.change < 0.5 * last.change, found
        if not is_calmer:
            break
    name = run.loop.name or "SCENARIO"
    fix = f"set a constant reference (trimtab list {name}), fly longer with {argument('settle', 5000)}, or set the "
    fix += f"time of one lap of a closed path: {argument('round', 5)}"
    fix = fix if math.isfinite(last.change) else f"stabilise the loop first; its flight:  trimtab run {name}"
    problem = f"the loop does not come to rest: after {to_seconds(t):g} s of flight, {last.text}"
    raise InputError("linearise", problem, fix=fix)


def _search(run: LoopStep, s: Any, a: Any, t: int, count: int) -> tuple[Any, Any, int, Any, Any] | _Unrest:
    """Return the states of the loop at rest, found by Newton's method, and the matrices at these states.

    A loop at rest is periodic: after one period, all states are unchanged, except clocks and states on which no command
    depends. Return the change of the states if the loop is not near rest.
    """
    span, own, unrest = count * run.tick, run.coordinates((s, a)), None
    names = own.names((s, a))
    for _ in range(8):
        s1, a1, A, B, C = run.slopes(s, a, t, count)
        order = own.flatten(run.align(*own.place_indices((s, a)), span))
        A[-1], B[-1] = A[-1][order], B[-1][order]
        change = np.asarray(own.deviation((s, a), run.align(s1, a1, span)))
        if not all(np.isfinite(M).all() for M in (A, B, C)):
            unrest = unrest or _largest_change(change, own.sizes((s, a)), names, span)
            if unrest.change > REST:
                return unrest
            fix = f"leave out actuators with {argument('direct', True)}, or e.g. {argument('off', ['dead zone'])}"
            raise InputError("linearise", "the loop is not differentiable at rest", fix=fix)
        whole = np.eye(len(A[0]))
        for Aj, Bj, Cj in zip(A, B, C, strict=True):
            whole = Aj @ whole + Bj @ (Cj @ whole)
        idle = _idle_states(A, C, whole) | _clocks(A, B, change)
        keep = ~idle
        change = np.where(keep, change, 0.0)
        now = _largest_change(change, own.sizes((s, a)), names, span)
        if now.change <= REST:
            _refuse_corner(run, own, s, a, t, count, whole, keep)
            return s, a, t, idle, (A, B, C)
        unrest = unrest or now
        M = whole[np.ix_(keep, keep)]
        new = np.zeros(len(keep))
        new[keep] = np.linalg.lstsq(np.eye(len(M)) - M, change[keep], rcond=1e-12)[0]
        s, a = own.displace((s, a), jnp.asarray(new))
        s, a, t = run.fly(s, a, t, count)
    assert unrest is not None
    return unrest


def _largest_change(change: Any, sizes: Any, names: Sequence[str], span: int) -> _Unrest:
    """Return the state that changes most in one period. A state that is not finite counts as an infinite change."""
    relative = np.abs(change / np.maximum(1.0, sizes))
    relative = np.where(np.isfinite(relative), relative, np.inf)
    i = int(relative.argmax())
    name = side_name(names[i])
    finite = math.isfinite(relative[i])
    text = f"{name} changes by {change[i]:.3g} in {to_seconds(span):g} s" if finite else f"{name} is not finite"
    return _Unrest(float(relative[i]), text)


def _refuse_corner(
    run: LoopStep, own: LoopCoordinates, s: Any, a: Any, t: int, count: int, whole: Any, keep: Any
) -> None:
    """Raise InputError if the loop has different slopes on both sides of rest."""

    def end(z: Any) -> Any:
        s1, a1, _ = run.fly(*own.displace((s, a), jnp.asarray(z)), t, count)
        return np.asarray(own.deviation((s, a), run.align(s1, a1, count * run.tick)))

    rest = end(np.zeros(len(keep)))
    names = [side_name(name) for name in own.names((s, a))]
    size = np.maximum(1.0, np.asarray(own.sizes((s, a))))
    corner = find_loop_corner(lambda z: end(z) - rest, whole, size, keep, names)
    if corner is not None:
        fix = f"leave out actuators with {argument('direct', True)}, or e.g. {argument('off', ['dead zone'])}"
        raise InputError("linearise", f"the loop has no slope at rest: {corner}", fix=fix)


def _clocks(A: Any, B: Any, change: Any) -> Any:
    """Return a mask (n,) of clocks, i.e. states that grow independently of all other states, e.g. the time in a law.

    A loop can be at rest although its clocks advance.
    """
    alone = (np.array([np.eye(len(change))] * len(A)) == A).all(axis=(0, 2)) & (B == 0).all(axis=(0, 2))
    return alone & (np.abs(change) > 0)


def side_name(name: str) -> str:
    """Return the path of a state, which begins with "s" for a state of the world and "a" for one of the autopilot."""
    return f"{'sa'[int(name[0])]}{name[1:]}"


def _idle_states(A: Any, C: Any, whole: Any) -> Any:
    """Return a mask (n,) of states on which no command depends, e.g. the position.

    If one of these states is unstable, all elements of the mask are False, so that the instability is not hidden.
    """
    matters = np.abs(C).max(axis=(0, 1)) > 0
    feeds = np.abs(A).max(axis=0) > 0
    while (more := matters | feeds[matters].any(axis=0)).sum() > matters.sum():
        matters = more
    idle = ~matters
    grows = np.abs(np.linalg.eigvals(whole[np.ix_(idle, idle)])).max(initial=0.0) > 1 + STABLE
    return np.zeros_like(idle) if grows else idle
