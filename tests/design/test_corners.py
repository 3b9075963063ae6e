"""Corners and jumps: refused with their one-sided slopes, while smooth models keep theirs."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from trimtab.core.errors import InputError
from trimtab.design.corners import find_corner
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions

CORNERS = {
    "abs": lambda x, u: jnp.abs(x[:1]),
    "hypot": lambda x, u: jnp.hypot(x[0], x[1])[None],
    "saturation": lambda x, u: jnp.clip(x[:1] + 1, -1, 1),
    "dead zone": lambda x, u: jnp.maximum(u, 0),
    "least of two": lambda x, u: jnp.minimum(x[0], x[1])[None],
    "two slopes": lambda x, u: jnp.where(x[:1] > 0, 2 * x[:1], x[:1]),
    "wrong at the point alone": lambda x, u: jnp.where(x[:1] == 0, 0 * x[:1], x[:1]),
    "table": lambda x, u: jnp.interp(x[:1], jnp.array([-1.0, 0, 1]), jnp.array([0.0, 1, 3])),
    "beside the axes": lambda x, u: jnp.minimum(jnp.abs(x[0]), jnp.abs(x[1]))[None],
    "between the axes": lambda x, u: jnp.where((x[0] > 0) & (x[1] > 0), jnp.minimum(x[0], x[1]), 0.0)[None],
    "beside a large value": lambda x, u: 1e4 + jnp.abs(x[:1]),
    "beside a larger slope": lambda x, u: 1e-3 * jnp.abs(x[:1]) + x[1:],
    "in a scan": lambda x, u: lax.scan(lambda c, _: (jnp.abs(c) / 2, ()), x[0], jnp.arange(3))[0][None],
    "in a loop": lambda x, u: lax.fori_loop(0, 3, lambda _, c: jnp.maximum(c, x[1]), x[0])[None],
    "in a condition": lambda x, u: lax.cond(x[0] > 0, lambda: 2 * x[0], lambda: x[0])[None],
}
JUMPS = {
    "sign": lambda x, u: jnp.sign(x[:1]),
    "round": lambda x, u: jnp.round(x[:1] + 0.5),
    "floor": lambda x, u: jnp.floor(u),
    "condition": lambda x, u: lax.cond(x[0] > 0, lambda: x[0] + 1, lambda: x[0])[None],
}
SMOOTH = {
    "quadratic drag": (lambda x, u: x[:1] * jnp.abs(x[:1]), [0, 0]),
    "square": (lambda x, u: x[:1] ** 2, [0, 0]),
    "steep": (lambda x, u: 1e6 * jnp.sin(100 * x[:1]), [1e8, 0]),
    "corner nearby": (lambda x, u: jnp.maximum(x[:1] - 0.01, 0) + x[1:], [0, 1]),
    "inside a saturation": (lambda x, u: jnp.clip(x[:1], -1, 1), [1, 0]),
    "beyond a saturation": (lambda x, u: jnp.clip(x[:1] + 2, -1, 1), [0, 0]),
    "branches that fit": (lambda x, u: lax.cond(x[0] > 0, lambda: x[0] ** 2, lambda: -(x[0] ** 3))[None], [0, 0]),
    "rounded corner": (lambda x, u: jnp.sqrt(x[:1] ** 2 + 1e-6), [0, 0]),
    "constant": (lambda x, u: jnp.ones(1) * 1e9, [0, 0]),
    "rounding": (lambda x, u: jnp.sin(x[:1] + 0.3) ** 2 + jnp.cos(x[:1] + 0.3) ** 2, [0, 0]),
    "small beside a large value": (lambda x, u: 6.4e6 + jnp.sin(x[:1]), [1, 0]),
    "distance from the centre of the Earth": (lambda x, u: jnp.sqrt((6.4e6 + x[:1]) ** 2 + x[1:] ** 2), [1, 0]),
}


def with_output(h):
    return model_of_functions(lambda x, u: jnp.stack([x[1], u[0]]), ("x", "v"), ("u",), h=h, outputs=("y",))


@pytest.mark.thorough(
    "hypot", "dead zone", "least of two", "beside a large value", "in a loop", "in a condition", "table"
)
@pytest.mark.parametrize("name", CORNERS)
def test_linearise_rejects_corners(name):
    with pytest.raises(InputError, match=r"y has no slope at this point: its slope by \w is .* before and .* after"):
        linearise(with_output(CORNERS[name]))


@pytest.mark.parametrize("name", JUMPS)
def test_linearise_rejects_jumps(name):
    with pytest.raises(InputError, match=r"y has no slope at this point: its value is .* before, .* at and .* after"):
        linearise(with_output(JUMPS[name]))


@pytest.mark.thorough(
    "square", "constant", "rounding", "inside a saturation", "rounded corner", "small beside a large value"
)
@pytest.mark.parametrize("name", SMOOTH)
def test_linearise_accepts_smooth_outputs(name):
    h, slope = SMOOTH[name]
    np.testing.assert_allclose(linearise(with_output(h)).C, [slope], rtol=1e-9, atol=1e-12)


def test_one_sided_slopes_are_reported():
    found = find_corner(with_output(CORNERS["two slopes"]), np.zeros(2), np.zeros(1))
    assert found is not None
    assert found.row == "y"
    assert found.reason.startswith("its slope by x is 1 before and 2 after the point along x; the automatic derivative")
    jump = find_corner(with_output(JUMPS["sign"]), np.zeros(2), np.zeros(1))
    assert jump is not None
    assert jump.reason == "its value is -1 before, 0 at and 1 after the point along x"


def test_corner_in_a_derivative_suggests_no_other_output():
    model = model_of_functions(lambda x, u: jnp.stack([x[1], u[0] - jnp.abs(x[1])]), ("x", "v"), ("u",))
    with pytest.raises(InputError, match=r"v' has no slope") as caught:
        linearise(model)
    assert "only other outputs" not in str(caught.value)
    assert linearise(model, {"v": 1e-3}).A[1, 1] == -1
