"""Dubins' paths: known lengths, no shorter way by brute force or by a numerical optimiser, and derivatives that fit."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from trimtab.core.errors import InputError
from trimtab.design.dubins_paths import TURNS, WORDS, DubinsPath, dubins_path, shortest_path, word_of

RNG = np.random.default_rng(7)
HOME = np.zeros(3)
NEAR = [np.append(RNG.uniform(-2.5, 2.5, 2), RNG.uniform(-np.pi, np.pi)) for _ in range(12)]
FAR = [np.append(RNG.uniform(-6, 6, 2), RNG.uniform(-np.pi, np.pi)) for _ in range(12)]
MIRROR = str.maketrans("LR", "RL")


def end_of(path):
    """North, east and heading where a path ends."""
    point = path.at(path.length / path.speed)
    return np.append(np.asarray(point.place), float(point.heading))


def is_pose(pose, goal, tolerance=1e-9):
    turn = (pose[2] - goal[2] + np.pi) % (2 * np.pi) - np.pi
    return max(abs(pose[0] - goal[0]), abs(pose[1] - goal[1]), abs(turn)) < tolerance


def follow(curvatures, lengths):
    """Where pieces of constant curvature (…, n) lead from the origin, heading north: (…, 3). Radius 1."""
    x, y, h = (np.zeros(lengths.shape[:-1]) for _ in range(3))
    for k in range(lengths.shape[-1]):
        half = curvatures[..., k] * lengths[..., k] / 2
        chord = lengths[..., k] * np.sinc(half / np.pi)
        x, y, h = x + chord * np.cos(h + half), y + chord * np.sin(h + half), h + 2 * half
    return np.stack([x, y, h], axis=-1)


def test_shortest_path_matches_known_lengths():
    """Straight on; half a circle; turned round on the spot by arcs of 60, 300 and 60 degrees."""
    assert float(shortest_path(HOME, (5, 0, 0), 1.0).length) == pytest.approx(5.0)
    half = shortest_path(HOME, (0, 3, np.pi), 1.5)
    assert float(half.length) == pytest.approx(1.5 * np.pi)
    assert "R" in word_of(half)
    turn = shortest_path(HOME, (0, 0, np.pi), 2.0)
    assert word_of(turn) in ("LRL", "RLR")
    np.testing.assert_allclose(turn.lengths, 2.0 * np.pi * np.array([1, 5, 1]) / 3, rtol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.5, 2.9, -3.0])
@pytest.mark.parametrize("heading", [0.3, -2.0, 4.4])
def test_goal_on_the_turning_circle_takes_one_arc(turn, heading):
    """Where rounding would make a full turn of none, and no line has a direction."""
    start, side = np.array([1.0, 2.0, heading]), 0.7 * np.sign(turn)

    def right(h):
        return np.array([-np.sin(h), np.cos(h)])

    goal = np.append(start[:2] + side * (right(heading) - right(heading + turn)), heading + turn)
    assert float(shortest_path(start, goal, 0.7).length) == pytest.approx(0.7 * abs(turn), abs=1e-8)


def test_goal_straight_ahead_needs_no_full_turn():
    """Where the direction of the line differs from the heading by rounding, to either side."""
    rng = np.random.default_rng(2)
    for north, east, heading, way in rng.uniform([-3, -3, -4, 1], [3, 3, 4, 6], (300, 4)):
        goal = (north + way * np.cos(heading), east + way * np.sin(heading), heading)
        assert float(shortest_path((north, east, heading), goal, 0.7).length) == pytest.approx(way, abs=1e-8)


@pytest.mark.parametrize("goal", NEAR + FAR)
def test_every_word_leads_to_the_goal(goal):
    start, radius = np.array([0.7, -1.2, 2.1]), 0.6
    for word in WORDS:
        path = dubins_path(word, start, goal, radius)
        if path is None:
            continue
        assert word_of(path) == word
        assert is_pose(end_of(path), goal), word
        assert (path.lengths >= 0).all()
        assert path.lengths[np.asarray(path.turns) != 0].max() < 2 * np.pi * radius


@pytest.mark.thorough
@pytest.mark.parametrize("goal", [NEAR[0], FAR[0], *NEAR[1:6], *FAR[1:3]])
def test_brute_force_over_words_finds_no_shorter_path(goal):
    """All lengths of each word's pieces that lead there, by Newton's method from everywhere: dumb, and no geometry."""
    grid = np.stack(np.meshgrid(*[np.linspace(0.1, 6.2, 9)] * 3), axis=-1).reshape(-1, 3)
    grid = np.concatenate([grid, grid * [1, 2, 1]])
    found = {}
    for word in WORDS:
        bends, lengths = np.array([TURNS[c] for c in word]), grid

        def error(v, bends=bends):
            return wrapped(follow(np.broadcast_to(bends, v.shape), v) - goal)

        for _ in range(40):
            slopes = np.stack([(error(lengths + d) - error(lengths - d)) / 2e-6 for d in 1e-6 * np.eye(3)], axis=-1)
            step = np.linalg.pinv(slopes, rcond=1e-9) @ error(lengths)[..., None]
            lengths = lengths - np.clip(step[..., 0], -0.5, 0.5)
        good = (abs(error(lengths)).max(axis=1) < 1e-8) & (lengths >= -1e-8).all(axis=1)
        path = dubins_path(word, HOME, goal, 1.0)
        assert good.any() == (path is not None), word
        if path is not None:
            found[word] = lengths[good].sum(axis=1).min()
            assert float(path.length) == pytest.approx(found[word], abs=1e-6), word
    assert float(shortest_path(HOME, goal, 1.0).length) == pytest.approx(min(found.values()), abs=1e-6)


def wrapped(error):
    error[..., 2] = (error[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return error


@pytest.mark.thorough
@pytest.mark.parametrize("goal", [NEAR[0], NEAR[3], FAR[1]])
def test_numerical_optimiser_finds_no_shorter_path(goal):
    """Six pieces of any length, each on any circle of radius 1 or more: SLSQP from two hundred starts."""

    def miss(v):
        pose = follow(v[:6], v[6:])
        return np.array([*(pose[:2] - goal[:2]), 2 * np.sin((pose[2] - goal[2]) / 2)])

    rng, best = np.random.default_rng(1), np.inf
    for _ in range(200):
        start = np.concatenate([rng.uniform(-1, 1, 6), rng.uniform(0, 2, 6)])
        limits = [(-1, 1)] * 6 + [(0, 7)] * 6
        reaches = {"type": "eq", "fun": miss}
        run = minimize(lambda v: v[6:].sum(), start, method="SLSQP", bounds=limits, constraints=reaches)
        if run.success and abs(miss(run.x)).max() < 1e-7:
            best = min(best, run.fun)
    length = float(shortest_path(HOME, goal, 1.0).length)
    assert length - 1e-6 < best < length + 1e-3


@pytest.mark.parametrize("goal", NEAR[:4])
def test_mirrored_goal_gives_the_mirrored_path(goal):
    for word in WORDS:
        path = dubins_path(word, HOME, goal, 1.0)
        other = dubins_path(word.translate(MIRROR), HOME, goal * [1, -1, -1], 1.0)
        assert (path is None) == (other is None)
        if path is not None:
            np.testing.assert_allclose(other.lengths, path.lengths, atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("word", WORDS)
def test_path_derivatives_are_consistent(word):
    path = DubinsPath(1.0, -2.0, 0.4, 0.8, 1.7, np.array([TURNS[c] for c in word]), np.array([1.1, 2.3, 0.9]))
    names = ("place", "velocity", "acceleration", "jerk", "snap")
    for t in (0.2, 1.2, 2.3, 3.0):  # within each piece, and beyond the last
        for lower, upper in itertools.pairwise(names):
            _, slope = jax.jvp(lambda t, n=lower: getattr(path.at(t), n), (jnp.asarray(t),), (jnp.asarray(1.0),))
            np.testing.assert_allclose(getattr(path.at(t), upper), slope, atol=1e-10)
    assert np.hypot(*np.asarray(path.at(1.2).velocity)) == pytest.approx(1.7)


def test_infeasible_word_returns_none():
    assert dubins_path("LSR", HOME, (0, -1.0, 0), 1.0) is None  # the circles overlap
    assert dubins_path("RLR", HOME, (9, 0, 0), 1.0) is None  # they are too far apart


def test_rejects_unknown_word_and_negative_radius():
    with pytest.raises(InputError, match="unknown sequence of pieces"):
        dubins_path("SSS", HOME, (1, 0, 0), 1.0)
    with pytest.raises(InputError, match="radius"):
        shortest_path(HOME, (1, 0, 0), -1.0)
