"""Both laws for rest at a place and a heading, on the full loop: distance from the goal.

Bands are regression bands around results of this package, over eight seeds.
"""

import numpy as np
import pytest

from trimtab.core.rotation import wrap
from trimtab.core.time import ms
from trimtab.run.simulate import simulate_many
from trimtab.scenarios import catalogue

SETTLED = 40.0
BANDS = {"swing": (0.10, 4.0), "steps": (0.30, 50.0)}
"""m and degrees: most, of the root mean square of a flight's rest."""


@pytest.mark.thorough
@pytest.mark.parametrize("law", BANDS)
def test_craft_stays_near_the_goal_pose(law):
    scenario, _ = catalogue.load_scenario("hovercraft/pose", {"law": law})
    logs = simulate_many(scenario, seeds=range(8), log_period=ms(20), signals=("truth", "law"))
    rests = []
    for log in logs:
        late = log.t > SETTLED
        away = np.hypot(log["truth.north"], log["truth.east"])[late]
        turned = np.degrees(wrap(log["truth.heading"]))[late]
        rests.append((np.sqrt(np.mean(away**2)), np.sqrt(np.mean(turned**2)), away.max()))
    middle = np.median(rests, axis=0)
    print(f"{law}: median rms {middle[0]:.2f} m, {middle[1]:.1f} deg; farthest {max(r[2] for r in rests):.2f} m")
    assert middle[0] < BANDS[law][0]
    assert middle[1] < BANDS[law][1]
    assert max(r[2] for r in rests) < (0.25 if law == "swing" else 0.9)
