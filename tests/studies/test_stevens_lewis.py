"""The F-16's printed numbers: each row holds, and fails with a perturbed model."""

import numpy as np
import pytest
from scipy.linalg import expm

from studies.stevens_lewis import check_case, ground_avoidance, lateral_regulator, linear, trims
from trimtab.core.record import replace
from trimtab.study import list_groups
from trimtab.vehicles.f16_flat_earth import F16FlatEarth

GROUPS = {group.name: group for group in list_groups("stevens_lewis")}


@pytest.mark.thorough
@pytest.mark.parametrize("name", GROUPS)
def test_rows_hold(name):
    rows = list(GROUPS[name].rows())
    assert len({r.id for r in rows}) == len(rows) > 2
    assert [r.id for r in rows if r.fails] == []
    assert [r.id for r in rows if not r.must_hold and r.holds] == [], "said not to be reproduced, but it is"


@pytest.mark.thorough
def test_picture_is_written(tmp_path):
    (file,) = ground_avoidance.figures(tmp_path / "new")
    assert file.read_bytes().startswith(b"\x89PNG")


def broken(module, monkeypatch, **changes):
    """Return the failing rows of a module when every F-16 has other parameters."""
    craft = replace(F16FlatEarth(), **changes)
    monkeypatch.setattr(module, "F16FlatEarth", lambda: craft)
    trims.find_trim.cache_clear()
    linear.linear_model.cache_clear()
    failed = [row.id for row in module.rows() if row.fails]
    monkeypatch.undo()
    trims.find_trim.cache_clear()
    linear.linear_model.cache_clear()
    return failed


@pytest.mark.thorough("changes1-pitch_rate", "changes2-speed")
@pytest.mark.parametrize(
    ("changes", "fails"),
    [
        ({"mass": 9300 * 1.001}, "speed"),
        ({"engine_momentum": 0.0}, "pitch_rate"),
        ({"gravity": 9.81}, "speed"),
    ],
)
def test_check_case_fails_with_a_perturbed_aircraft(monkeypatch, changes, fails):
    if "engine_momentum" in changes:
        monkeypatch.setattr(check_case, "MOMENTUM", 0.0)
    assert fails in broken(check_case, monkeypatch, **changes)


@pytest.mark.thorough
def test_trim_and_linear_rows_fail_with_a_perturbed_aircraft(monkeypatch):
    assert {"nominal/alpha", "aft/throttle"} <= set(broken(trims, monkeypatch, mass=9400.0))
    assert any("roll_rate" in id for id in broken(linear, monkeypatch, inertia=F16FlatEarth().inertia * 1.01))


@pytest.mark.thorough
def test_printed_gains_are_optimal_with_misprint_and_one_sign():
    """The cost is computed by quadrature of the free response, not by the study's own equation."""
    loop = lateral_regulator.lateral_loop()
    closed = loop.A - loop.B @ lateral_regulator.PRINTED @ loop.C
    K = lateral_regulator.PRINTED @ loop.C
    weight = lateral_regulator.Q + K.T @ lateral_regulator.R @ K
    step = expm(closed * 1e-3)
    phi, total = np.eye(7), 0.0
    for i in range(20_000):
        total += (0.5 if i == 0 else 1.0) * np.trace(phi.T @ weight @ phi)
        phi = step @ phi
    assert loop.cost(lateral_regulator.PRINTED)[0] == pytest.approx(0.5e-3 * total, rel=1e-4)
    other = lateral_regulator.PRINTED * np.where(np.arange(8).reshape(2, 4) == 2, -1.0, 1.0)
    assert loop.cost(other)[0] > 1.005 * loop.cost(lateral_regulator.PRINTED)[0]
    loop.A[1, 3] = np.tan(0.03691)
    assert (
        loop.cost(lateral_regulator.PRINTED)[0]
        > (1 + lateral_regulator.COST_EXCESS_MAX) * loop.cost(lateral_regulator.find_gains(loop)[0])[0]
    )
    lateral_regulator.lateral_loop.cache_clear()


def test_both_failing_check_case_rows_have_one_cause():
    """A rolling moment less by LESS of its coefficient gives both printed numbers, by the program's constants."""
    craft = replace(F16FlatEarth(), centre=0.4)
    turn = check_case.turn_by_constants(craft)
    V, h = 500.0, 10_000.0
    pressure = 0.5 * 2.377e-3 * (1 - 0.703e-5 * h) ** 4.14 * V**2
    less = check_case.LESS * pressure * 300 * 30
    corrected = turn - np.array([check_case.C3, 0.0, check_case.C4]) * less
    printed = [check_case.PRINTED[name][0] for name in ("roll_rate", "pitch_rate", "yaw_rate")]
    np.testing.assert_allclose(corrected, printed, rtol=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize(("start", "aerobench"), [("dive", 406.93), ("inverted", 960.87)])
def test_oracle_minimum_altitude_matches_study_and_aerobench(start, aerobench):
    """The last number was printed by AeroBenchVV 2 itself, whose tables have a few slips."""
    from oracles import f16_ground_avoidance

    lowest = f16_ground_avoidance.fly(start).min()
    assert lowest == pytest.approx(ground_avoidance.LOWEST[start], abs=0.01)
    assert lowest == pytest.approx(aerobench, abs=0.5)
