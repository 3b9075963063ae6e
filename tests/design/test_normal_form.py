"""Normal forms that can be written by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from design.published import G, ball_and_beam, vtol

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions
from trimtab.design.normal_form import normal_form, solve_root

pytestmark = pytest.mark.slow

EPS = 0.3


def quick(f):
    return jax.jit(f, compiler_options=FAST_COMPILE_OPTIONS)


@pytest.fixture(scope="module")
def form():
    return normal_form(vtol(EPS), {"theta": 0.2, "w": 0.4, "vx": 1.0}, internal=("theta", "w"))


def test_names_and_point_of_the_vtol(form):
    assert form.external == ("x", "x'", "y", "y'")
    assert (form.internals, form.virtual) == (("theta", "w"), ("x''", "y''"))
    np.testing.assert_allclose(form.xi0, [0, 1, 0, 0])
    np.testing.assert_allclose(form.v0, [-G * np.sin(0.2), G * np.cos(0.2) - G], rtol=1e-14)
    assert form.inputs_enter == ("w",)
    assert form.condition < 1.01


def test_internal_dynamics_of_the_vtol_by_hand(form):
    """Hauser, Sastry, Meyer 1992, section 2: eps theta'' = v1 cos theta + (v2 + g) sin theta."""
    v, zeta = jnp.array([0.7, -0.4]), jnp.array([0.5, -0.6])
    got = quick(form.internal)(jnp.array([3.0, -1, 2, 1]), zeta, v)
    want = (0.7 * np.cos(0.5) + (G - 0.4) * np.sin(0.5)) / EPS
    np.testing.assert_allclose(got, [-0.6, want], rtol=1e-12)
    slope = quick(jax.jacfwd(form.internal, argnums=(1, 2)))(jnp.zeros(4), zeta, v)
    at_point = quick(jax.jacfwd(form.internal, argnums=1))(*map(jnp.asarray, (form.xi0, form.zeta0, form.v0)))
    np.testing.assert_allclose(form.jacobian, at_point, rtol=1e-12, atol=1e-12)
    turn = (-0.7 * np.sin(0.5) + (G - 0.4) * np.cos(0.5)) / EPS
    np.testing.assert_allclose(slope[0], [[0, 1], [turn, 0]], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(slope[1], [[0, 0], [np.cos(0.5) / EPS, np.sin(0.5) / EPS]], rtol=1e-12)


def test_the_model_in_new_coordinates_has_chains_of_integrators(form):
    linear = linearise(form.model())
    assert linear.states == (*form.external, *form.internals)
    A, B = np.zeros((4, 6)), np.zeros((4, 2))
    A[0, 1] = A[2, 3] = B[1, 0] = B[3, 1] = 1
    np.testing.assert_allclose(linear.A[:4], A, atol=1e-12)
    np.testing.assert_allclose(linear.B[:4], B, atol=1e-12)
    np.testing.assert_allclose(linear.C, np.eye(6)[[0, 2]])


def test_there_and_back_and_an_input_that_is_not_affine():
    model = model_of_functions(
        lambda x, u: jnp.stack([x[1], jnp.tanh(x[0]) + u[0] + 0.3 * u[0] ** 2, x[0] * x[1] - x[2] ** 3]),
        ("a", "b", "c"),
        ("u",),
        h=lambda x, u: jnp.stack([x[0] + 0.2 * x[0] ** 3]),
        outputs=("y",),
    )
    form = normal_form(model, internal={"z": lambda x: x[2] + x[0] ** 2})
    x = jnp.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(form.backward(*form.forward(x)), x, rtol=1e-12)
    u = form.invert(x, jnp.array([0.8]))
    y2 = (1 + 0.6 * 0.09) * (np.tanh(0.3) + u[0] + 0.3 * u[0] ** 2) + 1.2 * 0.3 * 0.04
    np.testing.assert_allclose(y2, 0.8, rtol=1e-12)
    assert np.isnan(form.invert(x, jnp.array([-50.0]))).all()  # the parabola does not reach so low
    moved = normal_form(model, x, u, internal={"z": lambda x: x[2] + x[0] ** 2})  # a point that is no equilibrium
    at_point = quick(jax.jacfwd(form.internal, argnums=1))(*form.forward(x), jnp.array([0.8]))
    np.testing.assert_allclose(moved.jacobian, at_point, rtol=1e-10)
    got = form.internal(*form.forward(x), jnp.array([0.8]))
    np.testing.assert_allclose(got, [0.3 * -0.2 - 0.125 + 2 * 0.3 * -0.2], rtol=1e-12)


def test_states_are_chosen_and_feedthrough_has_no_chain():
    chosen = normal_form(vtol(EPS)).internals
    assert chosen == ("theta", "w")
    lag = model_of_functions(lambda x, u: u - 2 * x, ("a",), ("u",), h=lambda x, u: x + u, outputs=("y",))
    form = normal_form(lag)
    assert (form.external, form.internals, form.virtual) == ((), ("a",), ("y",))
    linear = linearise(form.model())  # a' = y - 3 a
    np.testing.assert_allclose([linear.A[0, 0], linear.B[0, 0], linear.D[0, 0]], [-3, 1, 1], rtol=1e-12)


def test_solve_is_differentiable_and_says_when_there_is_no_root():
    cube = lambda a: solve_root(lambda z: z**3 - a, jnp.array([1.0]))[0]  # noqa: E731
    np.testing.assert_allclose([cube(8.0), jax.grad(cube)(8.0)], [2.0, 1 / 12], rtol=1e-12)
    np.testing.assert_allclose(jax.grad(jax.grad(cube))(8.0), -2 / 9 * 8 ** (-5 / 3), rtol=1e-9)
    assert np.isnan(solve_root(lambda z: z**2 + 1, jnp.array([0.7]))).all()


def test_wrong_input_is_refused():
    with pytest.raises(InputError, match="no relative degree here: the inputs enter derivative 3"):
        normal_form(ball_and_beam())
    with pytest.raises(InputError, match="2 outputs and 1 inputs"):
        normal_form(model_of_functions(lambda x, u: x + u, ("a", "b"), ("u",)))
    with pytest.raises(InputError, match=r"leave 2\.") as error:
        normal_form(vtol(EPS), internal=("theta",))
    assert "vy" in error.value.choices
    with pytest.raises(InputError, match="don't complete"):
        normal_form(vtol(EPS), internal=("x", "theta"))
