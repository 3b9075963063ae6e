"""A campaign that is quick, in many small blocks."""

import numpy as np

from trimtab.analysis.campaign.campaign import Campaign

SPREAD = {
    "world.vehicle.mass": "normal(100%, 5%)",
    "world.uplink.latency": "uniform(50%, 150%)",
    "autopilot.law.k1": "uniform(80%, 120%)",
}
BLOCK = 64


def small(runs, block=BLOCK, **more):
    """Two seconds of the hovercraft in many worlds."""
    asked = {
        "settings": {"links": "measured", "duration": "2 s", "world.uplink.capacity": "32"},
        "metrics": ["error_rms:yaw_rate"],
        "seed": 3,
    }
    made = Campaign("hovercraft/zero-velocity", **{"runs": runs, "spread": SPREAD, **asked, **more})
    made.ready = made.ready._replace(block=block)
    return made


def assert_same(found, wanted):
    """Every column of two results, bit for bit."""
    assert list(found) == list(wanted)
    for name, column in wanted.items():
        assert found[name].dtype == column.dtype
        assert found[name].tobytes() == column.tobytes(), name
    assert len(wanted["run"])
    assert np.array_equal(wanted["run"], np.arange(len(wanted["run"])))
