"""A circle, a figure eight and way-points on the full loop: tracking errors.

Bands are regression bands around results of this package, over eight seeds.
"""

import numpy as np
import pytest

from trimtab.core.time import ms
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.vehicles.hovercraft import Hovercraft

A = float(Hovercraft().percussion_arm)
FOUND = 5.0
"""s, after which the navigation has found its way, and the start is over."""
BANDS = {"circle": (0.045, 0.15), "eight": (0.07, 0.45), "waypoints": (0.10, 0.25)}
"""m: most, of the median rms of a flight's error of place, and of the largest error of all flights."""


def place_errors(log):
    """Return the true position errors of the centre of percussion (m)."""
    heading = log["truth.heading"]
    north = log["truth.north"] + A * np.cos(heading) - log["law.north_reference"]
    return np.hypot(north, log["truth.east"] + A * np.sin(heading) - log["law.east_reference"])


@pytest.mark.thorough
@pytest.mark.parametrize("reference", BANDS)
def test_craft_tracks_each_reference(reference):
    scenario, _ = catalogue.load_scenario("hovercraft/track", {"reference": reference})
    ideal = simulate(scenario.ideal(), log_period=ms(20), signals=("truth", "law"))
    logs = simulate_many(scenario, seeds=range(8), log_period=ms(20), signals=("truth", "law"))
    errors = np.array([place_errors(log)[log.t > FOUND] for log in logs])
    rms, alone = np.sqrt(np.mean(errors**2, axis=1)), np.sqrt(np.mean(place_errors(ideal) ** 2))
    print(
        f"{reference}: ideal rms {100 * alone:.1f} cm; real, eight flights: median rms {100 * np.median(rms):.1f} cm,"
    )
    print(f"{'':{len(reference)}}  worst rms {100 * rms.max():.1f} cm, farthest {100 * errors.max():.0f} cm")
    assert alone < 0.02
    assert np.median(rms) < BANDS[reference][0]
    assert errors.max() < BANDS[reference][1]


@pytest.mark.thorough("lyapunov")
@pytest.mark.parametrize("law", ["lyapunov", "horizon"])
def test_target_is_the_distance_from_the_path(law):
    (target,) = build("hovercraft/track", {"law": law}).targets
    assert (target.path, target.value, target.band) == ("law.position_error", 0.0, 0.2)


@pytest.mark.thorough
def test_logged_position_error_is_true_on_the_ideal_twin():
    log = simulate(build("hovercraft/track").ideal(), duration=ms(3000), log_period=ms(100))
    np.testing.assert_allclose(log["law.position_error"], place_errors(log), atol=1e-6)


@pytest.mark.thorough
def test_path_progress_waits_for_a_craft_starting_behind():
    """From 1.5 m behind: by time the craft cuts across; along the path the reference waits and stays late."""
    settings = {"initial.east": "-1.6", "duration": "40 s"}
    progress = {}
    for kind in ("time", "path"):
        log = simulate(build("hovercraft/track", {**settings, "progress": kind}).ideal(), log_period=ms(20))
        assert place_errors(log)[-200:].max() < 0.1
        progress[kind] = float(log["law.progress"][-1])
    assert progress["time"] == pytest.approx(40, abs=0.1)
    assert progress["path"] < 38
