import jax
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.environment.acoustics import Air, speed_of_sound, water_vapour

R = 8.314462618


@pytest.mark.parametrize(
    ("celsius", "humidity", "co2", "expected"),
    [(0, 0.0, 314e-6, 331.455), (15, 0.0, 4e-4, 340.423), (20, 0.5, 4e-4, 343.987)],
)
def test_speed_of_sound_matches_published_values(celsius, humidity, co2, expected):
    """O. Cramer, J. Acoust. Soc. Am. 93 (5), 1993: 331.45 m/s in dry air at 0 °C with 314 ppm; to all digits given."""
    air = Air(temperature=celsius + 273.15, humidity=humidity, carbon_dioxide=co2)
    assert float(speed_of_sound(air)) == pytest.approx(expected, abs=5e-4)


def test_speed_of_sound_rises_0_6_m_s_per_kelvin():
    """About 0.6 m/s per degree, by differentiation."""
    slope = jax.grad(lambda T: speed_of_sound(Air(temperature=T)))(293.15)
    assert slope == pytest.approx(0.62, abs=0.01)


def ideal_mixture(celsius, x_water, x_co2):
    """sqrt(gamma R T / M) of a mixture of ideal gases, from spectroscopic heat capacities and molar masses: no fit."""
    T = celsius + 273.15
    vibration = {"N2": [3374], "O2": [2256], "Ar": [], "CO2": [960, 960, 1992, 3380], "H2O": [2294, 5262, 5404]}
    rigid = {"N2": 3.5, "O2": 3.5, "Ar": 2.5, "CO2": 3.5, "H2O": 4.0}
    mass = {"N2": 28.0134, "O2": 31.9988, "Ar": 39.948, "CO2": 44.0095, "H2O": 18.0153}
    dry = {"N2": 0.78084, "O2": 0.20946, "Ar": 0.00934}
    rest = (1 - x_water - x_co2) / sum(dry.values())
    x = {**{k: v * rest for k, v in dry.items()}, "CO2": x_co2, "H2O": x_water}

    def einstein(theta):
        return (theta / T) ** 2 * np.exp(theta / T) / (np.exp(theta / T) - 1) ** 2

    cp = sum(x[k] * (rigid[k] + sum(einstein(v) for v in vibration[k])) for k in x)
    M = sum(x[k] * mass[k] for k in x) * 1e-3
    return np.sqrt(cp / (cp - 1) * R * T / M)


@pytest.mark.parametrize("celsius", [0, 10, 20, 30])
@pytest.mark.parametrize("humidity", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("co2", [0.0, 4e-4, 5e-3])
def test_speed_of_sound_matches_ideal_gas_mixture(celsius, humidity, co2):
    """Real air differs from a mixture of ideal gases by some 0.05 % here (second virial coefficients)."""
    air = Air(temperature=celsius + 273.15, humidity=humidity, carbon_dioxide=co2)
    assert float(speed_of_sound(air)) == pytest.approx(ideal_mixture(celsius, float(water_vapour(air)), co2), rel=1e-3)


@pytest.mark.parametrize("celsius", [0.01, 10, 20, 30])
def test_water_vapour_matches_magnus_formula(celsius):
    """Saturation pressure by the Magnus formula (Alduchov and Eskridge, J. Appl. Meteorol. 35, 1996), to 0.4 %."""
    magnus = 610.94 * np.exp(17.625 * celsius / (243.04 + celsius)) * 1.004
    air = Air(temperature=celsius + 273.15, humidity=0.7)
    assert float(water_vapour(air)) == pytest.approx(0.7 * magnus / 101325, rel=4e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("celsius", [1, 15, 30])
@pytest.mark.parametrize("pressure", [85e3, 101325.0])
def test_dry_air_matches_coolprop(celsius, pressure):
    """The reference equation of state of dry air (Lemmon et al., 2000), where CoolProp is installed; 300 ppm."""
    props = pytest.importorskip("CoolProp.CoolProp")
    air = Air(temperature=celsius + 273.15, humidity=0.0, pressure=pressure, carbon_dioxide=0.0)
    expected = props.PropsSI("A", "T", celsius + 273.15, "P", pressure, "Air")
    assert float(speed_of_sound(air)) == pytest.approx(expected, rel=3e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("celsius", [5, 20, 30])
def test_water_vapour_matches_coolprop(celsius):
    """Its humid-air formulation (Herrmann et al., 2009), where CoolProp is installed."""
    humid = pytest.importorskip("CoolProp.HumidAirProp")
    air = Air(temperature=celsius + 273.15, humidity=0.8, pressure=101325.0)
    expected = humid.HAPropsSI("psi_w", "T", celsius + 273.15, "P", 101325.0, "R", 0.8)
    assert float(water_vapour(air)) == pytest.approx(expected, rel=1e-3)


def test_batch_matches_single_evaluations():
    air = replace(Air(), temperature=np.linspace(273.15, 303.15, 7), humidity=np.linspace(0, 1, 7))
    one_by_one = [
        speed_of_sound(Air(temperature=T, humidity=h)) for T, h in zip(air.temperature, air.humidity, strict=True)
    ]
    np.testing.assert_allclose(speed_of_sound(air), one_by_one, rtol=1e-12)
