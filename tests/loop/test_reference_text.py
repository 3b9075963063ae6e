"""References as texts: parsing, invalid texts, and their use in scenarios and logs."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import to_arrays
from trimtab.core.reference import Circle, FigureEight, ReferencePoint, interpolate_path, pass_waypoints
from trimtab.core.time import ms, seconds
from trimtab.loop.reference_text import FORMS, parse_reference, plain_text, start_pose
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario

TABLE = """time [s],north [cm],east [m],heading [deg]
0,0,0,0
2,10,0.1,10
4,30,0.3,20
6,60,0.4,30
8,90,0.5,40
10,120,0.7,50
"""


@jax.jit
def points_of(path):
    return [path.at(t) for t in (0.0, 1.7, 6.0, 30.0)]


def assert_same(a, b):
    for one, other in zip(points_of(to_arrays(a)), points_of(to_arrays(b)), strict=True):
        for name in ("place", "velocity", "acceleration", "jerk", "snap", "heading"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9)


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("circle", Circle()),
        ("circle()", Circle()),
        ("circle(radius=150 cm, period=0.5 min, clockwise=false)", Circle(1.5, 30.0, clockwise=False)),
        ("eight(length=6, axis=90 deg)", FigureEight(length=6.0, axis=np.pi / 2)),
        ("waypoints(0 0, 3 0, 3 3; speed=0.5)", pass_waypoints([[0, 0], [3, 0], [3, 3]], 0.5)),
        ("waypoints(0m 0cm, 300cm 0, 3 3; speed=50 cm/s)", pass_waypoints([[0, 0], [3, 0], [3, 3]], 0.5)),
        ("waypoints(0 0, 3 0, 3 3 0.3)", pass_waypoints([[0, 0], [3, 0], [3, 3]], [0.4, 0.3])),
    ],
)
def test_parses_each_reference_text(text, same):
    assert_same(parse_reference(text), same)


@pytest.mark.thorough
def test_reads_a_csv_path_with_units(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(TABLE)
    places = np.array([[0, 0], [0.1, 0.1], [0.3, 0.3], [0.6, 0.4], [0.9, 0.5], [1.2, 0.7]])
    same = interpolate_path(np.arange(6) * 2.0, places, np.radians(np.arange(6) * 10.0))
    assert_same(parse_reference(str(file)), same)
    assert_same(parse_reference(plain_text(str(file))), same)
    assert bool(parse_reference(str(file)).has_heading)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("square(side=3)", "is not a reference"),
        ("circle(", "is not a reference"),
        ("waypoints", "is not a reference"),
        ("circle(radios=3)", "is not a setting of Circle"),
        ("circle(radius=three)", "'three' is not a number"),
        ("circle(radius=3 kg)", "not a unit"),
        ("circle(clockwise=perhaps)", "must be true or false"),
        ("plan.txt", "is not a reference path; the name of a file must end in .csv"),
        ("circle(radius=1, radius=2)", "radius is given twice"),
        ("circle(period=0)", "Circle.period: 0.0 s is out of range"),
        ("circle(radius=nan)", "Circle.radius: nan is not finite"),
        ("waypoints(0 0, inf 0)", "inf is not finite"),
        ("waypoints(0 0, 3 0; speed=3 kg)", "not a unit"),
        ("waypoints(0 0, 3)", "must be 2 or 3 numbers with spaces between them, got 1"),
        ("waypoints(0 0, 3 0; tempo=3)", "is not speed=NUMBER"),
        ("places(0 s: 0 0, 3 0)", "is not TIME: NORTH EAST"),
        ("places(0: 0 0 1, 1: 1 0)", "some positions have a heading"),
        ("places(0: 0 0, 1: 1 0)", "needs at least 6 of them, got 2"),
        ("places(0: 0 0, 5: 1 0, 4: 2 0)", "time 4 s must be after 5 s"),
        ("nowhere.csv", "nowhere.csv"),
    ],
)
def test_rejects_invalid_reference_texts(text, problem):
    with pytest.raises(InputError, match=problem) as refused:
        parse_reference(text)
    assert refused.value.fix


@pytest.mark.thorough
def test_vehicle_starts_at_rest_at_the_start_of_the_path():
    built = build("hovercraft/track", {"reference": "waypoints(1 2, 1 5; speed=0.3)"})
    arm = float(built.autopilot.law.model.percussion_arm)
    x = built.initial
    np.testing.assert_allclose([x.north, x.east + arm, x.heading, x.yaw_rate], [1, 2, np.pi / 2, 0], atol=1e-6)
    there = build("hovercraft/track", {"reference": "circle()", "initial.north": "0.5"}).initial
    assert float(there.north) == 0.5
    assert start_pose(Circle(), 0.0)[:2] == pytest.approx((1.5, 0.0))


def test_each_suggested_path_is_accepted():
    for text in FORMS[:4]:
        parse_reference(text)


@pytest.mark.parametrize(
    ("heading", "pose"), [(None, (0, -2, np.pi / 2)), (0.5, (-2 * np.cos(0.5), -2 * np.sin(0.5), 0.5))]
)
def test_start_pose_follows_the_first_motion_or_the_heading_of_the_path(heading, pose):
    class Late:
        """Path that moves east after 30 s."""

        def at(self, t):
            zero = np.zeros(2)
            place = np.array([0.0, max(t - 30, 0)])
            return ReferencePoint(place, zero, zero, zero, zero, heading or 0.0, heading is not None)

    assert start_pose(Late(), 2.0) == pytest.approx(pose, abs=1e-12)


def test_headings_turn_the_shorter_way_between_positions():
    texts = [f"{4 * k}: {k} 0 {heading}deg" for k, heading in enumerate((350, 355, 0, 5, 10, 15))]
    path = parse_reference(f"places({', '.join(texts)})")
    ends = path.coefficients[:, :, 2] @ np.power(20.0, np.arange(6))
    np.testing.assert_allclose(np.degrees(ends), 375, atol=1e-9)


@pytest.mark.thorough
def test_named_reference_stays_a_scenario_choice():
    assert build("hovercraft/track", {"reference": "eight"}).choices["arguments"] == {"reference": "eight"}
    own = build("hovercraft/track", {"reference": "eight(length=6)"})
    assert own.choices["settings"] == {"reference": "eight(length=6)"}
    assert float(own.autopilot.law.reference.length) == 6.0


def test_rejects_a_reference_for_laws_without_path_following():
    for name in ("hovercraft/forward", "hovercraft/spin"):  # of which one has a number of that name
        with pytest.raises(InputError, match="cannot follow a path") as refused:
            build(name, {"reference": "circle()"})
        assert "hovercraft/track" in refused.value.fix


@pytest.mark.thorough
def test_infeasible_reference_is_rejected_before_the_run():
    with pytest.raises(InputError, match=r"2\.60 N forward"):
        build("hovercraft/track", {"reference": "circle(period=8 s)"})


@pytest.mark.thorough
def test_log_restores_the_reference_without_its_file(tmp_path):
    file = tmp_path / "path.csv"
    rows = [f"{t},{np.sin(t / 8)},{1 - np.cos(t / 8)}" for t in range(0, 40, 4)]
    file.write_text("\n".join(["time [s],north [m],east [m]", *rows]))
    built = build("hovercraft/track", {"reference": str(file), "duration": "1 s"})
    log = simulate(built, log_period=ms(50))
    file.unlink()
    again = rebuild_scenario(log)
    assert again.duration == seconds(1)
    np.testing.assert_array_equal(
        again.autopilot.law.reference.coefficients, built.autopilot.law.reference.coefficients
    )
