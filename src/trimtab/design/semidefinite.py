"""Linear objective under linear matrix inequalities, solved by Clarabel.

The inequalities are given as functions; being affine, they are known from their values at zero and at the unit vectors.
Clarabel comes with the extra `design` and is imported when something is solved. Offline code.

Source: [1] P. J. Goulart, Y. Chen, "Clarabel: an interior-point solver for conic programs with quadratic objectives",
arXiv 2405.12762, 2024; cone of positive semidefinite triangles as in its manual.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from trimtab.core.errors import InputError

Block = Callable[[Any], Any]
"""Variables (k,) -> symmetric matrix that must be positive semidefinite, affine."""


class Solved(NamedTuple):
    """What the solver found.

    x: variables (k,).  status: the solver's word, e.g. "Solved", "PrimalInfeasible".  objective: at x.  margins:
    smallest eigenvalue of each block at x.  iterations: how many.
    """

    x: Any
    status: str
    objective: float
    margins: tuple[float, ...]
    iterations: int

    @property
    def good(self) -> bool:
        """Whether the solver says it is solved, to its full or to its reduced tolerance."""
        return self.status in ("Solved", "AlmostSolved")


def minimise(objective: Callable[[Any], Any], blocks: Sequence[Block], k: int) -> Solved:
    """The variables (k,) that make an affine objective least while every block is positive semidefinite.

    Args:
        objective: (k,) -> number, affine.
        blocks: the matrix inequalities.
        k: number of variables.

    Source: [1].
    """
    clarabel = _solver()
    zero, units = np.zeros(k), np.eye(k)
    constant = float(objective(zero))
    q = np.array([float(objective(e)) - constant for e in units])
    rows, right, cones = [], [], []
    for block in blocks:
        base = _triangle(block(zero))
        rows.append(np.column_stack([base - _triangle(block(e)) for e in units]))
        right.append(base)
        cones.append(clarabel.PSDTriangleConeT(len(block(zero))))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    A = csc_matrix(np.vstack(rows))
    found = clarabel.DefaultSolver(csc_matrix((k, k)), q, A, np.concatenate(right), cones, settings).solve()
    x = np.array(found.x)
    finite = bool(np.isfinite(x).all())
    margins = tuple(float(np.linalg.eigvalsh(block(x))[0]) if finite else float("nan") for block in blocks)
    return Solved(x, str(found.status), float(q @ x + constant), margins, int(found.iterations))


def violation(blocks: Sequence[Block], k: int) -> float:
    """The least t for which every block plus t I can be positive semidefinite; above 0: the blocks contradict.

    It is bounded below by -1.
    """
    lifted: list[Block] = [lambda z, f=f: f(z[:-1]) + z[-1] * np.eye(len(f(z[:-1]))) for f in blocks]
    return minimise(lambda z: z[-1], [*lifted, lambda z: np.array([[z[-1] + 1.0]])], k + 1).objective


def symmetric(values: Any, n: int) -> Any:
    """The symmetric matrix (n, n) whose upper triangle, row by row, is values (n (n + 1)/2,)."""
    made = np.zeros((n, n))
    made[np.triu_indices(n)] = values
    return made + np.triu(made, 1).T


def _triangle(M: Any) -> Any:
    """Upper triangle column by column, off the diagonal times sqrt 2, as Clarabel takes it."""
    rows, columns = np.tril_indices(len(M))
    return np.asarray(M)[columns, rows] * np.where(rows == columns, 1.0, np.sqrt(2.0))


def _solver() -> Any:
    try:
        import clarabel
    except ImportError as error:
        fix = "pip install -c constraints.txt -e '.[design]', or take the method lqr, which needs no solver"
        raise InputError("design", "the solver Clarabel is not installed", fix=fix) from error
    return clarabel
