"""Region of attraction: a quadratic Lyapunov function V, and the largest level c for which it can be proved.

The proof consists of matrices S and G with

    -dV/dt - s(x) (c - V(x)) = z'G z,   s = x'S x,   S and G positive definite,   z = (x, products of x)

so that V falls wherever V <= c, except at the equilibrium (S-procedure of sums of squares). V solves the Lyapunov
equation of the linear loop. The weight in this equation is varied to maximise the volume of the region V <= c. A solver
finds S and G in floats. S and G are then rounded to fractions that satisfy the identity exactly, so that the proof does
not depend on the search.

Source: [1] P. A. Parrilo, "Semidefinite programming relaxations for semialgebraic problems", Math. Programming 96
(2003); [2] H. Peyrl, P. A. Parrilo, "Computing sum of squares decompositions with rational coefficients", Theoretical
Computer Science 409 (2008), for the rounding; [3] H. K. Khalil, "Nonlinear Systems", Prentice Hall 2002, section 8.2.
"""

from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize

from trimtab.core.errors import InputError, argument
from trimtab.design.lmi import minimise, symmetric_matrix
from trimtab.design.polynomial import Monomial, Polynomial, constant, multiply_monomials, symbol
from trimtab.design.squares import GramForm, SquaresProof
from trimtab.design.theorem import FALLS, GROWS, INSIDE, LawTheorem

SMALLEST_MARGIN = 1e-4
"""Smallest eigenvalue that the scaled matrices S and G must have, so that a level of V counts as proved. The margin
allows for rounding S and G to fractions."""
DIGITS = 7
"""Number of decimals to which the scaled matrices S and G are rounded."""
TRIES = 200
"""Default number of Lyapunov functions V that the search tries."""
ROUGH, FINE = 1.03, 1.002
"""Accuracy of a level of V, as a ratio: ROUGH while Lyapunov functions are compared, FINE for the result."""


class AttractionRegion(NamedTuple):
    """Region of attraction V <= c: V, the level c, proofs that V > 0 and dV/dt < 0, and the region's half widths."""

    lyapunov: Polynomial
    level: Fraction
    proofs: dict[str, SquaresProof]
    extents: dict[str, float]


class _Loop(NamedTuple):
    """Closed loop in deviations from rest. names: state names.  field: state derivatives.  A: Jacobian at rest."""

    names: tuple[str, ...]
    field: dict[str, Polynomial]
    A: Any


def find_region(theorem: LawTheorem, *, tries: int = TRIES) -> AttractionRegion:
    """Find a large region of attraction of a loop whose state derivatives are polynomials of degree at most 3.

    Args:
        theorem: theorem that contains the state derivatives and the equilibrium.
        tries: number of Lyapunov functions V to try.

    Raises: InputError if the linear loop is not stable, or the derivatives contain symbolic parameters or powers
        above 3.
    """
    loop, n = _shift_loop(theorem), len(theorem.region.states)
    start, guess = np.zeros(n * (n + 1) // 2), 1.0

    def lack_volume(z: Any) -> float:
        nonlocal guess
        level = _largest_level(loop, _lyapunov_matrix(loop, z), guess, ROUGH)
        guess = level or guess
        return -level

    simplex = np.vstack([start, 0.8 * np.eye(len(start))])
    options = {"maxfev": tries, "initial_simplex": simplex, "fatol": 1e-2, "xatol": 1e-2}
    shape: Any = minimize(lack_volume, start, method="Nelder-Mead", options=options).x
    P = _lyapunov_matrix(loop, shape)
    level = _largest_level(loop, P, guess, FINE)
    if level <= 0:
        raise InputError(
            "region",
            "no quadratic Lyapunov function V could be proved to fall near the equilibrium",
            fix=f"change a gain: {argument('settings', 'VALUE', 'NAME')}",
        )
    return _round_region(theorem, loop, P, level)


def _shift_loop(theorem: LawTheorem) -> _Loop:
    names, rest = theorem.region.states, theorem.region.rest
    field = {n: f.substitute({k: symbol(k) + rest[k] for k in names}) for n, f in theorem.field.items()}
    outside = sorted({name for f in field.values() for name in f.names} - set(names))
    powers = [sum(p for _, p in m) for f in field.values() for m in f.terms]
    if outside or max(powers) > 3:
        problem = (
            f"these parameters have no value: {', '.join(outside)}"
            if outside
            else "the loop has powers of states above 3"
        )
        raise InputError("region", problem, fix="give every parameter a number, and use a law of degree at most 3")
    A = np.array([[float(f.terms.get(((k, 1),), 0)) for k in names] for f in field.values()])
    fast = np.linalg.eigvals(A).real.max()
    if fast >= 0:
        raise InputError(
            "region",
            f"the linear loop is not stable: a pole has the real part {fast:.4g} 1/s",
            fix=f"change a gain: {argument('settings', 'VALUE', 'NAME')}",
        )
    return _Loop(names, field, A)


def _lyapunov_matrix(loop: _Loop, z: Any) -> Any:
    """Solve Lyapunov's equation for P with the weight L L', and scale P to determinant 1.

    z: elements of the lower triangle of L. Diagonal elements of L are given by their logarithms.
    """
    L = np.zeros_like(loop.A)
    L[np.tril_indices(len(L))] = z
    np.fill_diagonal(L, np.exp(np.diag(L)))
    P: Any = solve_continuous_lyapunov(loop.A.T, -(L @ L.T))
    return (P + P.T) / 2 / np.linalg.det(P) ** (1 / len(P))


def _largest_level(loop: _Loop, P: Any, guess: float, ratio: float) -> float:
    """Return the largest provable level of V, accurate to the factor `ratio`, or 0 if no level near `guess` is
    provable."""

    def is_reached(level: float) -> bool:
        return _margin(loop, P, level, np.sqrt(level / np.diag(P))).margin > SMALLEST_MARGIN

    low, high = guess, guess
    while is_reached(high) and high < 1e9 * guess:
        low, high = high, 1.5 * high
    while low == high or not is_reached(low):
        low, high = low / 1.5, low
        if low < 1e-9 * guess:
            return 0.0
    while high / low > ratio:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if is_reached(middle) else (low, middle)
    return low


class _Solution(NamedTuple):
    """Result of the solver. margin: smallest eigenvalue of the matrices S and G.  S: matrix (n, n).  kernel: free
    parameters of G, which do not change z'G z."""

    margin: float
    S: Any
    kernel: Any


class _Products(NamedTuple):
    """Products of states. z: monomials (x, products of x).  pairs: monomial -> index pairs of z with this product."""

    z: tuple[Monomial, ...]
    pairs: dict[Monomial, list[tuple[int, int]]]


@lru_cache(maxsize=8)
def _form_products(names: tuple[str, ...]) -> _Products:
    singles = tuple(((n, 1),) for n in names)
    z = singles + tuple(multiply_monomials(a, b) for a, b in combinations_with_replacement(singles, 2))
    pairs: dict[Monomial, list[tuple[int, int]]] = {}
    for i, j in combinations_with_replacement(range(len(z)), 2):
        pairs.setdefault(multiply_monomials(z[i], z[j]), []).append((i, j))
    return _Products(z, pairs)


def _gram_matrix(coefficients: Mapping[Monomial, Any], kernel: Any, products: _Products, zero: Any) -> Any:
    """Return the matrix G for which z'G z has given coefficients.

    Each coefficient is first divided equally among the pairs of entries of z whose product is the coefficient's
    monomial. The entries of `kernel` then move parts of a coefficient from one pair to another.
    """
    G = np.full((len(products.z),) * 2, zero, dtype=object if isinstance(zero, Fraction) else float)
    used = 0
    for m, pairs in products.pairs.items():
        values = [coefficients.get(m, zero) / len(pairs)] * len(pairs)
        for k in range(1, len(pairs)):
            values[k], values[0] = values[k] + kernel[used], values[0] - kernel[used]
            used += 1
        for (i, j), value in zip(pairs, values, strict=True):
            G[i, j] = G[j, i] = value if i == j else value / 2
    return G


@lru_cache(maxsize=8)
def _kernel_matrices(names: tuple[str, ...]) -> list[Any]:
    """Return matrices G with z'G z = 0, one for each degree of freedom of G."""
    products = _form_products(names)
    units = np.eye(sum(len(p) - 1 for p in products.pairs.values()))
    return [_gram_matrix({}, unit, products, 0.0) for unit in units]


def _margin(loop: _Loop, P: Any, level: float, size: Any) -> _Solution:
    """Return the solution that maximises the smallest eigenvalue of S and G for the region V <= level, in the scaled
    state y = x/size."""
    falls, inside = _scale_parts(loop, P, level, size)
    products, n, count, moves = _form_products(loop.names), len(P), len(inside), _kernel_matrices(loop.names)
    still = np.zeros(len(moves))
    base = _gram_matrix(falls, still, products, 0.0)
    moves = np.array([-_gram_matrix(part, still, products, 0.0) for part in inside] + moves)
    blocks = [
        lambda x: base + np.tensordot(x[:-1], moves, 1) - x[-1] * np.eye(len(base)),
        lambda x: symmetric_matrix(x[:count], n) - x[-1] * np.eye(n),
        lambda x: np.array([[1.0 - x[-1]]]),
    ]
    solution = minimise(lambda x: -x[-1], blocks, len(moves) + 1)
    margin = float(solution.x[-1]) if solution.status == "Solved" else -np.inf
    return _Solution(margin, symmetric_matrix(solution.x[:count], n), solution.x[count:-1])


def _scale_parts(loop: _Loop, P: Any, level: Any, size: Any) -> tuple[dict[Monomial, Any], list[dict[Monomial, Any]]]:
    """Return the coefficients of the polynomials in the proof of the region V <= level, in the scaled state y = x/size.

    The first result belongs to -(dV/dt)/level. The second result is a list with one entry for each element (i, j) of
    the upper triangle of S: the polynomial by which this element is multiplied in s (1 - V/level), which is
    y_i y_j (1 - V/level) for i = j and twice this polynomial otherwise. The results are floats for float arguments, and
    Fractions for Fractions.
    """
    singles, one = [((name, 1),) for name in loop.names], P[0, 0] / P[0, 0]
    scaled, number = P * size * size[:, None] / level, Fraction if isinstance(one, Fraction) else float
    falls: dict[Monomial, Any] = {}
    for i, rate in enumerate(loop.field.values()):
        for m, c in rate.terms.items():
            slope = number(c) / size[i]
            for name, power in m:
                slope = slope * size[loop.names.index(name)] ** power
            for j, single in enumerate(singles):
                product = multiply_monomials(m, single)
                falls[product] = falls.get(product, 0 * one) - 2 * scaled[i, j] * slope
    inside = []
    for i, j in combinations_with_replacement(range(len(P)), 2):
        first, twice = multiply_monomials(singles[i], singles[j]), one if i == j else 2 * one
        part = {first: twice}
        for (a, b), value in np.ndenumerate(scaled):
            product = multiply_monomials(first, multiply_monomials(singles[a], singles[b]))
            part[product] = part.get(product, 0 * one) - twice * value
        inside.append(part)
    return falls, inside


def _round_region(theorem: LawTheorem, loop: _Loop, P: Any, level: float) -> AttractionRegion:
    """Round V, c and S to short fractions, and compute a G that satisfies the identity exactly."""
    products, unit = _form_products(loop.names), 10.0 ** np.floor(np.log10(np.abs(P).max()))
    P, c = _shorten_all(P / unit, 4), Fraction(f"{0.99 * level / unit:.3g}")
    rough = P.astype(float)
    size = np.array([Fraction(f"{v:.2g}") for v in np.sqrt(float(c) / np.diag(rough))], object)
    solution = _margin(loop, rough, float(c), size.astype(float))
    S, kernel = _shorten_all(solution.S, DIGITS), _shorten_all(solution.kernel, DIGITS)
    falls, inside = _scale_parts(loop, P, c, size)
    for part, weight in zip(inside, S[np.triu_indices(len(P))], strict=True):
        for m, value in part.items():
            falls[m] = falls.get(m, Fraction(0)) - weight * value
    G = _gram_matrix(falls, kernel, products, Fraction(0))
    deviations = {n: symbol(n) - theorem.region.rest[n] for n in loop.names}
    y = tuple(deviations[n] / constant(s) for n, s in zip(loop.names, size, strict=True))
    z = tuple(Polynomial({m: Fraction(1)}).substitute(dict(zip(loop.names, y, strict=True))) for m in products.z)
    whole, scale = GramForm("", tuple(deviations.values()), P), constant(1)
    falling = SquaresProof(scale, (GramForm("", z, c * G), GramForm(INSIDE, y, S)))
    extents = np.sqrt(float(c) * np.diag(np.linalg.inv(rough)))
    proofs = {GROWS: SquaresProof(scale, (whole,)), FALLS: falling}
    return AttractionRegion(whole.value(), c, proofs, dict(zip(loop.names, extents.tolist(), strict=True)))


def _shorten_all(values: Any, digits: int) -> Any:
    """Round floats to a number of decimals, and return them as fractions."""
    return np.vectorize(lambda v: Fraction(f"{v:.{digits}f}"), otypes=[object])(values)
