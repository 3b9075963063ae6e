"""Updates of a log: scalar ones and single ranges, each once; and states that no sensor corrected."""

import numpy as np
import pytest

from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.navigation import (
    BY_HEADING,
    BY_POSITION,
    assess_navigation,
    find_updates,
    fix_paths,
    innovations,
    state_series,
    unaided_states,
)

BASE = "estimate.state"
FIX = f"{BASE}.position_fix"
STATES = ("heading", "gyro_bias", "yaw_rate", *BY_POSITION)


def log_of(n, signals):
    t = np.arange(n) * ms(10)
    return Log(t=to_seconds(t), ticks=t, signals=signals)


def aided(n, **used):
    """A valid estimate of every state; how many fixes of each kind were used by the end."""
    g = np.random.default_rng(0)
    signals = {}
    for name in STATES:
        sigma = 38.0 if name in BY_POSITION else 0.01
        signals |= {f"{BASE}.{name}": sigma * g.standard_normal(n), f"{BASE}.sigma_{name}": np.full(n, sigma)}
        signals[f"truth.{name}"] = np.zeros(n)
    for name, count in used.items():
        z = g.standard_normal((n, 1))
        fix = {
            "nis": z[:, 0] ** 2,
            "normalised": z,
            "used": np.minimum(np.arange(n), count),
            "rejected": np.zeros(n, int),
        }
        signals |= {f"{BASE}.{name}_fix.{k}": v for k, v in fix.items()}
    return log_of(n, signals)


@pytest.mark.parametrize(
    ("used", "alone"),
    [
        ({"heading": 400, "position": 0}, set(BY_POSITION)),
        ({"heading": 0, "position": 0}, {*BY_POSITION, *BY_HEADING}),
        ({"heading": 0, "position": 400}, set()),
        ({"heading": 400, "position": 400}, set()),
        ({"heading": 400}, set()),  # such a log doesn't say what became of positions
    ],
)
def test_unaided_states_are_excluded_from_assessment(used, alone):
    log = aided(400, **used)
    assert unaided_states(log) == alone
    assert set(state_series(log)) == set(STATES) - alone
    found = assess_navigation(log)
    assert set(found.learned) == set(STATES) - alone
    assert ("position" in found.errors, "heading" in found.errors) == ("north" not in alone, "heading" not in alone)


def test_no_state_is_unaided_without_a_valid_estimate():
    """The aiding may not have started yet; an error budget counts such a run as infinitely wrong."""
    log = aided(400, heading=400, position=0)
    never = Log(t=log.t, ticks=log.ticks, signals={**log.signals, "estimate.valid": np.zeros(400, bool)})
    assert unaided_states(never) == frozenset()
    assert all(len(s.t) == 0 for s in state_series(never).values())
    assert "north" in state_series(never)


def test_excluding_states_narrows_the_bonferroni_bounds():
    """Bonferroni over five rows, not eight: the same errors get narrower bounds."""
    n = 400
    few, all_ = (assess_navigation(aided(n, heading=n, position=used)) for used in (0, n))
    assert few.errors["heading"].draws == all_.errors["heading"].draws
    assert few.errors["heading"].low > all_.errors["heading"].low


@pytest.fixture(scope="module")
def ranged():
    """Pings of three beacons each 50 ms, rows each 10 ms: a start, single ranges missing, gated, disagreeing."""
    n, pings = 2000, 400
    g = np.random.default_rng(1)
    heard = g.random((pings, 3)) < 0.8
    wrong = heard & (g.random((pings, 3)) < 0.05)
    disagree = heard & ~wrong & (g.random((pings, 3)) < 0.05)
    tracking = np.arange(pings) >= 4
    z = np.where(wrong, 9.0, g.standard_normal((pings, 3)))
    ran = np.append(False, tracking[:-1])
    z = np.where(heard & ~disagree & ran[:, None], z, 0.0)
    accepted = (z != 0) & ~wrong & ran[:, None]
    refused = heard & ~accepted & ran[:, None]
    in_a_row = np.zeros((pings, 3), int)
    for k in range(pings):
        before = in_a_row[k - 1] if k else 0
        in_a_row[k] = np.where(accepted[k], 0, before + refused[k])
    at = np.arange(n) // 5
    used = np.cumsum(np.where(ran, accepted.sum(1), heard.sum(1)))
    values = {
        "innovation": 0.004 * z,
        "normalised": z,
        "nis": z**2,
        "accepted": accepted,
        "beacon_rejected_in_a_row": in_a_row,
        "tracking": tracking,
        "used": used,
        "rejected": np.cumsum(refused.sum(1)),
    }
    return z, refused, log_of(n, {f"{FIX}.{k}": v[at] for k, v in values.items()} | {f"{BASE}.sigma_heading": at * 0.0})


def test_each_range_is_an_update_of_one_degree_of_freedom(ranged):
    z, refused, log = ranged
    assert fix_paths(log) == {"range": FIX}
    t, nis, dof = innovations(log)["range"]
    assert dof == 1
    came = z != 0
    np.testing.assert_allclose(nis, z[came] ** 2)  # ping by ping, beacon by beacon
    np.testing.assert_allclose(t, np.broadcast_to(0.05 * np.arange(len(z))[:, None], z.shape)[came])
    found = find_updates(log, FIX, -np.inf)
    assert (found.refusals, found.missed_updates) == (int(refused.sum()), 0)
    assert found.normalised_innovations.shape == (len(nis), 1)


def test_updates_between_log_rows_are_counted_as_missed(ranged):
    _, _, log = ranged
    few = slice(None, None, 15)
    coarse = Log(t=log.t[few], ticks=log.ticks[few], signals={p: log[p][few] for p in log.paths})
    found, every = find_updates(coarse, FIX, -np.inf), find_updates(log, FIX, -np.inf)
    assert 0.5 * len(every.nis) < found.missed_updates < 0.8 * len(every.nis)
