"""Linearisations against hand-written derivatives, and modes against systems whose modes are known."""

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.signals import PlanarForce
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions, model_of_vehicle
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

M, J, D, C1 = 2.6, 0.096, 0.32, 0.8


def hovercraft():
    craft = Hovercraft(friction=Friction(force_viscous=C1))
    x = HovercraftState(0.5, -0.2, 0.3, 1.0, 2.0, 0.7)
    return model_of_vehicle(
        craft, x, PlanarForce(0.4, 0.1), outputs={"course": lambda x, u: x.heading + u.FX * x.yaw_rate}
    )


def oscillator(w, zeta, unit):
    """y'' = -w^2 y - 2 zeta w y' + u, y in metres, its rate in units of `unit` m/s."""
    A = np.array([[0, unit], [-w * w / unit, -2 * zeta * w]])
    return model_of_functions(
        lambda x, u: A @ x + jnp.array([0.0, 1 / unit]) * u, ("y", "rate"), ("u",), outputs=("y", "rate")
    )


def test_hovercraft_matrices_match_analytic_derivatives():
    found = linearise(hovercraft())
    u, v, r, s, c = 0.5, -0.2, 0.3, np.sin(0.7), np.cos(0.7)
    A = np.zeros((6, 6))
    A[0, :3] = [-C1 / M, r, v]
    A[1, :3] = [-r, -C1 / M, -u]
    A[3] = [c, -s, 0, 0, 0, -s * u - c * v]
    A[4] = [s, c, 0, 0, 0, c * u - s * v]
    A[5, 2] = 1
    B = np.zeros((6, 2))
    B[0, 0], B[1, 1], B[2, 1] = 1 / M, 1 / M, -D / J
    np.testing.assert_allclose(found.A, A, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.B, B, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.C, [[0, 0, 0.4, 0, 0, 1]], rtol=1e-14)
    np.testing.assert_allclose(found.D, [[r, 0]], rtol=1e-14)
    np.testing.assert_allclose(found.y0, [0.7 + 0.4 * 0.3], rtol=1e-14)
    np.testing.assert_allclose(found.drift[2], -D * 0.1 / J, rtol=1e-14)
    assert (found.states[2], found.inputs, found.outputs) == ("yaw_rate", ("FX", "FY"), ("course",))


def test_linear_model_error_is_quadratic():
    model = hovercraft()
    found = linearise(model)
    dx, du = np.array([1.0, -2, 3, 0, 1, 2]), np.array([0.5, -1.0])
    errors = []
    for size in (1e-3, 1e-4):
        truth = model.f(found.x0 + size * dx, found.u0 + size * du)
        errors.append(np.abs(truth - found.drift - size * (found.A @ dx + found.B @ du)).max())
    assert 50 < errors[0] / errors[1] < 200  # what is left out is quadratic


@pytest.mark.thorough("1.0", "100000.0")
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e5])
def test_modes_do_not_depend_on_units(unit):
    (mode,) = linearise(oscillator(16.5, 0.02, unit)).modes()
    np.testing.assert_allclose([mode.frequency, mode.damping, mode.time_constant], [16.5, 0.02, 1 / 0.33], rtol=1e-12)
    assert [n for n, _ in mode.states] in (["y", "rate"], ["rate", "y"])
    np.testing.assert_allclose([s for _, s in mode.states], 0.5, atol=1e-3)


def test_poles_and_modes_name_their_states():
    A = np.diag([2.0, -3.0, 0.0])
    A[0, 1] = 1e-3
    found = linearise(model_of_functions(lambda x, u: A @ x + u, ("fast", "slow", "still"), ("u",)))
    np.testing.assert_allclose(found.poles(), [2, 0, -3], atol=1e-15)
    modes = found.modes()
    assert [m.states[0][0] for m in modes] == ["fast", "still", "slow"]
    assert (modes[1].time_constant, modes[0].damping, modes[2].damping) == (np.inf, -1.0, 1.0)
    assert np.isnan(modes[1].damping)
    assert "slow 1.00" in found.table().splitlines()[3]


def test_coincident_poles_share_their_states():
    """A triple integrator has one eigenvector; a pair of equal oscillators, coupled one way, two for four poles."""
    chain = linearise(model_of_functions(lambda x, u: jnp.stack([x[1], x[2], u[0]]), ("a", "b", "c"), ("u",)))
    assert len(chain.modes()) == 3
    for mode in chain.modes():
        assert mode.pole == 0
        np.testing.assert_allclose(sorted(s for _, s in mode.states), [1 / 3] * 3, rtol=1e-9)
    A = np.kron(np.eye(2), [[0, 1.0], [-4, -0.2]])
    A[3, 0] = 1.0
    modes = linearise(model_of_functions(lambda x, u: A @ x, ("p", "pd", "q", "qd"), ("u",))).modes()
    for mode in modes:
        np.testing.assert_allclose(mode.frequency, 2.0, rtol=1e-6)
        np.testing.assert_allclose([s for _, s in mode.states], 0.25, atol=0.1)


def test_part_and_rescale_keep_the_dynamics():
    found = linearise(hovercraft())
    part = found.part(states=("heading", "yaw_rate"), inputs=("FY",))
    np.testing.assert_allclose(part.A, [[0, 1], [0, 0]], atol=1e-15)
    np.testing.assert_allclose(part.B, [[0], [-D / J]], rtol=1e-14)
    assert (part.states, part.inputs) == (("heading", "yaw_rate"), ("FY",))
    sizes = np.array([1.0, 2, 0.1, 10, 10, 0.5])
    scaled = found.rescale(sizes, inputs=[3.0, 4.0])
    np.testing.assert_allclose(scaled.A, np.diag(1 / sizes) @ found.A @ np.diag(sizes), rtol=1e-14)
    np.testing.assert_allclose(scaled.B, np.diag(1 / sizes) @ found.B @ np.diag([3.0, 4.0]), rtol=1e-14)
    np.testing.assert_allclose(scaled.poles(), found.poles(), atol=1e-8)


def test_rejects_invalid_arguments():
    found = linearise(hovercraft())
    with pytest.raises(InputError, match="unknown name 'pitch'"):
        found.part(states=("pitch",))
    with pytest.raises(InputError, match=r"rescale\.inputs"):
        found.rescale(np.ones(6), inputs=[1.0, 0.0])
    with pytest.raises(InputError, match="not finite for b"):
        linearise(model_of_functions(lambda x, u: jnp.stack([x[1], jnp.sqrt(x[0])]), ("a", "b"), ("u",)))
