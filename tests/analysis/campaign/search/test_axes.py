"""Axes of a map: their changes to a scenario, combinations, and invalid axes."""

import numpy as np
import pytest
from scipy.stats import norm

from trimtab.analysis.campaign.search.axes import (
    Axis,
    axis_of_link,
    axis_of_path,
    axis_of_scale,
    enlarge_rings,
    even_latencies,
    find_quantity,
    measured_latency,
    with_values,
)
from trimtab.analysis.campaign.search.stability_map import values_at
from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.links.latency import MeasuredLatency, interpolate_latency
from trimtab.links.slave_bus import SlaveBus
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build


@pytest.fixture(scope="module")
def forward():
    return catalogue.load_scenario("hovercraft/forward")[0]


def latency(scenario, axes, values):
    for axis in axes:
        scenario = axis.prepare(scenario)
    for axis, value in zip(axes, values, strict=True):
        scenario = with_values(scenario, axis.change(scenario, value))
    return scenario.world.uplink.latency


def test_delay_and_jitter_axes_combine_in_either_order(forward):
    axes = axis_of_link("delay", [0.0, 0.2]), axis_of_link("jitter", [0.0, 0.1])
    table = latency(forward, axes, (0.15, 0.08))
    np.testing.assert_allclose(table, 0.15 + 0.08 * norm.cdf(np.linspace(-4, 4, 65)))
    np.testing.assert_array_equal(table, latency(forward, axes[::-1], (0.08, 0.15)))


def test_jitter_axis_alone_keeps_the_link_delay(forward):
    np.testing.assert_allclose(latency(forward, [axis_of_link("jitter", [0, 1])], [0.0]), 0.04)
    real, _ = catalogue.load_scenario("hovercraft/forward", {"links": "measured"})
    own = without(real.world.uplink, "jitter").latency
    np.testing.assert_allclose(latency(real, [axis_of_link("jitter", [0, 1])], [0.0]), own)


def test_jitter_latencies_are_uniformly_distributed():
    z = norm.ppf(np.linspace(0.001, 0.999, 400))
    np.testing.assert_allclose(interpolate_latency(even_latencies(), z), norm.cdf(z), atol=1e-3)


def test_link_chain_becomes_measured_link_of_equal_delay(forward):
    link = measured_latency(forward, "downlink")
    assert (link.send_period, link.period) == (ms(6), ms(1))
    np.testing.assert_allclose(link.latency, 0.036)
    assert measured_latency(forward.ideal(), "uplink").latency.max() == 0
    lossy = axis_of_link("loss", [0.0, 0.9], link="downlink")
    assert with_values(lossy.prepare(forward), lossy.change(forward, 0.3)).world.downlink.loss == 0.3


def test_link_buffer_grows_with_the_longest_latency(forward):
    axis = axis_of_link("delay", [0.0, 5.0])
    base = axis.prepare(forward)
    last = with_values(base, axis.change(base, 5.0))
    with pytest.raises(InputError, match="ring of 64"):
        last.check()
    grown = enlarge_rings(base, last)
    assert grown.world.uplink.capacity == 252
    with_values(grown, axis.change(grown, 5.0)).check()


def test_path_and_scale_axes_change_the_scenario(forward):
    assert axis_of_path("autopilot.law.k2", [1, 2]).change(forward, 1.5) == {"autopilot.law.k2": 1.5}
    drag = axis_of_path("world.vehicle.friction.force_viscous", [0.0, 1.0])
    assert with_values(drag.prepare(forward), drag.change(forward, 0.5)).world.vehicle.friction.force_viscous == 0.5
    real, _ = catalogue.load_scenario("hovercraft/forward", {"links": "measured"})
    scaled = axis_of_scale("world.uplink.latency", [0.5, 2]).change(real, 2.0)["world.uplink.latency"]
    np.testing.assert_array_equal(scaled, 2 * real.world.uplink.latency)
    assert find_quantity(with_values(forward, {"autopilot.law.k2": 3.0}), "autopilot.law.k2")[0] == 3.0


PLACES = "world.vehicle.rotors.places"
"""An array (4, 3): where the rotors are."""


@pytest.fixture(scope="module")
def quadrotor():
    return build("quadrotor/track")


def test_axis_changes_one_element_of_an_array(quadrotor):
    own = quadrotor.world.vehicle.rotors.places
    for axis, value, wanted in (
        (axis_of_path(f"{PLACES}[2,0]", [-1.0, 1.0]), -0.4, -0.4),
        (axis_of_scale(f"{PLACES}[2,0]", [0.5, 2.0]), 2.0, 2 * own[2, 0]),
    ):
        places = axis.change(axis.prepare(quadrotor), value)[PLACES]
        assert places[2, 0] == wanted
        np.testing.assert_array_equal(np.delete(places, 6), np.delete(own, 6))
        assert own[2, 0] == -0.315  # the scenario's own stays


def test_two_axes_change_two_elements_of_one_array(quadrotor):
    x, y = axis_of_path(f"{PLACES}[0,0]", [0.1, 0.2]), axis_of_scale(f"{PLACES}[2,0]", [0.5, 1.5])
    places = values_at(quadrotor, x, y, 0.2, 0.5)[PLACES]
    assert (places[0, 0], places[2, 0], places[1, 1]) == (0.2, -0.1575, 0.315)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: axis_of_path(PLACES, [1, 2]), r"shape \(4, 3\).*\n.*places\[0,0\].*percent"),
        (lambda: axis_of_path(f"{PLACES}[4,0]", [1, 2]), r"shape \(4, 3\).*\n.*places\[0,0\]"),
        (lambda: axis_of_scale(f"{PLACES}[0]", [1, 2]), r"shape \(4, 3\).*\n.*places\[0,0\]"),
        (lambda: axis_of_scale("initial.velocity", [1, 2]), "own value is 0"),
        (lambda: axis_of_scale(f"{PLACES}[0,1]", [1, 2]), "own value is 0"),
        (lambda: axis_of_path("world.vehicle.mass[0]", [1, 2]), r"shape \(\).*\n.*'world.vehicle.mass'$"),
    ],
)
def test_rejects_invalid_array_element(quadrotor, make, says):
    with pytest.raises(InputError, match=says):
        with_values(quadrotor, make().change(quadrotor, 1.0))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda s: axis_of_path("a", [2.0, 1.0]).check(), "increasing"),
        (lambda s: Axis("a", [1.0], "", lambda s, v: {}).check(), "increasing"),
        (lambda s: axis_of_link("lag", [0, 1]), "delay, jitter, loss"),
        (lambda s: axis_of_link("delay", [0, 1], link="cable"), "uplink, downlink"),
        (lambda s: find_quantity(s, "autopilot.law.k3"), "autopilot.law.k2"),
        (lambda s: find_quantity(s, "world.sensors.navigation.period"), "changes the program"),
    ],
)
def test_invalid_axes_are_rejected(forward, make, says):
    with pytest.raises(InputError, match=says):
        make(forward)


def test_rejects_a_link_without_latency(forward):
    bus = replace(forward, world=replace(forward.world, uplink=SlaveBus()))
    with pytest.raises(InputError, match="SlaveBus has no latency"):
        measured_latency(bus, "uplink")
    assert isinstance(measured_latency(forward, "uplink"), MeasuredLatency)


def test_delay_axis_updates_predictor_delay_and_horizon():
    scenario = build("hovercraft/forward", {"predictor": "on"})
    before = scenario.autopilot.predictor
    delay, jitter = axis_of_link("delay", [0.0, 0.4]), axis_of_link("jitter", [0.0, 0.1])
    there = jitter.prepare(delay.prepare(scenario))
    assert there.autopilot.predictor.horizon == before.horizon + ms(500)
    there = with_values(there, delay.change(there, 0.3))
    assert float(there.autopilot.predictor.uplink_delay) == pytest.approx(0.3)
    there = with_values(there, jitter.change(there, 0.1))
    assert float(there.autopilot.predictor.uplink_delay) == pytest.approx(0.35)
    plain = delay.prepare(build("hovercraft/forward"))
    assert set(delay.change(plain, 0.3)) == {"world.uplink.latency"}
    down = axis_of_link("delay", [0.0, 0.4], "downlink")
    assert set(down.change(down.prepare(scenario), 0.3)) == {"world.downlink.latency"}
    assert down.prepare(scenario).autopilot.predictor.horizon == before.horizon + ms(400)
