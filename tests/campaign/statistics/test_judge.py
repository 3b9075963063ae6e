"""Success as it is typed, on a batch, against logs one by one."""

import numpy as np
import pytest

from trimtab.campaign.search.stability_map import parse_success
from trimtab.core.errors import InputError
from trimtab.core.time import ms, seconds
from trimtab.run.batch import simulate_batch
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build


def test_conditions_are_those_of_each_log():
    scenario = build("hovercraft/zero-velocity", {"duration": "4"})
    judge, signals = parse_success(scenario, ["peak:truth.surge_velocity <= 0.75", "error_rms:yaw_rate < 3.5"])
    assert signals == ("truth.surge_velocity", "truth.yaw_rate")
    batch = simulate_batch(scenario, seeds=range(24), signals=signals, log=True, log_period=ms(10))
    found = judge(batch)
    assert 0 < found.sum() < 24
    for seed in (0, 5, 11, 23):
        log = simulate(scenario, seed=seed, log_period=ms(10), duration=seconds(4))
        late = log.t >= log.t[-1] / 2
        surge = np.abs(log["truth.surge_velocity"]).max() <= 0.75
        yaw = np.sqrt(np.mean(log["truth.yaw_rate"][late] ** 2)) < 3.5
        assert found[seed] == (surge and yaw)


def test_a_condition_on_what_there_is_not_is_refused():
    scenario = build("hovercraft/zero-velocity")
    with pytest.raises(InputError, match="no target"):
        parse_success(scenario, ["settling:heading <= 3"])
