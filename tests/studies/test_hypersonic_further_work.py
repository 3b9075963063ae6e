"""The campaign: every coefficient is in it, failures are failures, rankings find what was planted; the rows hold."""

import jax
import numpy as np
import pytest

from studies.hypersonic2022 import _campaign as campaign
from studies.hypersonic2022 import _campaign_ranking as ranking
from studies.hypersonic2022 import further_work
from trimtab.core.errors import InputError
from trimtab.core.record import leaves, replace
from trimtab.core.time import ms
from trimtab.estimators.flexible.discrete import EQUAL_Q
from trimtab.run.simulate import simulate
from trimtab.scenarios.hypersonic._flight import hypersonic_scenario
from trimtab.scenarios.hypersonic._internal import level_trim
from trimtab.vehicles.hypersonic import Hypersonic

COUNT = len(campaign.COEFFICIENTS)


def only(**factors):
    """Return the factors (1, 37) of one plant, nominal except for the given ones."""
    found = np.ones((1, COUNT))
    for name, value in factors.items():
        found[0, campaign.NAMES.index(name)] = value
    return found


def test_every_vehicle_parameter_is_varied_or_listed_as_kept():
    numbers = {path for path, value, _ in leaves(Hypersonic()) if isinstance(value, float)}
    assert numbers == {*campaign.COEFFICIENTS, *campaign.KEPT}
    assert len(set(campaign.NAMES)) == COUNT == 37


def test_draws_are_uniform_independent_and_repeatable():
    factors = campaign.draw_factors(0.2, 4000, 3)
    assert np.array_equal(factors, campaign.draw_factors(0.2, 4000, 3))
    assert np.abs(factors - 1).max() < 0.2
    assert np.abs(factors.std(axis=0) - 0.2 / np.sqrt(3)).max() < 0.004
    assert np.abs(np.corrcoef(factors.T) - np.eye(COUNT)).max() < 0.08


@pytest.mark.thorough
def test_plants_without_level_flight_match_the_trim_search():
    """Compare the fast search over many plants with the thorough search of each plant."""
    rows = [only(), only(ce=0.45), only(m=2.5), only(CM_0=1.2), only(b7=0.2, b5=0.2)]
    factors = np.concatenate(rows)
    crafts = campaign.build_plants(factors)
    found = campaign.find_untrimmed(crafts)
    for i in range(len(rows)):
        one = campaign.build_plants(factors[i : i + 1])
        plant = numbers_of(one)
        try:
            trims = [level_trim(plant, h, V) for h, V in ((85000.0, 7702.0808), ends())]
            refused = any(not 0 <= t.zeta[0] <= 0.0698131700797732 for t in trims)
        except InputError:
            refused = True
        assert found[i] == refused, i
    assert not found[0]
    assert found[1]


def numbers_of(craft):
    """Return the single plant in a record of arrays."""
    return jax.tree.map(lambda v: float(np.ravel(v)[0]), craft)


def ends():
    last = campaign.CLIMB.at(campaign.LENGTH)
    return float(last.h), float(last.V)


@pytest.mark.thorough
def test_failures_are_classified_by_cause():
    """Mode 2 at 0.75 is beyond the filter; a moment 10 % off leaves an offset that integral action removes."""
    factors = np.concatenate([only(), only(w2=0.75), only(CM_0=1.1), only(CM_0=1.1, ce=0.45)])
    kinds = np.zeros(4, int)
    without = campaign.fly_plants(factors, kinds, integral=False)
    assert without.is_success.tolist() == [True, False, False, False]
    assert without.is_off.tolist()[2]
    assert not (without.lost | without.is_saturated)[2]
    assert without.lacks_trim.tolist() == [False, False, False, True]
    having = campaign.fly_plants(factors, kinds, integral=True)
    assert having.is_success.tolist() == [True, False, True, False]
    share = further_work.success_proportion(having)
    assert (share.successes, share.trials) == (2, 3)


@pytest.mark.thorough
def test_campaign_run_equals_single_flight_of_same_plant():
    factors, kind = campaign.draw_factors(0.1, 3, 5), campaign.KINDS.index("lift step")
    craft = numbers_of(campaign.build_plants(factors[2:]))
    plant = replace(craft, disturbance=campaign.DISTURBANCES["lift step"])
    made = hypersonic_scenario("alone", campaign.CLIMB, campaign.LENGTH, plant=plant, noise="on", integral="off")
    filter = replace(made.autopilot.estimator, Q=EQUAL_Q)  # not "equal", which knows no offset of the accelerometer
    scenario = replace(made, autopilot=replace(made.autopilot, estimator=filter))
    alone = simulate(scenario, seed=2, log_period=ms(100))
    late = alone.t >= campaign.LENGTH - campaign.LATE
    found = campaign.fly_plants(factors, np.full(3, kind), integral=False)
    for path, ended in (("law.h_error", found.h), ("law.V_error", found.V)):
        assert ended[2] == pytest.approx(np.abs(alone[path][late]).max(), rel=1e-6)


def planted(limits):
    """Replacement for a flight: success if each named factor is within (low, high)."""

    def fly(factors, kinds, *, integral, seeds=None):
        good = np.ones(len(factors), bool)
        for name, (low, high) in limits.items():
            value = np.asarray(factors)[:, campaign.NAMES.index(name)]
            good &= (low < value) & (value < high)
        no = np.zeros(len(good), bool)
        return campaign.FlightOutcomes(no, ~good, no, 0.0 * no, 0.0 * no)

    return fly


@pytest.fixture
def unremembered():
    for function in (ranking.sobol_indices, ranking.failure_thresholds):
        function.cache_clear()
    yield
    for function in (ranking.sobol_indices, ranking.failure_thresholds):
        function.cache_clear()


def test_failure_thresholds_are_found_in_both_directions(monkeypatch, unremembered):
    monkeypatch.setattr(ranking, "fly_plants", planted({"w2": (0.843, 9.0), "ce": (0.6, 1.05), "m": (0.0, 1.004)}))
    found = ranking.failure_thresholds(True)
    at = campaign.NAMES.index
    assert found.down[at("w2")] == pytest.approx(0.157, rel=0.05)
    assert found.up[at("w2")] == np.inf
    assert found.down[at("ce")] == pytest.approx(0.4, rel=0.05)
    assert found.up[at("ce")] == pytest.approx(0.05, rel=0.05)
    assert found.up[at("m")] == pytest.approx(0.004, rel=0.2)
    assert ranking.rank_names(found.least, campaign.NAMES, most=False)[:3] == ["m", "ce", "w2"]
    assert np.isinf(np.delete(found.least, [at("m"), at("ce"), at("w2")])).all()


@pytest.mark.thorough
def test_sobol_indices_match_closed_form_success_function(monkeypatch, unremembered):
    """Success is that two factors uniform in 0.7 to 1.3 exceed 0.9 and 0.8: p = 2/3 and 5/6, in closed form.

    The first-order index of x is Var(E[y|x])/Var(y) = q^2 p (1 - p)/(p q (1 - p q)), the total one p q (1 - p)/(...).
    """
    monkeypatch.setattr(ranking, "fly_plants", planted({"w2": (0.9, 2.0), "ce": (0.8, 2.0)}))
    found = ranking.sobol_indices(0.3, True, 1024)
    p, q = 2 / 3, 5 / 6
    spread = p * q * (1 - p * q)
    at = campaign.NAMES.index
    assert found.share == pytest.approx(p * q, abs=0.02)
    assert found.first[at("w2")] == pytest.approx(q * q * p * (1 - p) / spread, abs=0.08)
    assert found.total[at("w2")] == pytest.approx(p * q * (1 - p) / spread, abs=0.08)
    assert found.total[at("ce")] == pytest.approx(p * q * (1 - q) / spread, abs=0.08)
    assert found.low[at("w2")] < found.total[at("w2")] < found.high[at("w2")]
    assert np.abs(np.delete(found.total, [at("w2"), at("ce")])).max() == 0
    assert ranking.rank_names(found.total, ranking.FACTORS, most=True)[:2] == ["w2", "ce"]


def test_rank_correlation_handles_infinite_thresholds():
    assert ranking.rank_correlation([3.0, 2.0, 1.0], np.array([0.1, 0.2, np.inf])) == pytest.approx(1.0)
    assert ranking.rank_correlation([1.0, 2.0, 3.0], np.array([0.1, 0.2, np.inf])) == pytest.approx(-1.0)


@pytest.mark.thorough
@pytest.mark.timeout(1200)
def test_rows_hold_and_the_pictures_are_drawn(tmp_path):
    rows = list(further_work.rows())
    assert [r.id for r in rows if not r.holds] == []
    assert len({r.id for r in rows}) == len(rows)
    for picture in further_work.figures(tmp_path):
        assert picture.read_bytes().startswith(b"\x89PNG")
