"""Relaxed hover without a rotor: an equilibrium of the spin, checked by the vehicle's own equations in flight."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.design.relaxed_hover import find_relaxed_hover, relaxed_axes
from trimtab.scenarios.quadrotor.track import CRAFT
from trimtab.vehicles.quadrotor import Multirotor, MultirotorState, RotorSpeeds


@pytest.mark.thorough
@pytest.mark.parametrize("lost", range(4))
def test_relaxed_hover_spins_without_falling(lost):
    hover = find_relaxed_hover(CRAFT, lost, 0.3)
    craft = replace(to_arrays(CRAFT), lag=0.0, drag=np.zeros(3))
    speed = np.asarray(craft.rotors.speeds(hover.thrusts))
    # the axis, fixed in B, points down in W: B is turned about axis × down
    v = np.cross(hover.axis, [0, 0, 1])
    q = np.array([1 + hover.axis[2], *v])
    x0 = np.concatenate([np.zeros(6), q / np.linalg.norm(q), hover.rate])

    def f(t, x):
        state = MultirotorState(x[:3], x[3:6], x[6:10], x[10:13], speed)
        d = craft.dynamics(t, state, RotorSpeeds(speed))
        return np.concatenate([d.position, d.velocity, d.attitude, d.rate])

    end = solve_ivp(f, (0, 0.7), x0, rtol=1e-7, atol=1e-9).y[:, -1]
    np.testing.assert_allclose(end[10:13], hover.rate, atol=1e-5)
    assert abs(end[5]) < 1e-4, "it neither climbs nor sinks"
    weight = float(CRAFT.mass * CRAFT.gravity)
    assert hover.thrusts.sum() * hover.axis[2] == pytest.approx(weight)
    assert hover.thrusts[lost] == 0
    assert hover.thrusts[(lost + 2) % 4] == pytest.approx(0.3 * hover.thrusts[(lost + 1) % 4])


def test_spin_direction_follows_the_remaining_rotors():
    for lost, spin in enumerate(np.asarray(CRAFT.rotors.spins)):
        hover = find_relaxed_hover(CRAFT, lost, 0.3)
        assert np.sign(hover.rate[2]) == spin, "two of the others turn against the lost one; the body against them"
        assert 15 < abs(hover.rate[2]) < 25
    axes = relaxed_axes(CRAFT, 0.3)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)
    assert (axes[:, 2] > 0.9).all()


def test_rejects_craft_without_turning_drag():
    with pytest.raises(InputError, match="turning_drag"):
        find_relaxed_hover(Multirotor(), 0)
