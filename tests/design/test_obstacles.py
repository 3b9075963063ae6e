"""Distances against a brute-force search over dense outlines; and the errors for invalid files."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design.obstacles import ObstacleFloor, parse_task, read_task

SQUARE = np.array([[1.0, 1], [2, 1], [2, 3], [1, 3]])
BENT = np.array([[-3.0, -3], [-1, -3], [-1, -1], [-2, -2], [-3, -1]])
FLOOR = ObstacleFloor((-4, 4), (-5, 5), np.array([[0, 0, 0.5], [-2, 3, 1.0]]), (SQUARE, BENT))
CONTENT = {
    "floor": {"north": [-4, 4], "east": [-4, 4]},
    "craft": {"radius": 0.4},
    "start": {"north": -3, "east": -3, "heading": "90 deg"},
    "goal": {"north": 3, "east": 3},
    "circle": [{"north": 0, "east": 0, "radius": 0.8}],
    "polygon": [{"corners": [[1, 1], [2, 1], [2, 2]]}],
}


def outline():
    """Places on every edge, 2 mm apart."""
    angle = np.linspace(0, 2 * np.pi, 4000)
    circles = [[n + r * np.cos(angle), e + r * np.sin(angle)] for n, e, r in FLOOR.circles]
    share = np.linspace(0, 1, 2000)[:, None]
    corners = np.array([[-4, -5], [4, -5], [4, 5], [-4, 5]])
    edges = [a + share * (b - a) for c in (*FLOOR.polygons, corners) for a, b in zip(c, np.roll(c, -1, 0), strict=True)]
    return np.vstack([*(np.transpose(c) for c in circles), *edges])


def test_clearance_is_distance_to_the_nearest_edge():
    rng = np.random.default_rng(1)
    places = rng.uniform([-4, -5], [4, 5], (300, 2))
    nearest = [np.hypot(*(outline() - p).T).min() for p in places]
    np.testing.assert_allclose(np.abs(FLOOR.clearance(places)), nearest, atol=3e-3)


@pytest.mark.parametrize(
    ("place", "inside"),
    [
        ((0, 0.4), True),
        ((1.5, 2), True),
        ((-2, -2.5), True),
        ((-1.5, -2), True),
        ((-4.5, 0), True),
        ((-2, -1.9), False),
    ],
)
def test_clearance_is_negative_inside_obstacles(place, inside):
    assert (FLOOR.clearance([place])[0] < 0) == inside


def test_empty_floor_clearance_is_distance_to_its_edges():
    assert ObstacleFloor((0, 2), (0, 6), np.zeros((0, 3))).clearance([(0.5, 3)])[0] == pytest.approx(0.5)


def test_reads_task_from_toml_file(tmp_path):
    text = "[floor]\nnorth = [-4, 4]\neast = [-4, 4]\n[craft]\nradius = 0.4\n[start]\nnorth = -3\neast = -3\n"
    file = tmp_path / "hall.toml"
    file.write_text(text + "[goal]\nnorth = 3\neast = 3\n[[circle]]\nnorth = 0\neast = 0\nradius = 0.8\n")
    task = read_task(file)
    assert (task.start, task.goal, task.radius, task.heading) == ((-3, -3), (3, 3), 0.4, None)
    np.testing.assert_array_equal(task.floor.circles, [[0, 0, 0.8]])
    assert parse_task(CONTENT).heading == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"floor": {"north": [4, -4], "east": [-4, 4]}}, r"north must be \[FROM, TO\] .* got \[4, -4\]"),
        ({"goal": {"north": 3}}, r"\[goal\]: east is missing"),
        ({"goal": {"north": 3, "east": 3, "heading": 0}}, "unknown setting 'heading'"),
        ({"start": {"north": -3, "east": -3, "headng": 0}}, "unknown setting 'headng'"),
        ({"circle": {"north": 0, "east": 0, "radius": 1}}, r"\[circle\] must be a list of sections"),
        ({"polygon": 3}, r"\[polygon\] must be a list of sections"),
        ({"start": {"north": -3, "east": -3, "heading": 90}}, "at most one turn, got 90 rad"),
        ({"start": {"north": -3, "east": -3, "heading": True}}, "must be an angle, got True"),
        ({"craft": {"radius": 0}}, "radius must be above 0, got 0"),
        ({"circles": []}, r"unknown section \[circles\]"),
        ({"circle": [{"north": 0, "east": "x", "radius": 1}]}, "circle.* 1: east must be a number of metres, got 'x'"),
        ({"polygon": [{"corners": [[1, 1], [2, 2]]}]}, "must be three or more pairs"),
        ({"start": {"north": -3, "east": -3, "heading": "90 m"}}, "heading"),
    ],
)
def test_rejects_invalid_values(change, says):
    with pytest.raises(InputError, match=says):
        parse_task(CONTENT | change)


@pytest.mark.parametrize("section", ["floor", "craft", "start", "goal"])
def test_names_missing_section(section):
    with pytest.raises(InputError, match=rf"\[{section}\] is missing"):
        parse_task({k: v for k, v in CONTENT.items() if k != section})


def test_rejects_missing_file_and_invalid_toml(tmp_path):
    with pytest.raises(InputError, match="the file does not exist"):
        read_task(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("floor = ")
    with pytest.raises(InputError, match="not valid TOML"):
        read_task(tmp_path / "bad.toml")
