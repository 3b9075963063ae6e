"""Normal forms against those of the literature, and their linearisation against first orders by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from design.published import G, ball_and_beam, vtol

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions
from trimtab.design.normal_form import linear_normal_form, normal_form, solve_root
from trimtab.design.trim import trim

EPS = 0.3


def quick(f):
    return jax.jit(f, compiler_options=FAST_COMPILE_OPTIONS)


@pytest.fixture(scope="module")
def form():
    return normal_form(vtol(EPS), {"theta": 0.2, "w": 0.4, "vx": 1.0}, internal=("theta", "w"))


@pytest.mark.thorough
def test_vtol_normal_form_names_and_point(form):
    assert form.external == ("x", "x'", "y", "y'")
    assert (form.internals, form.virtual) == (("theta", "w"), ("x''", "y''"))
    np.testing.assert_allclose(form.xi0, [0, 1, 0, 0])
    np.testing.assert_allclose(form.v0, [-G * np.sin(0.2), G * np.cos(0.2) - G], rtol=1e-14)
    assert form.inputs_enter == ("w",)
    assert form.condition < 1.01


@pytest.mark.thorough
def test_vtol_internal_dynamics_match_analytic_values(form):
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


@pytest.mark.thorough
def test_transformed_model_has_integrator_chains(form):
    linear = linearise(form.model())
    assert linear.states == (*form.external, *form.internals)
    A, B = np.zeros((4, 6)), np.zeros((4, 2))
    A[0, 1] = A[2, 3] = B[1, 0] = B[3, 1] = 1
    np.testing.assert_allclose(linear.A[:4], A, atol=1e-12)
    np.testing.assert_allclose(linear.B[:4], B, atol=1e-12)
    np.testing.assert_allclose(linear.C, np.eye(6)[[0, 2]])


@pytest.mark.thorough
def test_coordinate_round_trip_and_inversion_of_nonaffine_input():
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


@pytest.mark.thorough
def test_internal_states_are_chosen_and_feedthrough_has_no_chain():
    chosen = normal_form(vtol(EPS)).internals
    assert chosen == ("theta", "w")
    lag = model_of_functions(lambda x, u: u - 2 * x, ("a",), ("u",), h=lambda x, u: x + u, outputs=("y",))
    form = normal_form(lag)
    assert (form.external, form.internals, form.virtual) == ((), ("a",), ("y",))
    linear = linearise(form.model())  # a' = y - 3 a
    np.testing.assert_allclose([linear.A[0, 0], linear.B[0, 0], linear.D[0, 0]], [-3, 1, 1], rtol=1e-12)


@pytest.mark.thorough
def test_solve_root_is_differentiable_and_nan_without_root():
    cube = lambda a: solve_root(lambda z: z**3 - a, jnp.array([1.0]))[0]  # noqa: E731
    np.testing.assert_allclose([cube(8.0), jax.grad(cube)(8.0)], [2.0, 1 / 12], rtol=1e-12)
    np.testing.assert_allclose(jax.grad(jax.grad(cube))(8.0), -2 / 9 * 8 ** (-5 / 3), rtol=1e-9)
    assert np.isnan(solve_root(lambda z: z**2 + 1, jnp.array([0.7]))).all()


@pytest.mark.thorough
def test_normal_form_rejects_invalid_arguments():
    with pytest.raises(InputError, match="no relative degree is defined at this point: inputs affect derivative 3"):
        normal_form(ball_and_beam())
    with pytest.raises(InputError, match="as many outputs as inputs, got 2 and 1"):
        normal_form(model_of_functions(lambda x, u: x + u, ("a", "b"), ("u",)))
    with pytest.raises(InputError, match=r"number of names to give: 2") as error:
        normal_form(vtol(EPS), internal=("theta",))
    assert "vy" in error.value.choices
    with pytest.raises(InputError, match="not independent coordinates"):
        normal_form(vtol(EPS), internal=("x", "theta"))


def curved():
    """Not affine in its input, with an internal state that the input moves."""

    def f(x, u):
        return jnp.stack([x[1] + x[0] ** 2, -x[0] + jnp.sinh(u[0]) * (2 + x[2]), -x[2] + x[0] + u[0]])

    return model_of_functions(f, ("a", "b", "c"), ("p",), h=lambda x, u: x[:1], outputs=("y",))


def test_linear_normal_form_matches_analytic_first_order():
    """y' = b + a^2, v = y'' = -a + sinh(p) (2 + c) + 2 a y' about zero: p = (v + a)/2, c' = -c + a + p."""
    got = linear_normal_form(curved(), {"y": 2}, ("c",))
    assert (got.states, got.inputs, got.outputs) == (("y", "y'", "c"), ("y''",), ("y",))
    np.testing.assert_allclose(got.A, [[0, 1, 0], [0, 0, 0], [1.5, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(got.B, [[0], [1], [0.5]], atol=1e-12)
    np.testing.assert_allclose(got.C, [[1, 0, 0]])


def test_linear_normal_form_includes_curvature_away_from_origin():
    """Trim a = 1, b = -1: Phi = [[1, 0, 0], [2, 1, 0], [0, 0, 1]]; v = y'' as below."""
    model = curved()
    found = trim(model, x={"a": 1.0, "b": -1.0}, free=("c", "p")).require_trim()
    p, c = float(found.u[0]), float(found.x[2])
    got = linear_normal_form(model, {"y": 2}, ("c",), found.x, found.u)
    # v = -a + sinh(p)(2 + c) + 2 a (b + a^2): with da = dy, db = dy' - 2 dy
    Wu, by_y = np.cosh(p) * (2 + c), -1 + 2 * (-2 + 2)
    row = np.array([1 - by_y / Wu, -2 / Wu, -1 - np.sinh(p) / Wu])
    np.testing.assert_allclose(got.A, [[0, 1, 0], [0, 0, 0], row], atol=1e-9)
    np.testing.assert_allclose(got.B, [[0], [1], [1 / Wu]], atol=1e-9)


@pytest.mark.thorough
def test_linear_normal_form_rejects_invalid_arguments():
    model = curved()
    with pytest.raises(InputError, match=r"not a trim: b' = 1\.1"):
        linear_normal_form(model, {"y": 2}, ("c",), u={"p": 0.55})
    with pytest.raises(InputError, match="an input affects a derivative of an order below the degree"):
        linear_normal_form(model, {"y": 3}, ())
    with pytest.raises(InputError, match="singular"):
        linear_normal_form(model, {"y": 1}, ("b", "c"))
    with pytest.raises(InputError, match="number of names to give: 1"):
        linear_normal_form(model, {"y": 2}, ())
    with pytest.raises(InputError, match="not independent coordinates"):
        linear_normal_form(model, {"y": 2}, ("a",))
    with pytest.raises(InputError, match="for each output a degree of at least 1"):
        linear_normal_form(model, {}, ("a", "b", "c"))


@pytest.mark.thorough
def test_vtol_linear_normal_form_matches_known_roll_dynamics():
    """[2, 2] is its degree; internal dynamics of the roll as known: sin(theta) g / eps."""
    craft = vtol(0.3)
    got = linear_normal_form(craft, dict.fromkeys(craft.outputs, 2), craft.states[4:], u=craft.u0)
    np.testing.assert_allclose(got.A[5, 4], G / 0.3, rtol=1e-12)
