"""The Mariner: its equations against an oracle, and the motion of its centre of mass."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import mariner
from scipy.integrate import solve_ivp

from trimtab.core.record import leaves
from trimtab.vehicles.mariner import Mariner, MarinerControls, MarinerState


def vector(record):
    return np.array([float(value) for _, value, _ in leaves(record)])


@pytest.mark.parametrize(
    ("x", "told"),
    [
        ((7.7175, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0),
        ((6.0, 0.8, 0.012, 40.0, -5.0, 0.7, 0.3), -0.4),
        ((8.1, -1.3, -0.02, 0.0, 9.0, -2.0, -0.5), 2.0),
    ],
)
def test_derivatives_match_the_oracle(x, told):
    rate = Mariner().dynamics(0.0, MarinerState(*x), MarinerControls(told))
    np.testing.assert_allclose(vector(rate), mariner.rates(np.array(x), told), rtol=1e-12, atol=1e-15)


@pytest.mark.thorough
def test_positive_rudder_turns_to_port_and_ship_is_stable():
    """Both roots of sway and yaw are on the left, and slow: those of Nomoto's 118 and 7.8 s."""
    ship = Mariner()

    def rates(z):
        return jnp.stack(ship.accelerations(MarinerState(sway_velocity=z[0], yaw_rate=z[1]))[1:])

    roots = np.sort(np.linalg.eigvals(np.asarray(jax.jacfwd(rates)(jnp.zeros(2)))).real)
    np.testing.assert_allclose(-1 / roots, [7.8, 118.0], rtol=0.02)
    assert ship.accelerations(MarinerState(rudder=0.1))[2] < 0


def test_motion_is_the_derivative_of_the_position():
    """Its place differentiated twice along a flight, against velocity and acceleration in B."""
    ship, told = Mariner(), MarinerControls(-0.3)
    start = np.array([7.0, 0.2, 0.004, 0.0, 0.0, 0.5, -0.2])
    flown = solve_ivp(lambda t, q: mariner.rates(q, -0.3), (0, 2), start, rtol=1e-11, atol=1e-12, dense_output=True)
    h = 1e-3

    def motion(t):
        return ship.motion(np.int64(0), MarinerState(*flown.sol(t)), told)

    before, now, after = (motion(t) for t in (1 - h, 1.0, 1 + h))
    c, s = np.cos(now.attitude[2]), np.sin(now.attitude[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(R @ now.v_WB_B, (after.p_WB - before.p_WB) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(R @ now.a_WB_B, (after.p_WB - 2 * now.p_WB + before.p_WB) / h**2, atol=2e-5)
    np.testing.assert_allclose(now.alpha_WB_B, (after.w_WB_B - before.w_WB_B) / (2 * h), atol=1e-7)
