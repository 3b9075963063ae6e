"""Lookup tables on uniform axes, and the tables that convert force to fan speed and fan speed to force.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.actuators.thruster import Thruster
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, quantity, record, replace
from trimtab.core.rotation import DEG

RUDDER_START, RUDDER_STEP, RUDDER_ROWS = -35 * DEG, 5 * DEG, 14
FORCE_MAX, FORCE_STEP = 2.0, 0.025


@record
class BilinearTable:
    """Table of a function of two variables on uniform axes, with bilinear interpolation, constant beyond the edges.

    Source:  [1] chapter 4 for the use of such tables; bilinear interpolation is the textbook formula
             (Press et al., "Numerical recipes", 3rd ed., section 3.6).
    """

    row_start: Scalar = quantity("row", "First coordinate (row axis) of the table at its first row.")
    row_step: Scalar = quantity("row", "Step of the table's first coordinate from row to row.", above=0)
    column_start: Scalar = quantity("column", "Second coordinate (column axis) of the table at its first column.")
    column_step: Scalar = quantity("column", "Step of the table's second coordinate from column to column.", above=0)
    values: Any = quantity("value", "Values of the table (rows, columns), at least (2, 2).")
    origin: str = option(
        "Origin of the table's values. For origin `formula`, a run is refused if the values differ from the "
        "thruster's formula.",
        default="measured",
        choices=("measured", "formula"),
    )

    def check(self) -> None:
        """Raise InputError if the table has fewer than two rows or two columns."""
        shape = np.shape(self.values)
        if len(shape) != 2 or min(shape) < 2:
            problem = f"the table has shape {shape}, but must have at least 2 rows and 2 columns"
            raise InputError("values", problem, fix="give a two-dimensional array")

    def rows(self) -> Any:
        """Return the first coordinate of every row, as an array of shape (rows, 1)."""
        return self.row_start + self.row_step * np.arange(np.shape(self.values)[0])[:, None]

    def columns(self) -> Any:
        """Return the second coordinate of every column, as an array of shape (1, columns)."""
        return self.column_start + self.column_step * np.arange(np.shape(self.values)[1])[None, :]

    def at(self, row: Any, column: Any) -> Any:
        """Return the interpolated value at two scalar coordinates, in the units of the axes. Use vmap for arrays."""
        i, a = _cell((row - self.row_start) / self.row_step, np.shape(self.values)[0])
        j, b = _cell((column - self.column_start) / self.column_step, np.shape(self.values)[1])
        v = lax.dynamic_slice(self.values, (i, j), (2, 2))
        first = v[0, 0] + b * (v[0, 1] - v[0, 0])
        second = v[1, 0] + b * (v[1, 1] - v[1, 0])
        return first + a * (second - first)


def forward_speed_table(thruster: Thruster) -> BilinearTable:
    """Return the table of fan speed (rpm) over rudder angle (rad) and force (0 to 2 N), 14 x 81.

    Source:  [1] chapter 4.
    """
    return _speed_table(thruster, 0.0)


def full_speed_table(thruster: Thruster) -> BilinearTable:
    """Return the table of signed fan speed (rpm) over rudder angle (rad) and force (-2 to 2 N), 14 x 161.

    Source:  [1] chapter 4.
    """
    return _speed_table(thruster, -FORCE_MAX)


def thrust_table(thruster: Thruster, step_rpm: float = 100.0) -> BilinearTable:
    """Return the table of signed force (N) over rudder angle (rad) and signed fan speed (rpm): [1] section 6.1.

    [1] gives no step of the speed. As the thrust is quadratic, the interpolation error at the nodes of the speed table
    is about c step^2/4: 3e-5 N at 100 rpm, 2e-8 N at 2.5 rpm.
    """
    last = float(thruster.speed_max_rpm)
    n = round(2 * last / step_rpm) + 1
    blank = _blank_table(-last, 2 * last / (n - 1), n)
    return replace(blank, values=np.asarray(thruster.force(blank.columns(), blank.rows())))


def check_speed_table(table: BilinearTable, thruster: Thruster) -> None:
    """Raise InputError for a speed table of origin 'formula' whose values differ from this thruster's formula."""
    if table.origin == "formula":
        _check_same(table, _speeds(thruster, table))


def check_thrust_table(table: BilinearTable, thruster: Thruster) -> None:
    """Raise InputError for a thrust table of origin 'formula' whose values differ from this thruster's formula."""
    if table.origin == "formula":
        _check_same(table, thruster.force(table.columns(), table.rows()))


def _cell(position: Any, size: int) -> tuple[Any, Any]:
    """Return the index of the table cell that contains a coordinate, and the fraction (0 to 1) within this cell.

    The index is unsigned, so JAX adds no code for negative indices.
    """
    inside = jnp.clip(position, 0.0, size - 1.0)
    index = jnp.minimum(jnp.floor(inside), size - 2.0)
    return index.astype(np.uint32), inside - index


def _blank_table(column_start: float, column_step: float, columns: int) -> BilinearTable:
    blank = np.zeros((RUDDER_ROWS, columns))
    return BilinearTable(RUDDER_START, RUDDER_STEP, column_start, column_step, blank, "formula")


def _speed_table(thruster: Thruster, start: float) -> BilinearTable:
    blank = _blank_table(start, FORCE_STEP, round((FORCE_MAX - start) / FORCE_STEP) + 1)
    return replace(blank, values=np.asarray(_speeds(thruster, blank)))


def _speeds(thruster: Thruster, table: BilinearTable) -> Any:
    """Return the fan speed (rpm) at every force and rudder angle of a table's axes, limited to the top speed."""
    speed = thruster.speed_rpm(table.columns(), table.rows())
    return np.clip(speed, -thruster.speed_max_rpm, thruster.speed_max_rpm)


def _check_same(table: BilinearTable, exact: Any) -> None:
    worst = float(np.max(np.abs(np.asarray(table.values) - exact)))
    if worst > 1e-9 * float(np.max(np.abs(exact))):
        problem = f"the table was made from another thruster: values differ by up to {worst:.6g}"
        fix = "compute the table again from this thruster, set table=None to use the formula, or set origin='measured'"
        raise InputError("table", problem, fix=fix)
