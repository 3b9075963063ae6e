"""Varied parameters of a scenario, their correlations, and invalid spreads."""

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.sampling.distributions import parse_distribution
from trimtab.analysis.campaign.sampling.spread import parse_factors, resolve_spread, spread_arrays, spread_values
from trimtab.core.errors import InputError
from trimtab.scenarios.build import build

MASS, INERTIA = "world.vehicle.mass", "world.vehicle.inertia"
LATENCY = "world.uplink.latency"


@pytest.fixture(scope="module")
def scenario():
    return build("hovercraft/zero-velocity", {"links": "measured"})


def spread_of(scenario, correlate=(), **texts):
    factors = parse_factors((path.replace("__", "."), parse_distribution(t)) for path, t in texts.items())
    return resolve_spread(scenario, factors, correlate)


def made(scenario, spread, u):
    values = spread_values(spread, scenario, u)
    return values, spread_arrays(spread, scenario, values)


def test_scalar_parameter_gets_its_drawn_values(scenario):
    spread = spread_of(scenario, world__vehicle__mass="uniform(2, 3)")
    _, arrays = made(scenario, spread, np.array([[0.25], [0.5]]))
    assert arrays[MASS].tolist() == [2.25, 2.5]


def test_array_is_scaled_and_its_elements_are_varied(scenario):
    table = np.asarray(scenario.world.uplink.latency)
    whole = resolve_spread(scenario, parse_factors([(LATENCY, parse_distribution("uniform(50%, 150%)"))]))
    values, arrays = made(scenario, whole, np.array([[0.25], [0.5]]))
    assert values[LATENCY].tolist() == [0.75, 1.0]
    np.testing.assert_allclose(arrays[LATENCY], [0.75 * table, table], rtol=1e-15)
    one = parse_factors(
        [(f"{LATENCY}[3]", parse_distribution("uniform(0, 1)")), (f"{LATENCY}[1]", parse_distribution("uniform(0, 2)"))]
    )
    _, arrays = made(scenario, resolve_spread(scenario, one), np.array([[0.5, 0.25]]))
    assert arrays[LATENCY][0, [0, 1, 2, 3, 4]].tolist() == [table[0], 1.0, table[2], 0.25, table[4]]


def test_option_is_selected_by_index(scenario):
    factors = parse_factors([("autopilot.period", parse_distribution("choice(1 ms, 2 ms)"))])
    values, arrays = made(scenario, resolve_spread(scenario, factors), np.array([[0.2], [0.7]]))
    assert values["autopilot.period"].tolist() == [0, 1]
    assert arrays == {}


def test_correlated_parameters_keep_their_distributions(scenario):
    rho = 0.8
    spread = spread_of(
        scenario,
        [(MASS, INERTIA, rho)],
        world__vehicle__mass="normal(2.6, 0.1)",
        world__vehicle__inertia="uniform(80%, 120%)",
    )
    u = stats.qmc.Sobol(2, rng=np.random.default_rng(0)).random(2**14)
    values, _ = made(scenario, spread, u)
    z = [stats.norm.ppf(stats.rankdata(values[p]) / (2**14 + 1)) for p in (MASS, INERTIA)]
    assert np.corrcoef(z)[0, 1] == pytest.approx(rho, abs=0.003)
    assert stats.kstest(values[MASS], stats.norm(2.6, 0.1).cdf).statistic < 0.005
    assert stats.kstest(values[INERTIA] / 0.096, stats.uniform(0.8, 0.4).cdf).statistic < 0.005


@pytest.mark.parametrize(
    ("path", "text", "problem"),
    [
        ("world.vehicle.mas", "normal(100%, 5%)", "unknown parameter"),
        ("autopilot.period", "uniform(1, 2)", "changes the program"),
        (LATENCY, "normal(1, 2)", "gives one number"),
        (f"{LATENCY}[65]", "normal(1, 2)", "has shape"),
        (f"{MASS}[0]", "normal(1, 2)", "has shape"),
        (MASS, "choice(heavy, light)", "only numbers"),
        ("a[b]", "normal(1, 2)", "is not a path"),
    ],
)
def test_rejects_invalid_path_or_distribution(scenario, path, text, problem):
    with pytest.raises(InputError, match=r"Fix: ") as refused:
        resolve_spread(scenario, parse_factors([(path, parse_distribution(text))]))
    assert problem in str(refused.value)


def test_rejects_parameter_named_twice():
    one = parse_distribution("normal(1, 2)")
    for other in ("a.b", "a.b[1]"):
        with pytest.raises(InputError, match="named twice"):
            parse_factors([("a.b", one), (other, one)])


@pytest.mark.parametrize(
    ("correlate", "problem"),
    [
        ([(MASS, "other", 0.5)], "does not vary"),
        ([(MASS, INERTIA, 1.0)], "different paths, and a correlation"),
        ([(MASS, MASS, 0.1)], "two different paths"),
        (
            [(MASS, INERTIA, 0.9), (MASS, "world.vehicle.arm", 0.9), (INERTIA, "world.vehicle.arm", -0.9)],
            "positive definite",
        ),
    ],
)
def test_rejects_invalid_correlations(scenario, correlate, problem):
    spread = dict.fromkeys((MASS, INERTIA, "world.vehicle.arm"), "normal(100%, 5%)")
    factors = parse_factors((p, parse_distribution(t)) for p, t in spread.items())
    with pytest.raises(InputError, match=problem):
        resolve_spread(scenario, factors, correlate)


def test_array_is_varied_along_directions(scenario):
    table = np.asarray(scenario.world.uplink.latency)
    one, two = np.linspace(0, 1e-3, len(table)), np.full(len(table), 2e-3)
    texts = {f"{LATENCY}:{k}": f"along({', '.join(map(repr, map(float, v)))})" for k, v in ((1, one), (2, two))}
    factors = parse_factors((path, parse_distribution(text)) for path, text in texts.items())
    values, arrays = made(scenario, resolve_spread(scenario, factors), stats.norm.cdf([[0.0, 0.0], [1.0, -2.0]]))
    np.testing.assert_allclose(values[f"{LATENCY}:2"], [0, -2], atol=1e-12)
    np.testing.assert_allclose(arrays[LATENCY], [table, table + one - 2 * two], atol=1e-12)


@pytest.mark.parametrize(
    ("path", "text", "said"),
    [
        (LATENCY, "along(1, 2)", "moves an array along a direction"),
        (f"{MASS}:1", "normal(1, 2)", "but only along"),
        (f"{LATENCY}:1", "along(1, 2)", "got 2; the parameter has shape"),
        (f"{MASS}:1", "along(1)", "got 1; the parameter has shape"),
    ],
)
def test_rejects_invalid_directions(scenario, path, text, said):
    with pytest.raises(InputError, match=said):
        resolve_spread(scenario, parse_factors([(path, parse_distribution(text))]))


def test_rejects_direction_and_scale_of_one_array(scenario):
    both = [(f"{LATENCY}:1", parse_distribution("along(1, 2)")), (LATENCY, parse_distribution("normal(100%, 5%)"))]
    with pytest.raises(InputError, match="named twice"):
        parse_factors(both)
