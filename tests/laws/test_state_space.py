"""A compensator as a law: scipy's sequence, its period, and matrices of wrong shape."""

import numpy as np
import pytest
from scipy.signal import dlsim

from trimtab.core.errors import InputError
from trimtab.core.signals import Estimate, PlanarForce, PlanarState
from trimtab.core.time import ms
from trimtab.laws.state_space import StateSpaceLaw

A = np.array([[0.9, 0.1], [-0.2, 0.7]])
B = np.array([[1.0, 0.0], [0.3, -1.0]])
C = np.array([[0.5, -1.0], [0.0, 2.0]])
D = np.array([[0.1, 0.0], [0.0, -0.4]])


def law(**change):
    how = {"reads": ("yaw_rate", "heading"), "A": A, "B": B, "C": C, "D": D, "x0": np.array([0.2, 0.0])}
    return StateSpaceLaw(**how | {"u0": PlanarForce(1.0, 0.0), "period": ms(20)} | change)


def test_outputs_match_scipy_dlsim_and_are_held():
    errors = np.random.default_rng(0).normal(size=(30, 2))
    _, wanted, _ = dlsim((A, B, C, D, 0.02), errors)
    one = law()
    one.check()
    state, seen = one.init(None), []
    for k in range(30 * 4):  # the autopilot steps four times as often
        yaw_rate, heading = errors[k // 4] + [0.2, 0.0]
        frame = PlanarState(0.0, 0.0, yaw_rate, heading)
        now = Estimate(t=0, age=0.0, fresh=True, valid=True, state=frame, dt=0.005)
        state, out = one.step(np.int64(ms(5) * k), state, now)
        seen.append([float(out.demand.FX) - 1.0, float(out.demand.FY)])
    np.testing.assert_allclose(np.array(seen)[::4], wanted, atol=1e-12)
    np.testing.assert_array_equal(np.array(seen)[1::4], np.array(seen)[::4])


def test_rejects_matrices_of_mismatched_shape():
    for change in ({"A": np.zeros((2, 3))}, {"B": np.zeros((1, 2))}, {"C": np.zeros(2)}, {"D": np.zeros((2, 3))}):
        with pytest.raises(InputError, match="do not match"):
            law(**change).check()
