"""A loop's state as deviations: against analytical rotations, and round trips."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.core.record import replace
from trimtab.run.loop_coordinates import LoopCoordinates
from trimtab.vehicles.quadrotor import MultirotorState

TURNED = Rotation.from_rotvec([0.3, -0.2, 0.5])


def quaternion_of(turn):
    return turn.as_quat()[..., [3, 0, 1, 2]]


@pytest.fixture
def reference():
    """A state, and a ring buffer of two states with an empty second slot, as in a link."""
    x = replace(MultirotorState(), attitude=quaternion_of(TURNED))
    ring = replace(x, attitude=np.stack([quaternion_of(TURNED), np.zeros(4)]), position=np.zeros((2, 3)))
    return {"x": x, "ring": ring, "count": np.int64(3)}


@pytest.mark.thorough
def test_quaternion_deviation_has_three_body_axis_components(reference):
    own = LoopCoordinates(reference)
    names = own.names(reference)
    assert "x.attitude.z" in names
    assert "ring.attitude[1].x" in names
    assert not any(n.startswith("count") for n in names)
    z = np.zeros(len(names))
    z[[names.index(f"x.attitude.{a}") for a in "xyz"]] = [0.1, 0.02, -0.3]
    turned = own.displace(reference, jnp.asarray(z))
    wanted = quaternion_of(TURNED * Rotation.from_rotvec([0.1, 0.02, -0.3]))
    np.testing.assert_allclose(turned["x"].attitude, wanted, atol=1e-12)
    assert int(turned["count"]) == 3
    np.testing.assert_array_equal(turned["x"].position, reference["x"].position)


@pytest.mark.thorough
def test_displacement_and_deviation_round_trip(reference):
    own = LoopCoordinates(reference)
    z = np.random.default_rng(0).uniform(-0.5, 0.5, len(own.names(reference)))
    np.testing.assert_allclose(own.deviation(reference, own.displace(reference, jnp.asarray(z))), z, atol=1e-12)


@pytest.mark.thorough
def test_quaternion_sign_and_length_give_zero_deviation(reference):
    own = LoopCoordinates(reference)
    other = {**reference, "x": replace(reference["x"], attitude=-2.0 * reference["x"].attitude)}
    np.testing.assert_allclose(own.deviation(reference, other), 0.0, atol=1e-12)


def test_place_indices_follow_swapped_elements(reference):
    own = LoopCoordinates(reference)
    names = np.array(own.names(reference))
    marks = own.place_indices(reference)
    swapped = {**marks, "ring": replace(marks["ring"], attitude=marks["ring"].attitude[::-1])}
    order = own.flatten(swapped)
    moved = dict(zip(names, names[order], strict=True))
    assert moved["ring.attitude[0].y"] == "ring.attitude[1].y"
    assert moved["x.attitude.y"] == "x.attitude.y"
    assert own.sizes(reference)[names == "x.attitude.x"] == 0
