"""The standard atmosphere against the tables of its publication."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.environment import atmosphere
from trimtab.environment.atmosphere import geopotential_height, standard_atmosphere

PRINTED = {
    0: (288.150, 1.01325e5, 1.2250, 340.294),
    1000: (281.651, 8.9876e4, 1.1117, 336.435),
    5000: (255.676, 5.4048e4, 7.3643e-1, 320.545),
    10_000: (223.252, 2.6500e4, 4.1351e-1, 299.532),
    20_000: (216.650, 5.5293e3, 8.8910e-2, 295.069),
    30_000: (226.509, 1.1970e3, 1.8410e-2, 301.709),
    40_000: (250.350, 2.8714e2, 3.9957e-3, 317.189),
    50_000: (270.650, 7.9779e1, 1.0269e-3, 329.799),
    60_000: (247.021, 2.1958e1, 3.0968e-4, 315.073),
    70_000: (219.585, 5.2209, 8.2829e-5, 297.061),
}
"""Height (m): temperature (K), pressure (Pa), density (kg/m³), speed of sound (m/s), as printed: U.S. Standard
Atmosphere 1976, tables I and III."""


@pytest.mark.parametrize("height", PRINTED)
def test_matches_the_published_tables(height):
    air = standard_atmosphere(float(height))
    T, p, rho, a = PRINTED[height]
    assert air.temperature == pytest.approx(T, abs=6e-4)
    assert air.pressure == pytest.approx(p, rel=6e-5)
    assert air.density == pytest.approx(rho, rel=6e-5)
    assert air.sound_speed == pytest.approx(a, abs=6e-4)


def test_viscosity_matches_published_values():
    assert standard_atmosphere(0.0).viscosity == pytest.approx(1.7894e-5, rel=3e-5)
    assert standard_atmosphere(20_000.0).viscosity == pytest.approx(1.4216e-5, rel=3e-5)


def test_pressure_gradient_is_hydrostatic():
    """dp/dh = -rho g (r/(r + h))², whatever the line, also below the sea."""
    slope_and_density = jax.vmap(
        lambda h: (jax.grad(lambda h: standard_atmosphere(h).pressure)(h), standard_atmosphere(h).density)
    )
    heights = np.linspace(-2000.0, 120_000.0, 87)
    slope, density = map(np.asarray, jax.jit(slope_and_density)(heights))
    g = atmosphere.GRAVITY * (atmosphere.EARTH_RADIUS / (atmosphere.EARTH_RADIUS + heights)) ** 2
    np.testing.assert_allclose(slope, -density * g, rtol=1e-12)


def test_atmosphere_is_continuous_at_layer_boundaries():
    for base in atmosphere.BASES[1:]:
        height = base * atmosphere.EARTH_RADIUS / (atmosphere.EARTH_RADIUS - base)
        assert geopotential_height(height) == pytest.approx(base, rel=1e-14)
        below, above = standard_atmosphere(height - 1e-4), standard_atmosphere(height + 1e-4)
        np.testing.assert_allclose(below, above, rtol=1e-7)


@pytest.mark.thorough
def test_compiled_c_matches_jax():
    fast = trimtab.compile(standard_atmosphere, 0.0)
    for height in (0.0, 11_500.0, 30_000.0, 71_234.5):
        np.testing.assert_allclose(fast(height), standard_atmosphere(jnp.asarray(height)), rtol=1e-14)
