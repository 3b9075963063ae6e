"""Dilution of precision of a constellation of beacons over the floor.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record

CONE = math.pi / 4
REACH = 9.144


@record
class DilutionMap:
    """Horizontal dilution of precision over the floor: error of a position fix relative to the error of a range.

    Frames:  W.    Source:  Langley, "Dilution of precision", GPS World, May 1999; cone and reach: [1] section 5.5.
    """

    north: Any = quantity("m", "North coordinates of the grid's rows (a,).", frame="W")
    east: Any = quantity("m", "East coordinates of the grid's columns (b,).", frame="W")
    dilution: Any = quantity("1", "Dilution sqrt(trace((H'H)^-1)) (a, b); infinite where no position fix is possible.")
    visible: Any = quantity("1", "Number of beacons whose range and cone include each grid point (a, b).", kind="count")
    beacons: Any = quantity("m", "Positions of the beacons (n, 3).", frame="W")
    down: Scalar = quantity("m", "Down coordinate of the ultrasonic unit.", frame="W")

    def coverage(self, limit: float = 2.0) -> float:
        """Return the fraction of the map, 0 to 1, in which the dilution is at most `limit`."""
        return float(np.mean(np.asarray(self.dilution) <= limit))


def dilution(directions: Any, visible: Any, *, common_error: bool = False) -> Any:
    """Return sqrt(trace((H'H)^-1)) of the horizontal position, for unit error of each range.

    Args:
        directions: derivatives of each range by north and east (..., n, 2), i.e. horizontal parts of the unit vectors.
        visible: True for each available range (..., n).
        common_error: True to also estimate an error common to all ranges, as the closed-form solution does.

    Returns: dilution (...), infinite where the ranges don't determine a position.
    """
    H = np.where(visible[..., None], directions, 0.0)
    if common_error:
        H = np.concatenate([H, visible[..., None].astype(np.float64)], axis=-1)
    information = np.swapaxes(H, -1, -2) @ H
    solvable = np.linalg.matrix_rank(information, hermitian=True, tol=1e-9) == information.shape[-1]
    safe = np.where(solvable[..., None, None], information, np.eye(information.shape[-1]))
    covariance = np.linalg.inv(safe)
    values = np.sqrt(covariance[..., 0, 0] + covariance[..., 1, 1])
    return np.where(solvable, values, np.inf)


def dilution_map(
    beacons: Any,
    north: Any,
    east: Any,
    *,
    down: float = 0.0,
    cone: float = CONE,
    reach: float = REACH,
    common_error: bool = False,
) -> DilutionMap:
    """Compute the dilution over a grid of positions on the floor.

    Args:
        beacons: positions in W (m), shape (n, 3).
        north: north coordinates of the grid's rows (m), shape (a,).
        east: east coordinates of the grid's columns (m), shape (b,).
        down: down coordinate of the ultrasonic unit (m).
        cone: half the opening angle (rad) of each beacon's cone, whose axis points straight down.
        reach: longest range (m).
        common_error: as in `dilution`.
    """
    beacons = np.asarray(beacons, np.float64)
    if beacons.ndim != 2 or beacons.shape[1] != 3:
        fix = "give one row (north, east, down) for each beacon"
        raise InputError("dilution_map.beacons", f"must have shape (n, 3), got {beacons.shape}", fix=fix)
    north, east = np.asarray(north, np.float64), np.asarray(east, np.float64)
    N, E = np.meshgrid(north, east, indexing="ij")
    line = np.stack([N, E, np.full_like(N, down)], axis=-1)[:, :, None] - beacons
    distance = np.linalg.norm(line, axis=-1)
    safe = np.maximum(distance, 1e-9)
    visible = (distance <= reach) & (np.arccos(np.clip(line[..., 2] / safe, -1, 1)) <= cone)
    values = dilution(line[..., :2] / safe[..., None], visible, common_error=common_error)
    return DilutionMap(north, east, values, visible.sum(-1).astype(np.int32), beacons, down)
