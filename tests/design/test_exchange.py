"""Models and compensators to and from python-control and scipy: the same response, the same names."""

import control
import numpy as np
import pytest
import scipy.signal

from trimtab.core.errors import InputError
from trimtab.design.exchange import discrete_matrices, from_control, system_matrices, to_control, to_scipy
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions

W = np.array([0.1, 1.0, 7.0])


def response(A, B, C, D, s):
    return np.array([C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D for z in s])


@pytest.fixture(scope="module")
def linear():
    A, B = np.array([[0.0, 1.0], [-3.0, -0.2]]), np.array([[0.0, 1.0], [2.0, 0.5]])
    h = {"h": lambda x, u: x[:1] + 0.1 * u[:1], "outputs": ("place",)}
    return linearise(model_of_functions(lambda x, u: A @ x + B @ u, ("x", "v"), ("F", "G"), **h))


def test_round_trip_through_python_control(linear):
    system = to_control(linear)
    assert system.output_labels == ["place"]
    np.testing.assert_allclose(
        system(1j * W).transpose(2, 0, 1) if system.ninputs > 1 else system(1j * W),
        response(linear.A, linear.B, linear.C, linear.D, 1j * W),
        rtol=1e-12,
    )
    back = from_control(system)
    assert (back.states, back.inputs, back.outputs) == (linear.states, linear.inputs, linear.outputs)
    np.testing.assert_array_equal(back.A, linear.A)


def test_imports_transfer_function_of_python_control(linear):
    s = control.tf("s")
    lead = 3 * (s + 1) / (s + 10)
    got = from_control(lead)
    np.testing.assert_allclose(
        response(got.A, got.B, got.C, got.D, 1j * W)[:, 0, 0], 3 * (1j * W + 1) / (1j * W + 10), rtol=1e-12
    )
    assert from_control(control.ss([], [], [], [[2.0]])).D.item() == 2.0


def test_exports_to_scipy_and_imports_from_it(linear):
    system = to_scipy(linear)
    np.testing.assert_array_equal(system.A, linear.A)
    A, B, C, D, dt = system_matrices(scipy.signal.TransferFunction([1, 2], [1, 3, 4], dt=0.1))
    assert dt == 0.1
    z = np.exp(1j * W * 0.1)
    np.testing.assert_allclose(response(A, B, C, D, z)[:, 0, 0], (z + 2) / (z**2 + 3 * z + 4), rtol=1e-10)


def test_tustin_keeps_the_response_at_warped_frequency():
    s = control.tf("s")
    A, B, C, D = discrete_matrices(control.ss(3 * (s + 1) / (s + 10)), 0.02)
    warped = 1j * np.tan(W * 0.01) / 0.01
    np.testing.assert_allclose(
        response(A, B, C, D, np.exp(1j * W * 0.02))[:, 0, 0], 3 * (warped + 1) / (warped + 10), rtol=1e-10
    )


def test_rejects_sampled_foreign_and_mismatched_systems():
    with pytest.raises(InputError, match="sampled"):
        from_control(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    with pytest.raises(InputError, match="is not a system"):
        from_control(3)
    with pytest.raises(InputError, match=r"be that of the loop, 0\.02 s, got 0\.1 s"):
        discrete_matrices(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1), 0.02)
