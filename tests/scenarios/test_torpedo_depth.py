"""`torpedo/depth`: depth and heading are reached aboard and over an acoustic link, but not with a late link."""

import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.record import replace
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios.build import build
from trimtab.scenarios.torpedo.depth import LEVEL
from trimtab.vehicles.torpedo import Torpedo


def depth(log):
    return np.asarray(log["truth.position"])[:, 2]


def heading(log):
    w, x, y, z = np.asarray(log["truth.attitude"]).T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def test_torpedo_starts_level():
    """To the accuracy of six digits of the state."""
    dv, dw = Torpedo().accelerations(LEVEL)
    np.testing.assert_allclose(np.concatenate([dv, dw]), 0.0, atol=2e-4)
    climb = quaternion.rotate(np.asarray(LEVEL.attitude), np.asarray(LEVEL.velocity))[2]
    assert float(climb) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("links", ["aboard", "acoustic"])
def test_depth_and_heading_are_reached(links):
    log = simulate(build("torpedo/depth", {"links": links}), seed=0)
    assert depth(log)[-1] == pytest.approx(5.0, abs=0.2)
    assert depth(log).max() < 5.7
    assert heading(log)[-1] == pytest.approx(np.pi / 6, abs=0.05)
    assert np.abs(np.asarray(log["truth.stern"])).max() <= np.radians(13.6) + 1e-9


@pytest.mark.thorough
def test_current_carries_the_torpedo_along():
    with_current = simulate(build("torpedo/depth").ideal())
    calm = build("torpedo/depth", {"world.vehicle.current.north": "0", "world.vehicle.current.east": "0"})
    still = simulate(replace(calm, initial=LEVEL).ideal())
    gap = np.asarray(with_current["truth.position"])[-1] - np.asarray(still["truth.position"])[-1]
    assert gap[:2] == pytest.approx([-6.0, 6.0], abs=0.05), "30 s of it"


@pytest.mark.thorough
def test_long_link_delay_destabilises_the_torpedo():
    """The open-loop yaw rate doubles in 0.6 s, so half a second of delay each way is too long."""
    late = {"world.downlink.steps": "10", "world.uplink.steps": "10"}
    logs = simulate_many(build("torpedo/depth", late), seeds=range(5))
    assert all(np.abs(np.asarray(log["truth.rate"])[-200:, 2]).max() > 0.1 for log in logs)
    good = simulate_many(build("torpedo/depth"), seeds=range(5))
    assert all(np.abs(np.asarray(log["truth.rate"])[-200:, 2]).max() < 0.05 for log in good)
