"""The verdict of one run is right for nearly every run with sensors quieter than, equal to, or noisier than assumed."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, MEMS, NEAR, QUICK, TICK, draws, own_model, ticks, turn

from trimtab.core.record import replace, to_arrays
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.mechanisation import Belief
from trimtab.estimators.inertial.navigation_state import reference_kinematics
from trimtab.logs.log import Log
from trimtab.logs.navigation import assess_navigation, innovations, state_series

N, RUNS, EVERY = 1500, 40, 15
STATES = ("heading", "north", "east", "surge_velocity", "sway_velocity", "gyro_bias", "forward_bias", "starboard_bias")
SCALED = ("gyro", "gyro_walk", "forward", "starboard", "force_walk", "heading", "position")
BASE = "estimate.state"


@pytest.fixture(scope="module")
def flown():
    """Truth and estimates of RUNS runs by the factor between the sensors' noise and what the filter believes."""
    form, truth = to_arrays(AidedInertialFeedforward(noise=MEMS, start=NEAR)), turn(ticks(N))

    def one(sensors, run):
        found = own_model(form, truth, draws(run, N), every=EVERY, sensors=sensors)
        return found, jax.vmap(lambda x, P: reference_kinematics(Belief(x, P), 0.0, 0.0, form.arms))(found.x, found.P)

    go = jax.jit(jax.vmap(one, (None, 0)), compiler_options=QUICK)

    def fly(factor):
        sensors = to_arrays(replace(MEMS, **{name: getattr(MEMS, name) * factor**2 for name in SCALED}))
        return [
            jax.tree.map(lambda a, r=r: np.asarray(a[r]), out)
            for out in [go(sensors, jnp.arange(RUNS))]
            for r in range(RUNS)
        ]

    return {factor: [log_of(*run) for run in fly(factor)] for factor in (0.5, 1.0, 2.0)}


def log_of(found, state):
    """A run as its log: headings at each tick, positions at every 15th; the last fix is held between."""
    true = found.x - found.error
    c, s = np.cos(true[:, 0]), np.sin(true[:, 0])
    values = (true[:, 0], true[:, 3], true[:, 4], c * true[:, 1] + s * true[:, 2], -s * true[:, 1] + c * true[:, 2])
    signals = dict(zip([f"truth.{n}" for n in STATES], [*values, *true[:, 5:].T], strict=True))
    for name in STATES:
        signals |= {f"{BASE}.{name}": state[name], f"{BASE}.sigma_{name}": state[f"sigma_{name}"]}
    count, none = np.arange(N), np.zeros(N, np.int32)
    position = found.position_nis, found.position_innovation, count // EVERY + 1
    heading = found.heading_nis, found.heading_innovation[:, None], count + 1
    for name, (nis, normalised, used) in (("heading", heading), ("position", position)):
        fix = f"{BASE}.{name}_fix"
        signals |= {f"{fix}.nis": nis, f"{fix}.normalised": normalised, f"{fix}.used": used, f"{fix}.rejected": none}
    t = count * TICK
    return Log(t=to_seconds(t), ticks=t, signals=signals)


@pytest.mark.thorough
@pytest.mark.parametrize(("factor", "verdict"), [(0.5, "pessimistic"), (1.0, "consistent"), (2.0, "optimistic")])
def test_verdict_is_right_in_nine_of_ten_runs(flown, factor, verdict):
    found = [assess_navigation(log) for log in flown[factor]]
    assert np.mean([f.verdict == verdict for f in found]) >= 0.9
    for name in ("heading", "position"):
        rows = [f.aiding[name].nis for f in found]
        assert np.mean([r.factor_low <= factor <= r.factor_high for r in rows]) >= 0.9  # a gate of 0.9999 cuts little
        assert np.mean([r.factor for r in rows]) == pytest.approx(factor, rel=0.04)
        assert np.mean([r.verdict == verdict for r in rows]) >= 0.9


@pytest.mark.thorough
def test_error_intervals_have_the_stated_coverage(flown):
    """The interval is wide for correlated errors and has the stated coverage."""
    found = [assess_navigation(log) for log in flown[1.0]]
    for group in ("heading", "velocity", "position", "gyro bias", "force bias"):
        rows = [f.errors[group] for f in found]
        assert np.mean([r.factor_low <= 1 <= r.factor_high for r in rows]) >= 0.9, group
        assert np.median([r.draws for r in rows]) < 40, "errors that last seconds are not that many draws in ten"


@pytest.mark.thorough
def test_each_update_counts_once_where_its_counter_rises(flown):
    """Rows of 1 ms hold each update six or seven times; each update is counted once."""
    log = flown[1.0][0]
    rows = np.arange(0, int(log.ticks[-1]), ms(1))
    at = np.searchsorted(log.ticks, rows, side="right") - 1
    held = Log(t=to_seconds(rows), ticks=rows, signals={p: log[p][at] for p in log.paths})
    for name, (_, nis, dof) in innovations(held).items():
        kept, _, width = innovations(log)[name][1], None, innovations(log)[name][2]
        np.testing.assert_array_equal(nis, kept[: len(nis)])
        assert (len(kept) - len(nis) <= 1, dof) == (True, width)
    slow = rows[::10]
    coarse = Log(t=to_seconds(slow), ticks=slow, signals={p: held[p][::10] for p in held.paths})
    assert assess_navigation(coarse).aiding["heading"].unseen > 100
    assert assess_navigation(held).aiding["heading"].unseen == 0


def test_delayed_estimate_is_compared_with_truth_of_its_time():
    """At 3 rad/s, a perfect estimate that is 40 ms old has no error, although the current truth is 0.12 rad ahead."""
    t = np.arange(0, ms(2000), ms(1))
    heading = 3.0 * to_seconds(t)
    told = {"heading": heading - 0.12, "sigma_heading": np.full(len(t), 0.01), "coasting": t >= ms(1500)}
    signals = {"truth.heading": heading, "estimate.age": np.full(len(t), 0.04)}
    log = Log(t=to_seconds(t), ticks=t, signals=signals | {f"{BASE}.{n}": v for n, v in told.items()})
    found = state_series(log)["heading"]
    early = (found.t > 0.01) & (found.t < 1.44)
    np.testing.assert_allclose(found.error[early], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.error[-1], -0.12, atol=1e-12)  # coasting: it speaks of now
    turned = Log(t=log.t, ticks=t, signals={**log.signals, f"{BASE}.heading": heading - 0.12 + 4 * np.pi})
    np.testing.assert_allclose(state_series(turned)["heading"].error, found.error, atol=1e-12)


def test_bias_trends_distinguish_settled_and_unsettled_states():
    """A bias that has converged, one still converging, one never observed, and a drifting heading."""
    t = np.arange(0, ms(20_000), ms(10))
    s = to_seconds(t)
    sigmas = {
        "gyro_bias": 0.001 + 0.1 * np.exp(-s),
        "forward_bias": 0.1 / np.sqrt(1 + 10 * s),
        "starboard_bias": np.full(len(t), 0.2),
        "heading": 0.01 + 0.01 * s,
    }
    signals = {f"{BASE}.{n}": np.zeros(len(t)) for n in sigmas} | {f"{BASE}.sigma_{n}": v for n, v in sigmas.items()}
    fix = {
        "nis": np.ones(len(t)),
        "normalised": np.ones((len(t), 1)),
        "used": np.arange(len(t)),
        "rejected": np.zeros(len(t), int),
    }
    log = Log(t=s, ticks=t, signals=signals | {f"{BASE}.heading_fix.{n}": v for n, v in fix.items()})
    found = assess_navigation(log).learned
    trends = {n: found[n].trend for n in sigmas}
    assert trends == {
        "gyro_bias": "converged",
        "forward_bias": "converging",
        "starboard_bias": "unseen",
        "heading": "growing",
    }
    level = 1.5 * (0.001 + 0.1 * np.exp(-10.0))
    assert found["gyro_bias"].settled_s == pytest.approx(-np.log((level - 0.001) / 0.1), abs=0.02)
    assert assess_navigation(log).errors == {}


@pytest.mark.thorough
def test_log_without_sigmas_has_no_verdict(flown):
    log = flown[1.0][0]
    bare = {p: log[p] for p in log.paths if not p.startswith("estimate.")}
    assert assess_navigation(Log(t=log.t, ticks=log.ticks, signals=bare)) is None
    assert state_series(Log(t=log.t, ticks=log.ticks, signals=bare)) == {}


@pytest.mark.thorough
def test_short_log_is_undecided(flown):
    """Half a second is too short for a verdict; ten times the assumed noise is still detected."""
    short = assess_navigation(flown[1.0][3].between(0.0, 0.3))
    assert short.errors["heading"].verdict == "undecided"
    wrong = flown[1.0][3].between(0.0, 5.0)
    signals = {p: wrong[p] * (0.1 if "sigma_" in p else 1.0) for p in wrong.paths}
    found = assess_navigation(Log(t=wrong.t, ticks=wrong.ticks, signals=signals))
    assert found.errors["velocity"].verdict == found.verdict == "optimistic"


@pytest.mark.thorough
def test_assessment_round_trips_through_json(flown):
    found = assess_navigation(flown[1.0][0])
    again = json.loads(json.dumps(found.plain()))
    assert again["aiding"]["heading"]["nis"]["verdict"] == found.aiding["heading"].nis.verdict
    assert again["learned"]["gyro_bias"]["settled_s"] == found.learned["gyro_bias"].settled_s
    assert DT * found.aiding["heading"].updates < N * DT
