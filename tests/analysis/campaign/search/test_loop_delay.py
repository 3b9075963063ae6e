"""The delay of a loop, compared with the published sum and with delays measured in a flight."""

import numpy as np
import pytest

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.analysis.campaign.search.axes import axis_of_link, with_values
from trimtab.analysis.campaign.search.map_theory import loop_delay
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.links.latency import NODES, MeasuredLatency
from trimtab.links.slave_bus import SlaveBus
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue


@pytest.fixture(scope="module")
def forward():
    return catalogue.load_scenario("hovercraft/forward")[0]


def direct(scenario):
    world = replace(scenario.world, actuators=DirectActuation())
    return replace(scenario, world=world, autopilot=replace(scenario.autopilot, allocation=DirectAllocation()))


def test_loop_delay_matches_the_published_sum(forward):
    """[1] section 6.1: 36 + 40 ms, and waits of 10 ms and of up to 3 ms on the mean: 6 ms samples, 20 ms packets."""
    least, mean, most = loop_delay(forward)
    assert least == pytest.approx(0.076)
    assert 0.086 <= mean <= 0.089
    assert most == pytest.approx(0.1)


def test_ideal_loop_delay_is_half_a_period(forward):
    assert loop_delay(forward.ideal()) == pytest.approx((0.0, 0.0005, 0.001))


@pytest.mark.thorough
@pytest.mark.parametrize("latency", [0.05, 0.0635])
def test_loop_delay_matches_ages_in_a_flight(forward, latency):
    """Find in a flight, at every millisecond, the earlier surge velocity that caused the current force."""
    link = MeasuredLatency(latency=np.full(NODES, latency), send_period=ms(20))
    s = direct(forward.without("navigation-error"))
    s = replace(s, world=replace(s.world, uplink=link), duration=seconds(2))
    log = simulate(s, seed=0, log_period=ms(1))
    speed, instants = log["truth.surge_velocity"], np.arange(200, 1500)
    assert (np.diff(speed[instants]) > 0).all()  # so that every force belongs to one instant
    now = np.arange(700, 1100)
    then = np.interp(2.8 / 2.6 - log["actuators.u.FX"][now] / 1.0, speed[instants], instants)
    np.testing.assert_allclose(then, np.round(then), atol=1e-6)
    ages = (now - np.round(then)) * 1e-3
    least, mean, most = loop_delay(s)
    assert ages.min() == pytest.approx(least, abs=1e-9)
    assert ages.max() == pytest.approx(most - 1e-3, abs=1e-9)  # the last age is seen one step before it is reached
    assert ages.mean() + 0.5e-3 == pytest.approx(mean, abs=0.6e-3)


def test_packet_frames_round_latency_up(forward):
    axis = axis_of_link("delay", [0.0, 0.3])
    base = axis.prepare(forward)

    def least(delay):
        return loop_delay(with_values(base, axis.change(base, delay))).least - 0.036

    np.testing.assert_allclose([least(d) for d in (0.0, 0.02, 0.0201, 0.14, 0.141)], [0, 0.02, 0.04, 0.14, 0.16])


def test_jitter_adds_half_its_width_to_mean_delay(forward):
    axis = axis_of_link("jitter", [0.0, 0.1])
    base = axis.prepare(direct(forward))
    without, with_jitter = (loop_delay(with_values(base, axis.change(base, j))) for j in (0.0, 0.1))
    assert with_jitter.mean - without.mean == pytest.approx(0.0505, abs=2e-4)  # and half a look
    assert with_jitter.most - without.most == pytest.approx(0.1, abs=1e-3)
    assert 0 <= with_jitter.least - without.least <= 1.0001e-3  # its least is just above 0: seen a look later


def test_rejects_links_of_unknown_latency(forward):
    with pytest.raises(InputError, match="latency of a SlaveBus"):
        loop_delay(replace(forward, world=replace(forward.world, uplink=SlaveBus())))
