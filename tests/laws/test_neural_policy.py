"""A neural network as a law: observation, evaluation, invalid networks, and its range of validity."""

import json
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import trimtab
from trimtab.core.errors import InputError
from trimtab.core.spatial_reference import SpatialPoint
from trimtab.laws.geometric_tracking import GeometricTracking
from trimtab.laws.neural_policy import INPUTS, NeuralPolicy, evaluate, observe, read_network
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build
from trimtab.vehicles.quadrotor import MultirotorState

CRAFT = build("quadrotor/track").world.vehicle


def quaternion_of(rotation: Rotation) -> np.ndarray:
    x, y, z, w = rotation.as_quat()
    return np.array([w, x, y, z])


def draw_state(rng, size: float) -> tuple[SpatialPoint, MultirotorState]:
    """Return a reference point and a random state near it, within `size` of the training range."""
    place = rng.normal(size=3) * 20
    wanted = SpatialPoint(
        place,
        rng.normal(size=3),
        size * rng.uniform(-2, 2, 3),
        size * rng.uniform(-2, 2, 3),
        np.zeros(3),
        0.7,
        0.0,
        0.0,
    )
    turn = Rotation.from_euler("Z", 0.7) * Rotation.from_rotvec(size * rng.uniform(-0.4, 0.4, 3))
    return wanted, MultirotorState(
        place + size * rng.uniform(-0.4, 0.4, 3),
        wanted.velocity + size * rng.uniform(-0.8, 0.8, 3),
        quaternion_of(turn),
        size * rng.uniform(-1, 1, 3),
    )


def test_evaluation_matches_a_plain_python_network():
    network = read_network("quadrotor")
    seen = np.random.default_rng(0).normal(size=INPUTS) * network.scale * 0.5
    h = [min(1.0, max(-1.0, s / k)) for s, k in zip(seen, network.scale, strict=True)]
    for n, (weights, bias) in enumerate(network.layers):
        h = [sum(w * x for w, x in zip(row, h, strict=True)) + b for row, b in zip(weights, bias, strict=True)]
        h = h if n == len(network.layers) - 1 else [np.tanh(x) for x in h]
    want = [c + s * min(1.0, max(-1.0, y)) for c, s, y in zip(network.centre, network.span, h, strict=True)]
    np.testing.assert_allclose(evaluate(network, jnp.asarray(seen)), want, rtol=1e-12)


def test_observation_is_invariant_to_translation_and_yaw():
    rng = np.random.default_rng(1)
    wanted, x = draw_state(rng, 1.0)
    turn, moved = Rotation.from_euler("Z", 1.9), np.array([30.0, -7.0, 2.0])
    w = np.asarray(x.attitude)
    attitude = quaternion_of(turn * Rotation.from_quat([*w[1:], w[0]]))
    other = MultirotorState(turn.apply(x.position) + moved, turn.apply(x.velocity), attitude, x.rate)
    there = SpatialPoint(
        turn.apply(wanted.place) + moved,
        *(turn.apply(v) for v in (wanted.velocity, wanted.acceleration, wanted.jerk)),
        np.zeros(3),
        0.7 + 1.9,
        0.0,
        0.0,
    )
    np.testing.assert_allclose(observe(there, other, 9.81), observe(wanted, x, 9.81), atol=1e-9)


@pytest.mark.thorough
def test_policy_matches_its_teacher_near_the_reference():
    """Within 0.3 of the training range: thrust to 3 % and moments to 15 % of the teacher's."""
    rng, teacher, policy = np.random.default_rng(2), GeometricTracking(craft=CRAFT), NeuralPolicy(craft=CRAFT)
    errors, sizes = [], []
    for _ in range(60):
        wanted, x = draw_state(rng, 0.3)
        own, other = (law.track(wanted, x).demand for law in (policy, teacher))
        errors.append([float(own.thrust - other.thrust), *np.asarray(own.moment - other.moment)])
        sizes.append([float(other.thrust), *np.asarray(other.moment)])
    error, size = (np.sqrt(np.mean(np.square(v), axis=0)) for v in (errors, sizes))
    assert error[0] < 0.03 * size[0]
    assert (error[1:] < 0.15 * size[1:]).all(), (error, size)


def test_inputs_beyond_training_range_are_clipped_and_reported():
    rng, policy = np.random.default_rng(3), NeuralPolicy(craft=CRAFT)
    wanted, x = draw_state(rng, 0.2)
    far = MultirotorState(x.position + np.array([50.0, 0, 0]), x.velocity, x.attitude, x.rate)
    farther = MultirotorState(x.position + np.array([90.0, 0, 0]), x.velocity, x.attitude, x.rate)
    assert float(policy.track(wanted, x).stretch) < 1
    assert float(policy.track(wanted, far).stretch) > 20
    seen = observe(wanted, far, 9.81)
    network = read_network("quadrotor")
    held = evaluate(network, jnp.clip(seen, -network.scale, network.scale))
    np.testing.assert_allclose(policy.track(wanted, far).demand.thrust, held[0], rtol=1e-12)
    assert abs(float(policy.track(wanted, farther).demand.thrust) - network.centre[0]) <= network.span[0]


@pytest.mark.thorough
@pytest.mark.parametrize("trajectory", ["circle", "helix"])
def test_policy_tracks_a_path_over_the_radio(trajectory):
    log = simulate(build("quadrotor/track", {"law": "neural", "trajectory": trajectory}), seed=2)
    assert log.between(2, 10)["law.distance"].max() < 0.1
    assert log.between(2, 10)["law.stretch"].max() < 1.05


@pytest.mark.thorough
@pytest.mark.parametrize(("half_tilt", "returns"), [(0.52, True), (0.79, False)])
def test_policy_recovers_from_60_but_not_90_degrees_tilt(half_tilt, returns):
    """The training data ends at 1.2 rad about each axis."""
    start = f"[{np.cos(half_tilt):.6f},{np.sin(half_tilt):.6f},0,0]"
    settings = {"law": "neural", "trajectory": "place", "initial.attitude": start}
    log = simulate(build("quadrotor/track", settings), seed=0)
    assert (log.between(5, 10)["law.distance"].max() < 0.1) == returns


def change(name):
    """Return a network file's content with one fault."""
    file = json.loads((Path(trimtab.__file__).parent / "laws" / "policy_quadrotor.json").read_text())
    if name == "a layer that doesn't follow":
        file["layers"][1]["weights"] = [row[:-1] for row in file["layers"][1]["weights"]]
    elif name == "three outputs":
        file["layers"][-1] = {"weights": file["layers"][-1]["weights"][:3], "bias": file["layers"][-1]["bias"][:3]}
    elif name == "a scale of zero":
        file["scale"][4] = 0.0
    elif name == "no layers":
        del file["layers"]
    return file


@pytest.mark.parametrize("what", ["a layer that doesn't follow", "three outputs", "a scale of zero", "no layers"])
def test_rejects_mismatched_network_weights_with_a_fix(what, tmp_path):
    (tmp_path / "bad.json").write_text(json.dumps(change(what)))
    with pytest.raises(InputError, match=r"train_policy\.py"):
        NeuralPolicy(policy=str(tmp_path / "bad.json")).check()


def test_unknown_policy_error_lists_available_policies():
    with pytest.raises(InputError, match="quadrotor"):
        NeuralPolicy(policy="hexarotor").check()


@pytest.mark.thorough
def test_policy_loads_from_a_user_file(tmp_path):
    (tmp_path / "own.json").write_text(json.dumps(change("nothing")))
    own = build(
        "quadrotor/track", {"law": "neural", "autopilot.law.policy": str(tmp_path / "own.json"), "duration": "1 s"}
    )
    standard = build("quadrotor/track", {"law": "neural", "duration": "1 s"})
    a, b = (simulate(s, seed=1)["truth.position"] for s in (own, standard))
    assert np.array_equal(a, b)


@pytest.mark.thorough
def test_training_script_writes_a_network_readable_by_the_law(tmp_path):
    """Two steps: the script runs from its first line to its last. The packaged network took 40 000 steps."""
    script, out = Path(__file__).parents[2] / "examples" / "neural_policy" / "train_policy.py", tmp_path / "mine.json"
    command = [sys.executable, str(script), "--out", str(out), "--steps", "2", "--batch", "4", "--width", "5"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "rms errors at 20 000 new states: thrust (N) " in done.stdout
    layers = read_network(str(out)).layers
    assert [np.shape(weights) for weights, _ in layers] == [(5, INPUTS), (4, 5)]
