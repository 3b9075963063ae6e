"""Swing-up: the LQR gain, the energy rising to that of the upright pole, and the full loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab import simulate
from trimtab.core.signals import Estimate
from trimtab.design.lqr import lqr
from trimtab.laws.swing_up import BALANCE, SWING, SwingUp, SwingUpState
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.build import build
from trimtab.vehicles.cart_pole import CartForce, CartPole, CartPoleState

LAW = SwingUp()


def at(angle, rate=0.0, mode=SWING, valid=True):
    """Return state and output of the law there."""
    x = CartPoleState(0.0, 0.0, angle, rate)
    estimate = Estimate(t=0, age=0.0, fresh=True, valid=jnp.asarray(valid), state=x, stick=None, dt=0.01)
    return LAW.step(0, SwingUpState(mode=np.int32(mode)), estimate)


def linear_model():
    """Return A and B of the upright pole."""

    def rates(y, u):
        d = CartPole().dynamics(0.0, CartPoleState(*y), CartForce(u))
        return jnp.stack([jnp.asarray(v, float) for v in (d.position, d.speed, d.angle, d.angle_rate)])

    zero = jnp.zeros(4)
    return np.asarray(jax.jacfwd(rates)(zero, 0.0)), np.asarray(jax.jacfwd(rates, 1)(zero, 0.0))[:, None]


@pytest.mark.thorough
def test_gain_matches_the_lqr_design():
    A, B = linear_model()
    K = lqr(A, B, np.diag([1.0, 1.0, 10.0, 1.0]), np.array([[0.1]])).K[0]
    np.testing.assert_allclose(-np.asarray(LAW.K), K, rtol=1e-4)
    assert np.linalg.eigvals(A - B @ np.asarray(LAW.K)[None]).real.max() < -0.5


def test_switches_between_swing_and_balance_modes():
    assert at(np.pi - 0.1)[0].mode == SWING
    assert at(2 * np.pi + 0.2)[0].mode == BALANCE
    assert at(0.2, rate=3.0)[0].mode == SWING
    assert at(0.6, mode=BALANCE)[0].mode == BALANCE
    assert at(1.0, mode=BALANCE)[0].mode == SWING
    assert at(1.0, mode=BALANCE, valid=False)[0].mode == BALANCE
    assert float(at(2 * np.pi + 0.2)[1].lean) == pytest.approx(0.2)


@pytest.mark.parametrize("angle", [0.5, 1.3, 2.0, 3.0])
@pytest.mark.parametrize("rate", [-3.0, 0.5, 2.0])
def test_swing_drives_the_energy_toward_the_target(angle, rate):
    """E' = -m l a q' cos q has the other sign than E."""
    x, out = CartPoleState(0.0, 0.0, angle, rate), at(angle, rate)[1]
    a = CartPole().dynamics(0.0, x, out.demand).speed
    assert float(-a * rate * np.cos(angle) * out.energy) <= 1e-12
    assert abs(float(a)) <= 0.6 * 9.8 + 1e-9


@pytest.mark.thorough
def test_full_loop_swings_up_and_balances_the_pole():
    scenario = build("cart-pole/swing-up")
    for flown in (scenario, scenario.ideal()):
        log = simulate(flown)
        mode = log["law.mode"]
        assert np.abs(np.diff(mode.astype(int))).sum() == 1  # one catch
        assert 2.5 < log.t[np.argmax(mode == BALANCE)] < 3.5
        assert np.abs(log["law.lean"][-200:]).max() < 0.005
        assert np.abs(log["truth.position"]).max() < 2.4  # the rail of [1]
        assert np.abs(log["truth.position"][-100:]).max() < 0.02


def test_catches_the_pole_from_every_hanging_angle():
    scenario = build("cart-pole/swing-up")
    angles = np.pi + np.linspace(-1.0, 1.0, 64)
    angles = angles[abs(angles - np.pi) > 0.05]
    batch = simulate_batch(scenario, seeds=[0] * len(angles), spread={"initial.angle": angles})
    lean = np.angle(np.exp(1j * batch.final["truth.angle"]))
    assert np.abs(lean).max() < 0.02


def test_weak_motor_fails_to_balance():
    log = simulate(build("cart-pole/swing-up", {"world.actuators.stages.force.0.high": "0.5"}))
    assert not (log["law.mode"][-100:] == BALANCE).all()
