"""The boundary of a region in the plane, traced by refining only the cells through which it passes.

Source: R. A. Finkel, J. L. Bentley, "Quad trees: a data structure for retrieval on composite keys", Acta Informatica 4
(1974), for the tree. The rule by which cells are split, with what neighbours have found on their edges: this module.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError

Cell = tuple[int, int, int]
"""Lower corner and size, in steps of the finest lattice."""
DEEPEST = 12


class Traced(NamedTuple):
    """What was found on a lattice of `shape` points, of which only some were looked at.

    index: (n, 2) lattice points, in the order in which they were looked at.  value: (n,), in [0, 1].  round: (n,) in
    which call each was made, from 0.  cells: (k, 3) lower corner and size of the cells that tile the lattice.
    threshold: a point is inside where its value is at least that.
    """

    shape: tuple[int, int]
    index: Any
    value: Any
    round: Any
    cells: Any
    threshold: float

    @property
    def looked_at(self) -> int:
        """How many points were needed."""
        return len(self.index)

    @property
    def of(self) -> int:
        """How many points a full grid of the same resolution has."""
        return self.shape[0] * self.shape[1]

    def grid(self) -> Any:
        """The values on the whole lattice, NaN where nothing was looked at."""
        whole = np.full(self.shape, np.nan)
        whole[self.index[:, 0], self.index[:, 1]] = self.value
        return whole

    def boundary(self) -> Any:
        """The cells through which the boundary passes (k, 3): points both inside and outside on their edges."""
        inside, known = self.grid() >= self.threshold, ~np.isnan(self.grid())
        mixed = [_mixed(inside, known, c) for c in self.cells.tolist()]
        return self.cells[np.array(mixed, bool)]

    def changes(self, line: int, axis: int = 0) -> list[tuple[int, int]]:
        """Pairs of neighbouring known points between which a line along `axis` passes the boundary.

        line: the lattice index on the other axis; one of the coarse grid's, or few of its points are known.
        """
        values = self.grid().take(line, axis=1 - axis)
        known = np.flatnonzero(~np.isnan(values))
        inside = values[known] >= self.threshold
        return [(int(known[i]), int(known[i + 1])) for i in np.flatnonzero(inside[1:] != inside[:-1])]


def trace(values: Callable[[Any], Any], coarse: tuple[int, int], depth: int, *, threshold: float = 0.5) -> Traced:
    """Look at a coarse grid, then only at the cells on whose edges there are points both inside and outside.

    Each of `depth` levels halves those cells; all their new points are asked for in one call. Where a new point on an
    edge shows that the boundary runs into the neighbour, the neighbour is split too, in a further call. What lies
    between the points of the coarse grid and touches none of them is not seen.

    Args:
        values: lattice points (k, 2) -> their values (k,).
        coarse: points of the coarse grid along both axes, 2 or more each.
        depth: how often a cell is halved; the lattice has (c - 1) 2^depth + 1 points along an axis.
        threshold: a point is inside where its value is at least that.
    """
    check_grid(coarse, depth)
    size = 2**depth
    shape = ((coarse[0] - 1) * size + 1, (coarse[1] - 1) * size + 1)
    inside, known = np.zeros(shape, bool), np.zeros(shape, bool)
    found: list[tuple[Any, Any]] = []

    def look(points: Any) -> None:
        if len(points):
            got = np.asarray(values(points), float)
            found.append((points, got))
            known[points[:, 0], points[:, 1]] = True
            inside[points[:, 0], points[:, 1]] = got >= threshold

    starts = [(i, j) for i in range(0, shape[0], size) for j in range(0, shape[1], size)]
    look(np.array(starts))
    cells: list[Cell] = [(i, j, size) for i, j in starts if i + size < shape[0] and j + size < shape[1]]
    while size > 1:
        size //= 2
        while True:
            split = [c for c in cells if c[2] > size and _mixed(inside, known, c)]
            if not split:
                break
            gone = set(split)
            cells = [c for c in cells if c not in gone] + [q for c in split for q in _quarters(c)]
            look(np.array(sorted({p for c in split for p in _nodes(c) if not known[p]})).reshape(-1, 2))
    index, value = (np.concatenate([f[k] for f in found]) for k in (0, 1))
    rounds = np.repeat(np.arange(len(found)), [len(f[0]) for f in found])
    return Traced(shape, index, value, rounds, np.array(cells), threshold)


def check_grid(coarse: tuple[int, int], depth: int) -> None:
    """Refuse a coarse grid of less than a cell, and a depth beyond all use."""
    if min(coarse) < 2 or not 0 <= depth <= DEEPEST:
        problem = f"a coarse grid of {coarse[0]} x {coarse[1]} points and depth {depth}"
        raise InputError(
            "boundary", problem, fix=f"give 2 points or more along each axis, and a depth of 0 to {DEEPEST}"
        )


def _mixed(inside: Any, known: Any, cell: Cell) -> bool:
    """Whether known points on the edges of a cell, in which nothing else is known, lie on both sides."""
    i, j, size = cell
    at = (slice(i, i + size + 1), slice(j, j + size + 1))
    seen = inside[at][known[at]]
    return bool(seen.any() and not seen.all())


def _quarters(cell: Cell) -> list[Cell]:
    i, j, size = cell
    h = size // 2
    return [(i, j, h), (i + h, j, h), (i, j + h, h), (i + h, j + h, h)]


def _nodes(cell: Cell) -> list[tuple[int, int]]:
    """Middle of a cell and of its edges."""
    i, j, size = cell
    h = size // 2
    return [(i + h, j), (i, j + h), (i + h, j + h), (i + size, j + h), (i + h, j + size)]
