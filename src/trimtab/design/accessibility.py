"""Accessibility by Lie brackets, and a sufficient condition for small-time local controllability.

Model: x' = f(x) + sum g_j(x) u_j about an equilibrium. If the brackets of f and the g_j span all directions, the states
reached in any short time fill a set with interior points (accessible). A bracket is bad if it contains f an odd number
of times and each g_j an even number of times. If in addition every bad bracket is a combination of brackets of lower
degree, these states fill a neighbourhood of the point (small-time locally controllable, STLC). The second condition is
sufficient, not necessary. This code runs offline.

Source: [1] A. Isidori, "Nonlinear Control Systems", Springer 1995, chapter 2; [2] H. J. Sussmann, "A general theorem on
local controllability", SIAM J. Control Optim. 25 (1987), theorem 7.3, with all weights 1.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.lie import curved_inputs
from trimtab.design.model import StateSpaceModel

HIGHEST_DEGREE = 5
"""Default maximum degree of a Lie bracket, i.e. the number of vector fields in the bracket."""
AT_REST = 1e-8
"""Largest state derivative that counts as zero, relative to max(1, |x|). The tolerance allows for rounding errors of a
trim."""
ROUNDING = 1e-9
"""Largest polynomial coefficient that counts as zero, as a fraction of the largest coefficient."""
INDEPENDENT = 1e-7
"""Smallest fraction of a Lie bracket's length that must be linearly independent of the earlier brackets, so that the
bracket counts as a new direction."""
DRIFT = "f"
TaylorField = dict[tuple[int, ...], Any]
"""Taylor polynomial of a vector field, as a mapping from powers of the states' deviations to coefficients (n,)."""


class LieBracket(NamedTuple):
    """Lie bracket and its value at the equilibrium.

    name: e.g. "[FY, [f, FY]]".  degree: number of vector fields in the bracket.  value: (n,).  is_bad: True if the
    bracket contains f an odd number of times and each input an even number of times.
    """

    name: str
    degree: int
    value: Any
    is_bad: bool


class Accessibility(NamedTuple):
    """Result of the accessibility test.

    basis: brackets that each add a new direction, by degree.  rank: number of brackets in the basis.  n: number of
    states.  bad: bad brackets that do not vanish, up to the degree at which the basis is complete.  obstructions: bad
    brackets that are not a combination of brackets of lower degree.  curved: inputs in which the model is not affine
    and was linearised.  is_accessible: True if the brackets span all directions.  is_stlc: True if small-time local
    controllability is proved; if False, the question stays open.  is_linear: True if the linear model is controllable,
    so that no other brackets were computed.
    """

    basis: tuple[LieBracket, ...]
    rank: int
    n: int
    bad: tuple[LieBracket, ...]
    obstructions: tuple[LieBracket, ...]
    curved: tuple[str, ...]
    is_accessible: bool
    is_stlc: bool
    is_linear: bool


def find_accessibility(
    model: StateSpaceModel, x: Any = None, u: Any = None, *, highest: int = HIGHEST_DEGREE
) -> Accessibility:
    """Compute brackets at an equilibrium, by rising degree, until they span all directions or `highest` is reached.

    Args:
        model: model with n states.
        x, u: the equilibrium; default: the model's x0, u0.
        highest: highest degree of a bracket.

    Raises: InputError if the point is not an equilibrium.
    """
    x0, u0 = model.point(x, u)
    check_rest(model, x0, u0)
    linear = _linear_brackets(model, x0, u0)
    if len(linear) == len(x0):
        return Accessibility(linear, len(x0), len(x0), (), (), (), True, True, True)
    n, basis, bad, obstructions = len(x0), [], [], []
    for level in _brackets_by_degree(expand_fields(model, x0, u0, highest - 1), (DRIFT, *model.inputs), n, highest):
        lower = tuple(basis)
        for bracket in level:
            if bracket.is_bad:
                bad.append(bracket)
                if _is_new(bracket.value, lower):
                    obstructions.append(bracket)
            if _is_new(bracket.value, basis):
                basis.append(bracket)
        if len(basis) == n:
            break
    spans, curved = len(basis) == n, tuple(curved_inputs(model, x0, u0))
    stlc = spans and not obstructions
    return Accessibility(tuple(basis), len(basis), n, tuple(bad), tuple(obstructions), curved, spans, stlc, False)


def _linear_brackets(model: StateSpaceModel, x0: Any, u0: Any) -> tuple[LieBracket, ...]:
    """Return the brackets [f, … [f, g]] = ±A^k b of the linear model that each add a new direction.

    States are scaled by their size at the point. The result has n brackets if the linear model is controllable.
    """
    size = np.where(x0 != 0, np.abs(x0), 1.0)
    A, B = (np.asarray(d) for d in jax.jacfwd(model.f, argnums=(0, 1))(jnp.asarray(x0), jnp.asarray(u0)))
    level, basis = [(name, column) for name, column in zip(model.inputs, B.T, strict=True)], []
    units: list[Any] = []
    for degree in range(1, len(x0) + 1):
        for name, value in level:
            left = value / size
            whole = np.linalg.norm(left)
            for unit in (*units, *units):
                left = left - unit * (unit @ left)
            if np.linalg.norm(left) > ROUNDING * whole:
                units.append(left / np.linalg.norm(left))
                basis.append(LieBracket(name, degree, value, False))
        level = [(f"[{DRIFT}, {name}]", -A @ value) for name, value in level]
    return tuple(basis)


def check_rest(model: StateSpaceModel, x0: Any, u0: Any) -> None:
    """Raise InputError if the point is not an equilibrium of the model."""
    rate = np.abs(np.asarray(model.f(jnp.asarray(x0), jnp.asarray(u0))))
    moving = [n for n, r, size in zip(model.states, rate, np.abs(x0), strict=True) if not r <= AT_REST * max(1.0, size)]
    if moving:
        problem = f"the point is not an equilibrium: {', '.join(moving)} would change"
        raise InputError(
            "equilibrium", problem, fix="give x0 and u0 at which f(x0, u0) = 0; trimtab.design.trim finds one"
        )


def expand_fields(model: StateSpaceModel, x0: Any, u0: Any, order: int) -> tuple[TaylorField, ...]:
    """Return Taylor polynomials, up to a given order, of the drift f and of each input's field g_j about a point."""

    def stack_fields(x: Any) -> Any:
        columns = jax.jacfwd(model.f, argnums=1)(x, jnp.asarray(u0))
        return jnp.vstack([model.f(x, jnp.asarray(u0)) - columns @ u0, columns.T])

    derivatives: list[Callable[[Any], Any]] = [stack_fields]
    for _ in range(order):
        derivatives.append(jax.jacfwd(derivatives[-1]))
    every = jax.jit(lambda x: [d(x) for d in derivatives], compiler_options=FAST_COMPILE_OPTIONS)
    tensors = [np.asarray(T) for T in every(jnp.asarray(x0))]
    fields: tuple[TaylorField, ...] = tuple({} for _ in tensors[0])
    for k, T in enumerate(tensors):
        largest = np.abs(T).max(initial=0.0)
        for places in combinations_with_replacement(range(len(x0)), k):
            powers = tuple(places.count(i) for i in range(len(x0)))
            for field, values in zip(fields, T[(..., *places)], strict=True):
                if np.abs(values).max() > ROUNDING * largest:
                    field[powers] = values / math.prod(math.factorial(p) for p in powers)
    return fields


def bracket_fields(X: TaylorField, Y: TaylorField, order: int) -> TaylorField:
    """Return [X, Y] = (dY/dx) X - (dX/dx) Y as a Taylor polynomial up to a given order. Source: [1] section 1.2."""
    total: TaylorField = {}
    size = 0.0
    for sign, inner, outer in ((1.0, X, Y), (-1.0, Y, X)):
        for powers, value in outer.items():
            for i, power in enumerate(powers):
                for others, factor in inner.items() if power else ():
                    degree = sum(powers) + sum(others) - 1
                    if degree <= order and factor[i] != 0:
                        product = tuple(p + q - (j == i) for j, (p, q) in enumerate(zip(powers, others, strict=True)))
                        change = sign * power * factor[i] * value
                        total[product] = total.get(product, 0.0) + change
                        size = max(size, float(np.abs(change).max()))
    return {powers: value for powers, value in total.items() if np.abs(value).max() > ROUNDING * size}


def _brackets_by_degree(
    fields: Sequence[TaylorField], names: Sequence[str], n: int, highest: int
) -> Iterator[list[LieBracket]]:
    """Yield, for each degree, the right-nested brackets that do not vanish at the point. All other brackets are linear
    combinations of these."""
    level = [((i,), names[i], field) for i, field in enumerate(fields)]
    origin = (0,) * n
    for degree in range(1, highest + 1):
        alive = [(word, name, field) for word, name, field in level if field]
        yield [
            LieBracket(name, degree, field[origin], _is_bad(word, len(fields)))
            for word, name, field in alive
            if origin in field and (degree > 1 or word[0] > 0)  # the drift itself is zero at an equilibrium
        ]
        level = [
            ((i, *word), f"[{names[i]}, {name}]", bracket_fields(fields[i], field, highest - degree - 1))
            for word, name, field in alive
            for i in range(len(fields))
            if degree > 1 or i < word[0]
        ]


def _is_bad(word: tuple[int, ...], count: int) -> bool:
    return word.count(0) % 2 == 1 and all(word.count(i) % 2 == 0 for i in range(1, count))


def _is_new(value: Any, others: Sequence[LieBracket]) -> bool:
    """Return True if a vector is linearly independent of the values of the given brackets."""
    if not others:
        return True
    rows = np.array([b.value for b in others])
    size = np.maximum(np.abs(rows).max(axis=0), np.abs(value))
    size = np.where(size > 0, size, 1.0)
    scaled, v = rows / size, value / size
    scaled = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    left = v - np.linalg.lstsq(scaled.T, v, rcond=None)[0] @ scaled
    return bool(np.linalg.norm(left) > INDEPENDENT * np.linalg.norm(v))
