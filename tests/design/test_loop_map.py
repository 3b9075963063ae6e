"""A loop's map: a plain sampled loop, in one instant and in several; gain, delay and response by hand."""

import math

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design.loop_map import LoopMap, find_crossings, loop_margins

A, B, K = np.array([[1.0, 0.1], [0.0, 0.98]]), np.array([[0.005], [0.1]]), np.array([[-2.0, -1.5]])


def made(gain=1.0, instants=1):
    """x(k+1) = A x + B u, u = K x; in several instants the steps after the first only wait, the command held."""
    first, rest = np.zeros((4, 4)), np.eye(4)
    first[:2, :2], first[2, 2] = np.eye(2), 1.0
    step = np.block([[A, np.zeros((2, 2))], [np.zeros((2, 4))]])
    step[2, 2] = 1.0
    stack = [step, *[rest] * (instants - 1)]
    inputs = [np.vstack([B, [[0], [0]]]), *[np.zeros((4, 1))] * (instants - 1)]
    outputs = [np.hstack([gain * K, np.zeros((1, 2))])] * instants
    idle = np.array([False, False, True, True])
    names = ("a", "b", "place", "age")
    return LoopMap(np.array(stack), np.array(inputs), np.array(outputs), 0.1 / instants, names, ("u",), idle, 0.1)


def test_poles_and_growth_match_eigenvalues():
    loop = made()
    wanted = np.linalg.eigvals(A + B @ K)
    assert loop.growth() == pytest.approx(np.abs(wanted).max())
    assert np.sort(loop.continuous_poles().real) == pytest.approx(np.sort(np.log(wanted.astype(complex)).real / 0.1))
    assert made(instants=3).growth() == pytest.approx(loop.growth())


def test_gain_and_delay_margins_match_eigenvalue_search():
    margins = loop_margins(made())
    assert np.abs(np.linalg.eigvals(A + margins.gain_up * B @ K)).max() == pytest.approx(1, abs=1e-5)
    assert margins.gain_down == 0.0

    def delayed(steps):
        whole = np.zeros((2 + steps, 2 + steps))
        whole[:2, :2], whole[:2, 2:3] = A, B
        whole[2:-1, 3:] = np.eye(steps - 1)
        whole[-1, :2] = K
        return np.abs(np.linalg.eigvals(whole)).max()

    last = max(s for s in range(1, 20) if delayed(s) < 1)
    assert margins.delay == pytest.approx(0.1 * last)


def test_response_and_crossings_match_analytic_values():
    loop, w = made(), np.array([0.3, 1.0, 9.0])
    z = np.exp(0.1j * w)
    wanted = np.array([-(K @ np.linalg.solve(v * np.eye(2) - A, B)).item() for v in z])
    np.testing.assert_allclose(loop.response(w)[:, 0, 0], wanted, rtol=1e-10)
    ((frequency, phase),) = find_crossings(loop)["u"]
    there = loop.response(frequency).item()
    assert abs(there) == pytest.approx(1, rel=1e-3)
    assert phase == pytest.approx(math.pi + np.angle(there), abs=1e-9)


def test_broken_loop_keeps_the_other_command_closed():
    """Two integrators that drive each other: 1 + L of one is the ratio of determinants with the other closed."""
    A2, B2, K2 = np.array([[1.0, 0.05], [-0.05, 1.0]]), 0.1 * np.eye(2), -np.array([[1.0, 0.4], [0.2, 2.0]])
    loop = LoopMap(A2[None], B2[None], K2[None], 0.1, ("a", "b"), ("u", "v"), np.zeros(2, bool), 0.1)
    z = np.exp(0.1j * 2.0)
    one = np.linalg.det(z * np.eye(2) - A2 - B2 @ K2) / np.linalg.det(z * np.eye(2) - A2 - B2 @ np.diag([0, 1]) @ K2)
    assert loop.broken_loops([2.0])[0, 0] == pytest.approx(one - 1)


def test_rejects_margins_of_an_unstable_loop():
    with pytest.raises(InputError, match="the loop is not stable"):
        loop_margins(made(gain=-1.0))
