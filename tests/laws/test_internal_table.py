"""Internal states by time, from a table: interpolation, ends, invalid tables, and C code."""

import jax
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.laws.internal_states import InternalTable


@pytest.fixture(scope="module")
def table():
    draws = np.random.default_rng(3)
    return to_arrays(InternalTable(draws.normal(size=(9, 6)), draws.normal(size=(9, 6)), first=2.0, spacing=0.25))


def test_interpolates_by_hermite_spline_and_holds_the_ends(table):
    """scipy's spline of the same nodes and rates; the first and the last node outside."""
    spline = CubicHermiteSpline(2.0 + 0.25 * np.arange(9), table.nodes, table.rates)
    t = np.linspace(0.0, 6.0, 241)
    got = jax.jit(jax.vmap(lambda t: table.step(t, table.init(None), None)[1]))(t)
    np.testing.assert_allclose(got, spline(np.clip(t, 2.0, 4.0)), rtol=1e-12, atol=1e-12)


@pytest.mark.thorough
def test_table_rates_are_continuous_across_nodes(table):
    """Value and rate agree on both sides of each node inside."""
    nodes, small = 2.0 + 0.25 * np.arange(1, 8), 1e-6
    rate = jax.vmap(jax.jacfwd(table.at))
    np.testing.assert_allclose(rate(nodes - small), table.rates[1:-1], atol=1e-3)
    np.testing.assert_allclose(rate(nodes + small), table.rates[1:-1], atol=1e-3)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"nodes": np.full((9, 6), np.nan)}, "nodes: row 0 contains a number that is not finite"),
        (
            {"rates": np.where(np.arange(54).reshape(9, 6) == 20, np.inf, 0.0)},
            "rates: row 3 contains a number that is not finite",
        ),
        ({"nodes": np.zeros((1, 6))}, r"nodes: the array has shape \(1, 6\)"),
        ({"nodes": np.zeros((9, 5))}, r"nodes: the array has shape \(9, 5\)"),
        ({"nodes": np.zeros(6)}, r"nodes: the array has shape \(6,\)"),
        ({"nodes": np.zeros((8, 6))}, "8 nodes and 9 rows"),
    ],
)
def test_rejects_invalid_tables(table, changes, text):
    table.check()
    with pytest.raises(InputError, match=text):
        replace(table, **changes).check()


@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_c_table_matches_jax(table):
    run = compile(lambda table, t: table.at(t), table, np.float64(0))
    for t in (0.0, 2.0, 2.31, 3.999, 4.0, 9.0):
        np.testing.assert_allclose(run(table, np.float64(t)), table.at(t), rtol=1e-13, atol=1e-14)
