"""Theory beside a map: the margins of `design` where the loop's delay meets them, and a scalar loop with losses."""

import functools

import numpy as np
import pytest
from design import hovercraft_loops as loops

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.analysis.campaign.search.axes import axis_of_link, axis_of_path, with_values
from trimtab.analysis.campaign.search.map_theory import linear_loop, loop_delay, stability_criteria
from trimtab.analysis.campaign.search.stability_map import StabilityMap, trace_boundary, values_at
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.design.loop_transfer import loop_of_gain, loop_of_law
from trimtab.design.margins import delay_margin, jitter_margin
from trimtab.laws.velocity import ForwardMomentum
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.vehicles.hovercraft import Hovercraft


@pytest.fixture(scope="module")
def forward():
    s = catalogue.load_scenario("hovercraft/forward")[0]
    s = replace(s, world=replace(s.world, actuators=DirectActuation()))
    return replace(s, autopilot=replace(s.autopilot, allocation=DirectAllocation()))


def unflown(scenario, x, y):
    """A map on which every point failed, without a flight."""
    base = y.prepare(x.prepare(scenario))
    traced = trace_boundary(lambda p: np.zeros(len(p)), (len(x.values), len(y.values)), 0)
    return StabilityMap(base, x, y, np.asarray(x.values), np.asarray(y.values), traced, 1, "none")


@functools.cache
def law_loop(k2):
    law = ForwardMomentum(k2=k2)
    return loop_of_law(Hovercraft(), law, law.equilibrium())


@pytest.mark.thorough
def test_criteria_lines_match_delay_and_jitter_margins(forward):
    found = unflown(
        forward, axis_of_link("delay", np.linspace(0, 0.2, 3)), axis_of_link("jitter", np.linspace(0, 0.2, 3))
    )
    one, other = stability_criteria(found)
    assert (one.name, other.name) == ("delay margin", "jitter margin")
    loop, limit = law_loop(4.0), delay_margin(law_loop(4.0)).delay
    for line in one.zero_lines():
        for a, b in line[:: max(len(line) // 8, 1)]:
            scenario = with_values(found.scenario, values_at(found.scenario, found.x, found.y, a, b))
            assert loop_delay(scenario).mean == pytest.approx(limit, abs=2e-3)  # two looks
    for line in other.zero_lines():
        for a, b in line[:: max(len(line) // 8, 1)]:
            under_way = loop_delay(with_values(found.scenario, values_at(found.scenario, found.x, found.y, a, b)))
            allowed = jitter_margin(loop, delay=under_way.least)
            assert under_way.most - under_way.least == pytest.approx(allowed, abs=3e-3)
    assert (one.margin >= other.margin - 2e-3).all()  # what the theorem allows is stable on the mean


def test_scenario_loop_equals_loop_of_its_law(forward):
    w = np.array([0.5, 6.0])
    np.testing.assert_allclose(linear_loop(forward).frequency_response(w), law_loop(4.0).frequency_response(w))


@pytest.mark.thorough
def test_gain_axis_uses_a_loop_for_each_value(forward):
    found = unflown(forward, axis_of_link("delay", [0.0, 0.3]), axis_of_path("autopilot.law.k2", [2.0, 8.0], "kg/s"))
    one, _ = stability_criteria(found, lambda s: loops.lateral(float(s.autopilot.law.k2), 2.8 / 2.6))
    assert one.y[[0, -1]].tolist() == [2.0, 8.0]
    for j, k2 in ((0, 2.0), (-1, 8.0)):
        np.testing.assert_allclose(one.margin[0, j] + loop_delay(found.scenario).mean, delay_margin(law_loop(k2)).delay)


@pytest.mark.thorough
def test_packet_loss_criterion_requires_a_scalar_loop(forward):
    pole, gains = 4.0, axis_of_path("autopilot.law.k2", [0.5, 1.5])
    found = unflown(forward, axis_of_link("loss", [0.0, 1.0]), gains)

    def scalar(scenario):
        return loop_of_gain([[pole * float(scenario.autopilot.law.k2)]], [[1.0]], [[-50.0]])

    (one,) = stability_criteria(found, scalar)
    assert one.name == "packet loss"
    a = np.exp(pole * one.y * 0.02)  # packets each 20 ms
    (line,) = one.zero_lines()
    np.testing.assert_allclose(np.interp(one.y, line[:, 1], line[:, 0]), a**-2, atol=2e-3)
    with pytest.raises(InputError, match="one state"):
        stability_criteria(found, lambda s: law_loop(4.0))


def test_rejects_scenarios_without_a_stability_criterion(forward):
    gains = axis_of_path("autopilot.law.k1", [1.0, 2.0]), axis_of_path("autopilot.law.k2", [1.0, 2.0])
    with pytest.raises(InputError, match="neither"):
        stability_criteria(unflown(forward, *gains))
    heading, _ = catalogue.load_scenario("hovercraft/heading-bang-bang")
    with pytest.raises(InputError, match="no equilibrium"):
        linear_loop(heading)
    with pytest.raises(InputError, match="the law has a predictor"):
        linear_loop(build("hovercraft/forward", {"predictor": "on"}))
