"""Plaza1 and Plaza2 solved in one batch by gtsam: what can be known of the way when all ranges are in.

Reads the files by itself and shares nothing with the package. Numbers of batch.json, in the folder of the study:

    PYTHONPATH=tests python -m oracles.ranges2009

Each instant of odometry is a variable (heading, north, east); the bias of the turn, the scale of all ranges and an
error of each radio are one more, for the whole drive. numpy makes the factors linear, gtsam solves the graph, until
nothing moves any more.
"""

import functools
import json
import math
from pathlib import Path

import gtsam
import numpy as np
from scipy.io import loadmat

STUDY = Path(__file__).parents[2] / "studies" / "ranges2009"
OTHER = {"Plaza1": "Plaza2", "Plaza2": "Plaza1"}
HALF_TURN = {"Plaza1": 0.0, "Plaza2": math.pi}
TURN, SIGMA_PLACE, SIGMA_BIAS, SIGMA_SCALE, SIGMA_ERROR = 1e-3, 0.3, 0.01, 0.01, 0.1
"""What the study's filters believe of all that is not tuned."""
SIGMA_HEADING = math.hypot(0.05, 0.02)
"""Of the axis, and of the course over it (rad): one angle here."""
GRIP = 9.81
"""No vehicle on wheels accelerates more (m/s^2): a way that would need it is doubted whole."""
LEAST = 1e-5
"""No sigma is smaller (m, rad)."""
SHARED = gtsam.symbol("c", 0)
EVERY = 10
"""Of the instants, each tenth is kept in the file."""
CHECKPOINTS = 24
ITERATIONS = 40


@functools.cache
def read(name):
    """Truth (n, 4): t, heading, north, east; odometry (n - 1, 3); ranges (m, 3): t, radio, range; radios (4, 2)."""
    held = loadmat(Path(gtsam.__file__).parent / "Data" / f"{name}_.mat")
    g, odometry, ranges = held["GT"], held["DR"].copy(), held["TD"]
    radios = held["TL"][np.argsort(held["TL"][:, 0])]
    truth = np.stack([g[:, 0], math.pi / 2 - np.unwrap(g[:, 3] + HALF_TURN[name]), g[:, 2], g[:, 1]], axis=1)
    odometry[:, 2] *= -1
    odometry[:, 0] = np.diff(g[:, 0])
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    which = np.searchsorted(radios[:, 0], ranges[:, 2])
    return truth, odometry, np.stack([ranges[:, 0], which, ranges[:, 3]], axis=1), radios[:, [2, 1]]


def dead_reckoning(start, odometry, bias):
    """Heading, north, east (n, 3) from a start."""
    angle = odometry[:, 2] - bias * odometry[:, 0]
    heading = start[0] + np.concatenate([[0.0], np.cumsum(angle)])
    course = heading[:-1] + angle / 2
    steps = odometry[:, 1:2] * np.stack([np.cos(course), np.sin(course)], axis=1)
    return np.concatenate([heading[:, None], np.vstack([start[1:], start[1:] + np.cumsum(steps, axis=0)])], axis=1)


def odometry_factor(k, reading, slip, doubt, before, now, c):
    """From instant k - 1 to k, made linear there: what is added to the three must make up the difference."""
    dt, way, turn = reading
    sigmas = [TURN * math.sqrt(dt), *[math.hypot(slip * math.sqrt(way), doubt)] * 2]
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.maximum(sigmas, LEAST))
    angle = turn - c[0] * dt
    along = way * np.array([math.cos(before[0] + angle / 2), math.sin(before[0] + angle / 2)])
    across = np.array([-along[1], along[0]])
    A, B = -np.eye(3), np.zeros((3, len(c)))
    A[1:, 0], B[0, 0], B[1:, 0] = -across, dt, across * dt / 2
    error = now - np.concatenate([[before[0] + angle], before[1:] + along])
    return gtsam.JacobianFactor(k - 1, A, k, np.eye(3), SHARED, B, -error, noise)


def range_factor(k, ahead, rate, speed, radio, place, measured, sigma, pose, c):
    """A range that came `ahead` seconds after instant k, where the last speed and rate lead to; made linear."""
    course = pose[0] + (rate - c[0]) * ahead / 2
    along = speed * ahead * np.array([math.cos(course), math.sin(course)])
    away = pose[1:] + along - place
    distance = math.hypot(*away)
    u = away / distance
    swing = (1 + c[1]) * (u[1] * along[0] - u[0] * along[1])
    A, B = np.array([[swing, *((1 + c[1]) * u)]]), np.zeros((1, len(c)))
    B[0, 0], B[0, 1], B[0, 2 + radio] = -swing * ahead / 2, distance, 1.0
    error = np.array([(1 + c[1]) * distance + c[2 + radio] - measured])
    return gtsam.JacobianFactor(k, A, SHARED, B, -error, gtsam.noiseModel.Isotropic.Sigma(1, sigma))


def linear_graph(name, assumed, way, shared):
    """The factors of the first len(way) instants, made linear at a way (n, 3) and the shared numbers."""
    truth, odometry, ranges, radios = read(name)
    n, graph = len(way), gtsam.GaussianFactorGraph()
    first = np.array([truth[0, 1], truth[0, 2], truth[0, 3]])
    prior = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA_HEADING, SIGMA_PLACE, SIGMA_PLACE]))
    graph.add(gtsam.JacobianFactor(0, np.eye(3), first - way[0], prior))
    sigmas = np.array([SIGMA_BIAS, SIGMA_SCALE, *[SIGMA_ERROR] * len(radios)])
    mean = np.array([0.0, assumed["scale"], *[0.0] * len(radios)])
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    graph.add(gtsam.JacobianFactor(SHARED, np.eye(len(mean)), mean - shared, noise))
    speed = odometry[:, 1] / odometry[:, 0]
    for k in range(1, n):
        slips = k > 1 and abs(speed[k - 1] - speed[k - 2]) > GRIP * odometry[k - 1, 0]
        doubt = odometry[k - 1, 1] if slips else 0.0
        graph.add(odometry_factor(k, odometry[k - 1], assumed["slip"], doubt, way[k - 1], way[k], shared))
    for t, radio, measured in ranges:
        k = int(np.searchsorted(truth[:, 0], t, side="right")) - 1
        if 0 <= k < n:
            dt, step, turn = odometry[k - 1] if k else (1.0, 0.0, 0.0)
            at = k, t - truth[k, 0], turn / dt, step / dt, int(radio), radios[int(radio)]
            graph.add(range_factor(*at, measured, assumed["noise"], way[k], shared))
    return graph


def solve(name, assumed, until=None, start=None):
    """Solution (n, 3), the shared numbers, and the linear graph there with its ordering; by Gauss and Newton.

    until: only so many instants, with the ranges up to then.  start: shared numbers and way of a shorter one.
    """
    truth, odometry, _, radios = read(name)
    n = len(truth) if until is None else until
    first = truth[0, 1:]
    if start is None:
        biases = np.linspace(-0.01, 0.01, 41)
        ways = [dead_reckoning(first, odometry, b) for b in biases]
        best = int(np.argmin([misfit(way, name) for way in ways]))
        way, shared = ways[best][:n], np.array([biases[best], assumed["scale"], *[0.0] * len(radios)])
    else:
        shared, known = start
        more = dead_reckoning(known[-1], odometry[len(known) - 1 : n - 1], shared[0])
        way = np.concatenate([known[:-1], more])
    order = gtsam.Ordering()
    for key in [*range(n), SHARED]:  # along the way: what all hang on comes last
        order.push_back(key)
    for _ in range(ITERATIONS):
        graph = linear_graph(name, assumed, way, shared)
        step = graph.optimize(order)
        way = way + np.stack([step.at(k) for k in range(n)])
        shared = shared + step.at(SHARED)
        if max(abs(step.at(SHARED)).max(), max(abs(step.at(k)).max() for k in range(n))) < 1e-6:
            return way, shared, graph
    raise ArithmeticError(f"{name}: no solution after {ITERATIONS} iterations")


def cost(name, assumed, way, shared):
    """What a solution makes least: half the sum of all squares, of a way (n, 3) and the shared numbers."""
    graph = linear_graph(name, assumed, way, shared)
    zero = gtsam.VectorValues()
    for k in range(len(way)):
        zero.insert(k, np.zeros(3))
    zero.insert(SHARED, np.zeros(len(shared)))
    return graph.error(zero)


def misfit(way, name):
    """Mean square of what the ranges have against a way, each residual counted up to 5 m."""
    truth, _, ranges, radios = read(name)
    k = np.clip(np.searchsorted(truth[:, 0], ranges[:, 0], side="right") - 1, 0, len(truth) - 1)
    away = np.hypot(*(way[k, 1:] - radios[ranges[:, 1].astype(int)]).T)
    return np.mean(np.minimum(np.abs(ranges[:, 2] - away), 5.0) ** 2)


def solve_plainly(name):
    """As a user of gtsam writes it at first: its own factors, ranges as they are. Solution (n, 3)."""
    truth, odometry, ranges, radios = read(name)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose = gtsam.Pose2(truth[0, 2], truth[0, 3], truth[0, 1])
    tight = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA_PLACE, SIGMA_PLACE, SIGMA_HEADING]))
    graph.add(gtsam.PriorFactorPose2(0, pose, tight))
    for i, radio in enumerate(radios):
        key = gtsam.symbol("l", i)
        graph.add(gtsam.PriorFactorPoint2(key, radio, gtsam.noiseModel.Isotropic.Sigma(2, 1e-3)))
        values.insert(key, radio)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.01, 0.1]))  # of gtsam's example on Plaza2
    for k, (_, way, turn) in enumerate(odometry, start=1):
        graph.add(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(way, 0.0, turn), noise))
    sigma = gtsam.noiseModel.Isotropic.Sigma(1, 0.5)
    for t, radio, measured in ranges:
        k = int(np.searchsorted(truth[:, 0], t, side="right")) - 1
        if k >= 0:
            graph.add(gtsam.RangeFactor2D(k, gtsam.symbol("l", int(radio)), measured, sigma))
    for k, way in enumerate(truth):
        values.insert(k, gtsam.Pose2(way[2], way[3], way[1]))
    result = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    poses = [result.atPose2(k) for k in range(len(truth))]
    return np.array([[p.theta(), p.x(), p.y()] for p in poses])


def rms(way, truth):
    """Horizontal (m)."""
    return float(np.sqrt(np.mean(np.sum((way[:, 1:] - truth[: len(way), 2:]) ** 2, axis=1))))


def values_of(name, assumed, checkpoints=CHECKPOINTS):
    """What the file holds of one log."""
    truth = read(name)[0]
    way, shared, graph = solve(name, assumed)
    marginals = gtsam.Marginals(graph, graph.optimize())
    kept = np.arange(0, len(way), EVERY)
    P = np.stack([marginals.marginalCovariance(int(k))[1:, 1:] for k in kept])
    error = way[kept, 1:] - truth[kept, 2:]
    held = {
        "assumed": assumed,
        "rms": rms(way, truth),
        "nees": float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error))),
        "sigma": float(np.sqrt(np.mean(np.trace(P, axis1=1, axis2=2)))),
        "shared": shared.tolist(),
        "plain_rms": rms(solve_plainly(name), truth),
        "row": kept.tolist(),
        "north": np.round(way[kept, 1], 4).tolist(),
        "east": np.round(way[kept, 2], 4).tolist(),
        "causal": [],
    }
    start = None
    for until in np.linspace(len(way) / checkpoints, len(way), checkpoints).astype(int).tolist():
        sofar, c, _ = solve(name, assumed, until, start)
        start = c, sofar
        held["causal"].append([until - 1, *sofar[-1, 1:].tolist()])
    return held


def main():
    """Write the file anew."""
    tuned = json.loads((STUDY / "tuned.json").read_text(encoding="utf-8"))
    found = {name: values_of(name, tuned[OTHER[name]]) for name in OTHER}
    (STUDY / "batch.json").write_text(json.dumps(found) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
