"""Axes: what they change in a scenario, that they go together, and what they refuse."""

import numpy as np
import pytest
from scipy.stats import norm

from trimtab.campaign.search.axes import Axis, changed, even_spread, leaf, measured, of_link, of_path, of_scale, roomy
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.links.latency import MeasuredLatency, interpolate
from trimtab.links.slave_bus import SlaveBus
from trimtab.scenarios import catalogue


@pytest.fixture(scope="module")
def forward():
    return catalogue.load("hovercraft/forward")[0]


def latency(scenario, axes, values):
    for axis in axes:
        scenario = axis.prepare(scenario)
    for axis, value in zip(axes, values, strict=True):
        scenario = changed(scenario, axis.change(scenario, value))
    return scenario.world.uplink.latency


def test_delay_and_jitter_go_together_in_either_order(forward):
    axes = of_link("delay", [0.0, 0.2]), of_link("jitter", [0.0, 0.1])
    table = latency(forward, axes, (0.15, 0.08))
    np.testing.assert_allclose(table, 0.15 + 0.08 * norm.cdf(np.linspace(-4, 4, 65)))
    np.testing.assert_array_equal(table, latency(forward, axes[::-1], (0.08, 0.15)))


def test_jitter_alone_sits_on_the_links_own_delay(forward):
    np.testing.assert_allclose(latency(forward, [of_link("jitter", [0, 1])], [0.0]), 0.04)
    real, _ = catalogue.load("hovercraft/forward", {"links": "measured"})
    own = real.world.uplink.without("jitter").latency
    np.testing.assert_allclose(latency(real, [of_link("jitter", [0, 1])], [0.0]), own)


def test_the_spread_is_even():
    z = norm.ppf(np.linspace(0.001, 0.999, 400))
    np.testing.assert_allclose(interpolate(even_spread(), z), norm.cdf(z), atol=1e-3)


def test_a_chain_becomes_a_link_of_the_same_delay_and_packets(forward):
    link = measured(forward, "downlink")
    assert (link.send_period, link.period) == (ms(6), ms(1))
    np.testing.assert_allclose(link.latency, 0.036)
    assert measured(forward.ideal(), "uplink").latency.max() == 0
    lossy = of_link("loss", [0.0, 0.9], link="downlink")
    assert changed(lossy.prepare(forward), lossy.change(forward, 0.3)).world.downlink.loss == 0.3


def test_rings_grow_with_the_longest_latency(forward):
    axis = of_link("delay", [0.0, 5.0])
    base = axis.prepare(forward)
    last = changed(base, axis.change(base, 5.0))
    with pytest.raises(InputError, match="ring of 64"):
        last.check()
    grown = roomy(base, last)
    assert grown.world.uplink.capacity == 252
    changed(grown, axis.change(grown, 5.0)).check()


def test_paths_and_factors(forward):
    assert of_path("autopilot.law.k2", [1, 2]).change(forward, 1.5) == {"autopilot.law.k2": 1.5}
    real, _ = catalogue.load("hovercraft/forward", {"links": "measured"})
    scaled = of_scale("world.uplink.latency", [0.5, 2]).change(real, 2.0)["world.uplink.latency"]
    np.testing.assert_array_equal(scaled, 2 * real.world.uplink.latency)
    assert leaf(changed(forward, {"autopilot.law.k2": 3.0}), "autopilot.law.k2")[0] == 3.0


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda s: of_path("a", [2.0, 1.0]).check(), "rising"),
        (lambda s: Axis("a", [1.0], "", lambda s, v: {}).check(), "rising"),
        (lambda s: of_link("lag", [0, 1]), "delay, jitter, loss"),
        (lambda s: of_link("delay", [0, 1], link="cable"), "uplink, downlink"),
        (lambda s: leaf(s, "autopilot.law.k3"), "autopilot.law.k2"),
        (lambda s: leaf(s, "world.sensors.navigation.period"), "shapes the program"),
    ],
)
def test_refusals(forward, make, says):
    with pytest.raises(InputError, match=says):
        make(forward)


def test_a_link_that_has_no_latency_is_refused(forward):
    bus = replace(forward, world=replace(forward.world, uplink=SlaveBus()))
    with pytest.raises(InputError, match="SlaveBus has no latency"):
        measured(bus, "uplink")
    assert isinstance(measured(forward, "uplink"), MeasuredLatency)
