"""`hovercraft/track` by the receding-horizon law on the full loop, compared with the Lyapunov tracker; and a plan."""

from pathlib import Path

import numpy as np
import pytest

from trimtab.core.time import ms
from trimtab.design.obstacles import read_task
from trimtab.run.planner import plan_path
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

ARM = 0.096 / (2.6 * 0.32)
HALL = Path(__file__).parents[2] / "examples" / "hall.toml"
pytestmark = pytest.mark.thorough


def errors(log):
    """Return the distance of P from its reference (m), from 15 s on."""
    heading = log["truth.heading"]
    north = log["truth.north"] + ARM * np.cos(heading) - log["law.north_reference"]
    east = log["truth.east"] + ARM * np.sin(heading) - log["law.east_reference"]
    return np.hypot(north, east)[log.t > 15]


def fly(law, seeds=3, **settings):
    scenario = build("hovercraft/track", {"law": law, **settings})
    logs = [simulate(scenario, seed=seed, log_period=ms(20)) for seed in range(seeds)]
    rms = np.sqrt(np.mean([np.mean(errors(log) ** 2) for log in logs]))
    return logs, rms, max(errors(log).max() for log in logs)


@pytest.mark.parametrize("reference", ["circle", "eight", "waypoints"])
def test_horizon_law_tracks_references_on_the_full_loop(reference):
    logs, rms, most = fly("horizon", reference=reference)
    _, other, other_most = fly("lyapunov", reference=reference)
    solved = np.mean([log["law.solved"][log.t > 1].mean() for log in logs])
    print(
        f"{reference}: horizon rms {1000 * rms:.0f} mm, most {1000 * most:.0f}, {100 * solved:.1f} % solved; "
        f"Lyapunov rms {1000 * other:.0f} mm, most {1000 * other_most:.0f}"
    )
    assert rms < 0.08
    assert most < 0.25
    assert solved > 0.9


def test_plan_is_flown_on_the_full_loop_without_collision(tmp_path):
    task = read_task(HALL)
    plan = plan_path(task)
    (tmp_path / "plan.csv").write_text(plan.table())
    logs, rms, most = fly("horizon", reference=str(tmp_path / "plan.csv"), duration="60")
    least = min(task.floor.clearance(np.column_stack([log["truth.north"], log["truth.east"]])).min() for log in logs)
    print(f"plan: rms {1000 * rms:.0f} mm, most {1000 * most:.0f}; nearest {100 * (least - task.radius):.0f} cm")
    assert least > task.radius
    assert (
        np.hypot(*(np.array([logs[0]["law.north_reference"][-1], logs[0]["law.east_reference"][-1]]) - task.goal)) < 0.2
    )
