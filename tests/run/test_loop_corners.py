"""Corners of a loop at rest: found where both sides differ, and not found in smooth loops."""

import jax.numpy as jnp
import numpy as np
import pytest

from examples.my_cart import Cart, CartState, scenario
from trimtab.core.errors import InputError
from trimtab.core.record import part, record, replace
from trimtab.core.signals import no_motion
from trimtab.loop.integration import Integration
from trimtab.run.loop_corners import find_loop_corner
from trimtab.run.loop_linearisation import linearise_loop

NAMES = ("speed", "height")
SIZE, KEEP = np.array([1.0, 2000.0]), np.array([True, True])


def find(change, whole, keep=KEEP):
    return find_loop_corner(lambda z: np.array(change(*z)), np.array(whole), SIZE, keep, NAMES)


@pytest.mark.parametrize(
    ("corner", "slope"),
    [
        (abs, 0.0),
        (lambda v: max(v, 0.0), 0.5),
        (lambda v: 3.0 * v if v > 0 else v, 1.0),
        (lambda v: 1e-2 * abs(v), 0.0),
    ],
)
def test_finds_corners_whatever_the_automatic_derivative_is(corner, slope):
    found = find(lambda v, h: (corner(v) + 0.2 * v, 0.9 * h), [[slope + 0.2, 0.0], [0.0, 0.9]])
    assert found is not None
    assert found.startswith("speed changes by")


@pytest.mark.parametrize("jump", [lambda v: 1e-8 * (v > 0), lambda v: np.nan if v > 0 else 0.0])
def test_finds_jumps_and_undefined_sides(jump):
    found = find(lambda v, h: (0.5 * v + jump(v), 0.9 * h), [[0.5, 0.0], [0.0, 0.9]])
    assert found is not None
    assert found.startswith("speed changes by")


def test_message_states_the_change_on_both_sides():
    found = find(lambda v, h: (abs(v), 0.0), [[0.0, 0.0], [0.0, 0.0]])
    before, after = (float(word) for word in found.split() if word[-1].isdigit())
    assert before == pytest.approx(-after, rel=1e-3)
    assert 0.5 <= abs(after) <= 1.0


@pytest.mark.parametrize(
    "change",
    [
        lambda v, h: (0.5 * v + 3.0 * v * v, 0.9 * h),
        lambda v, h: (0.5 * v + 40.0 * v * abs(v), 0.9 * h + np.sin(v) ** 2),
        lambda v, h: (0.5 * v + 1e-12 * np.sin(1e9 * v), 0.9 * h),
        lambda v, h: (0.5 * v, 0.9 * h + 4e-11 * 2000 * np.sign(np.sin(1e9 * h))),
    ],
)
def test_smooth_and_rounded_loops_have_no_corner(change):
    assert find(change, [[0.5, 0.0], [0.0, 0.9]]) is None


def test_states_without_a_command_are_neither_displaced_nor_compared():
    def change(v, h):
        return abs(v), 0.9 * h

    whole = [[0.0, 0.0], [0.0, 0.9]]
    assert find(change, whole, np.array([False, True])) is None
    assert find(change, whole) is not None


@pytest.mark.thorough
def test_loop_with_variable_integration_steps_is_linearised():
    loop, steps = scenario(Cart()), Integration("rosenbrock")
    plain = linearise_loop(loop, x=CartState())
    found = linearise_loop(replace(loop, world=replace(loop.world, integration=steps)), x=CartState())
    assert found.states == plain.states
    np.testing.assert_allclose(found.A, plain.A, atol=1e-6)


@record
class OneWayCart:
    """A cart with additional friction when it rolls forward. Source: this file."""

    cart: Cart = part("Cart without this friction.", default=Cart())

    def dynamics(self, t, x, u):
        """Return the derivative of x."""
        return self.cart.dynamics(t, x, replace(u, force=u.force - 0.5 * jnp.maximum(x.velocity, 0.0)))

    def motion(self, t, x, u):
        """Return no motion: no sensor on the cart needs it."""
        return no_motion()


@pytest.mark.thorough
def test_loop_with_one_way_friction_is_rejected_at_rest():
    loop = scenario(Cart())
    one_way = replace(loop, world=replace(loop.world, vehicle=OneWayCart()))
    with pytest.raises(InputError, match="the loop has no slope at rest"):
        linearise_loop(one_way, x=CartState())
