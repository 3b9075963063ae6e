"""Tables: interpolation, their shapes, and that speed and thrust tables are inverse within interpolation.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from trimtab.actuators.lookup import (
    BilinearTable,
    check_speed_table,
    check_thrust_table,
    forward_speed_table,
    full_speed_table,
    thrust_table,
)
from trimtab.actuators.rudder import DEG
from trimtab.actuators.thruster import Thruster
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays

FAN = Thruster()
LUT, RLUT = full_speed_table(FAN), thrust_table(FAN)
RUDDER = np.arange(-35, 31, 5) * DEG
FORCE = np.linspace(-2, 2, 161)
at = jax.jit(jax.vmap(BilinearTable.at, in_axes=(None, 0, 0)))


@pytest.fixture(scope="module")
def trip():
    """Rudder angle, demand, force after both tables, and whether the speed limit is nowhere in the demand's cell."""
    rng = np.random.default_rng(0)
    theta, force = rng.uniform(-35, 30, 200_000) * DEG, rng.uniform(-2, 2, 200_000)
    back = np.asarray(at(to_arrays(RLUT), theta, at(to_arrays(LUT), theta, force)))
    top = {s: np.abs(FAN.force(np.float64(s * 12000), RUDDER)) for s in (-1, 1)}
    row = np.minimum(np.floor((theta - RUDDER[0]) / (5 * DEG)).astype(int), 12)
    reach = np.where(force < 0, np.minimum(top[-1][row], top[-1][row + 1]), np.minimum(top[1][row], top[1][row + 1]))
    return theta, force, back, np.ceil(np.abs(force) / 0.025) * 0.025 <= reach


def test_table_shapes_and_grids_match_the_thesis():
    """[1] chapter 4: 14 rudder angles; forces 0 to 2 and -2 to 2 N in steps of 0.025 N."""
    forward = forward_speed_table(FAN)
    assert forward.values.shape == (14, 81)
    assert LUT.values.shape == (14, 161)
    assert np.allclose(LUT.rows()[:, 0], RUDDER)
    assert np.allclose(LUT.columns()[0], FORCE)
    assert np.allclose(forward.columns()[0], np.linspace(0, 2, 81))
    assert np.allclose(forward.values, LUT.values[:, 80:], atol=1e-8)


def test_entries_are_the_inverse_map_clipped_at_the_top_speed():
    assert np.abs(LUT.values).max() == 12000
    assert LUT.values[7, 0] == -12000
    assert LUT.values[7, 160] == 12000
    inside = np.abs(LUT.values) < 12000
    assert inside.sum() > 1000
    assert np.allclose(
        FAN.force(LUT.values, RUDDER[:, None])[inside], (FORCE + 0 * RUDDER[:, None])[inside], atol=1e-12
    )
    assert (np.diff(LUT.values) >= 0).all()


def test_bilinear_interpolation_holds_the_edge_values():
    rng = np.random.default_rng(1)
    table = BilinearTable(-1.0, 0.5, 10.0, 2.0, rng.normal(size=(4, 6)))
    oracle = RegularGridInterpolator((np.linspace(-1, 0.5, 4), np.linspace(10, 20, 6)), table.values)
    row, column = rng.uniform(-2, 2, 500), rng.uniform(5, 25, 500)
    held = np.stack([np.clip(row, -1, 0.5), np.clip(column, 10, 20)], axis=1)
    assert np.allclose(at(to_arrays(table), row, column), oracle(held), atol=1e-12)


def test_interpolation_is_exact_at_the_nodes():
    rows, columns = (a.ravel() for a in np.broadcast_arrays(LUT.rows(), LUT.columns()))
    assert np.allclose(at(to_arrays(LUT), rows, columns), LUT.values.ravel(), atol=1e-8)


@pytest.mark.parametrize(("step_rpm", "worst"), [(2.5, 2e-8), (100.0, 4e-5)])
def test_tables_are_inverse_at_the_nodes(step_rpm, worst):
    """Grid-node round trip 2e-8 N: the interpolation error of a thrust table with steps of 2.5 rpm."""
    reverse = to_arrays(thrust_table(FAN, step_rpm))
    rows, columns = (a.ravel() for a in np.broadcast_arrays(LUT.rows(), LUT.columns()))
    speed = LUT.values.ravel()
    inside = np.abs(speed) < 12000
    error = np.abs(np.asarray(at(reverse, rows, speed)) - columns)[inside].max()
    assert worst / 2 < error < worst


def test_round_trip_error_between_nodes_is_bounded(trip):
    """Off the grid at most 0.0062 N (a quarter of a step, next to 0), 0.0008 N above 0.1 N; both under 1e-2 N."""
    _, force, back, free = trip
    error = np.abs(back - force)
    assert free.sum() > 80_000
    assert error[free].max() < 1e-2
    assert error[free].max() == pytest.approx(0.0062, abs=5e-5)
    assert error[free & (np.abs(force) > 0.1)].max() == pytest.approx(0.0008, abs=5e-5)


def test_round_trip_error_near_the_speed_limit_is_bounded(trip):
    """A cell with a clipped corner mixes 12 krpm in: up to 0.018 N, found by measuring; not part of the check above."""
    theta, force, back, free = trip
    top = np.where(force < 0, FAN.force(np.float64(-12000), theta), FAN.force(np.float64(12000), theta))
    edge = ~free & (np.abs(force) < np.abs(top))
    assert 0.01 < np.abs(back - force)[edge].max() < 0.025


def test_unreachable_demand_gives_top_speed():
    one = jax.jit(BilinearTable.at)
    assert one(to_arrays(LUT), 0.1, 1.9) == 12000
    assert one(to_arrays(LUT), 0.1, -5.0) == -12000


def test_table_gradient_matches_the_slope():
    slope = jax.grad(RLUT.at, argnums=1)(0.1, 6020.0)
    assert slope == pytest.approx((RLUT.at(0.1, 6090.0) - RLUT.at(0.1, 6010.0)) / 80)


def test_rejects_too_small_and_foreign_tables():
    LUT.check()
    check_speed_table(LUT, FAN)
    check_thrust_table(RLUT, FAN)
    with pytest.raises(InputError, match="at least 2 rows"):
        BilinearTable(0.0, 1.0, 0.0, 1.0, np.zeros(5)).check()
    weak = replace(FAN, coefficient=0.01)
    for check, table in ((check_speed_table, LUT), (check_thrust_table, RLUT)):
        with pytest.raises(InputError, match="another thruster"):
            check(table, weak)
        check(replace(table, origin="measured"), weak)
