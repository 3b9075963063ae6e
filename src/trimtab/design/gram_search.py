"""Search for Gram matrices that prove a polynomial claim.

    conclusion = z'G z + sum of y'S y * hypothesis,   G and S positive definite

The entries of z and y are single terms in suitable coordinates. A solver finds G and S in floats. G and S are then
rounded and adjusted to satisfy the identity exactly. `squares` checks the result independently.

Source: [1] H. Peyrl, P. A. Parrilo, "Computing sum of squares decompositions with rational coefficients", Theoretical
Computer Science 409 (2008).
"""

from collections.abc import Mapping
from fractions import Fraction
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np

from trimtab.design.lmi import minimise, symmetric_matrix
from trimtab.design.polynomial import Monomial, Polynomial, constant, multiply_monomials
from trimtab.design.squares import Claim, GramForm, SquaresProof

DIGITS = 7
"""Number of decimals to which the solver's result is rounded."""


class GramSearch(NamedTuple):
    """Coordinates and terms for a search for Gram matrices.

    states: state -> polynomial in the coordinates.  coordinates: coordinate -> polynomial in the states.  forms: name
    of a hypothesis -> entries of y, single terms in the coordinates; the name "" -> entries of z.
    """

    states: Mapping[str, Polynomial]
    coordinates: Mapping[str, Polynomial]
    forms: Mapping[str, tuple[Polynomial, ...]]


def find_gram_proof(claim: Claim, search: GramSearch) -> SquaresProof:
    """Find a proof of a claim that has no free parameters; raise ArithmeticError if the solver finds no proof."""
    z = [_as_monomial(form) for form in search.forms[""]]
    pairs: dict[Monomial, list[tuple[int, int]]] = {}
    for i, j in combinations_with_replacement(range(len(z)), 2):
        pairs.setdefault(multiply_monomials(z[i], z[j]), []).append((i, j))
    base = _spread_terms(claim.conclusion.substitute(search.states), pairs, len(z))
    moves = [_kernel_matrix(p, k, len(z)) for p in pairs.values() for k in range(1, len(p))]
    blocks, sizes = [], {name: len(forms) for name, forms in search.forms.items() if name}
    for name in sizes:
        hypothesis, forms = claim.hypotheses[name].substitute(search.states), search.forms[name]
        for a, b in combinations_with_replacement(forms, 2):
            product = a * b * hypothesis * (1 if a == b else 2)
            blocks.append(-_spread_terms(product, pairs, len(z)))
    found = _solve_margin(base, [*moves, *blocks], list(sizes.values()), len(moves))
    values = [Fraction(f"{v:.{DIGITS}f}") for v in found]
    G = sum((M * v for M, v in zip([*moves, *blocks], values, strict=True)), base)
    terms, at = [GramForm("", _in_states(search, ""), G)], len(moves)
    for name, n in sizes.items():
        S = np.full((n, n), Fraction(0), object)
        for i, j in combinations_with_replacement(range(n), 2):
            S[i, j] = S[j, i] = values[at]
            at += 1
        terms.append(GramForm(name, _in_states(search, name), S))
    return SquaresProof(constant(1), tuple(terms))


def _solve_margin(base: Any, moves: list[Any], sizes: list[int], first: int) -> Any:
    """Return the variables, in floats, that maximise the smallest eigenvalue of all Gram matrices."""
    start, steps, count = base.astype(float), np.array(moves).astype(float), len(moves)

    def inner(x: Any, k: int) -> Any:
        low = first + sum(n * (n + 1) // 2 for n in sizes[:k])
        n = sizes[k]
        return symmetric_matrix(x[low : low + n * (n + 1) // 2], n) - x[-1] * np.eye(n)

    matrices: list[Any] = [lambda x: start + np.tensordot(x[:-1], steps, 1) - x[-1] * np.eye(len(start))]
    matrices += [lambda x, k=k: inner(x, k) for k in range(len(sizes))]
    matrices.append(lambda x: np.array([[1.0 - x[-1]]]))
    solution = minimise(lambda x: -x[-1], matrices, count + 1)
    if solution.status != "Solved" or not solution.x[-1] > 10.0**-DIGITS * len(base):
        raise ArithmeticError(f"the solver found no positive definite Gram matrices: {solution.status}")
    return solution.x[:-1]


def _spread_terms(p: Polynomial, pairs: Mapping[Monomial, list[tuple[int, int]]], n: int) -> Any:
    """Return a Gram matrix of a polynomial; raise ArithmeticError if a term is not a product of two entries of z."""
    G = np.full((n, n), Fraction(0), object)
    for m, c in p.terms.items():
        if m not in pairs:
            raise ArithmeticError(f"the term {Polynomial({m: c})} is not a product of two forms")
        i, j = pairs[m][0]
        G[i, j] = G[j, i] = c if i == j else c / 2
    return G


def _kernel_matrix(pairs: list[tuple[int, int]], k: int, n: int) -> Any:
    """Return a change of G that does not change z'G z: it moves a term from the first to the k-th of the index pairs of
    z that have the same product."""
    G = np.full((n, n), Fraction(0), object)
    for (i, j), sign in ((pairs[0], -1), (pairs[k], 1)):
        G[i, j] = G[j, i] = Fraction(sign) if i == j else Fraction(sign, 2)
    return G


def _as_monomial(form: Polynomial) -> Monomial:
    ((m, _),) = form.terms.items()
    return m


def _in_states(search: GramSearch, name: str) -> tuple[Polynomial, ...]:
    return tuple(form.substitute(search.coordinates) for form in search.forms[name])
