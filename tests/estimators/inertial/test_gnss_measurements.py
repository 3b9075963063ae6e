"""What is expected of a receiver is what the sensors measure, and its derivatives are the automatic ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.record import replace
from trimtab.core.rotation import to_euler
from trimtab.core.signals import Motion
from trimtab.estimators.inertial.error_state import SpatialStart, first_nominal, put_error_in
from trimtab.estimators.inertial.gnss_measurements import GnssNoise, expect_fix, expect_ranges, set_clock
from trimtab.sensors.gnss import Gnss
from trimtab.sensors.gnss_ranges import GnssRanges

ARM = jnp.array([0.8, -0.3, -0.5])
START = SpatialStart(angles=(0.3, -0.2, 1.0), velocity=(10.0, -3.0, 1.0), position=(5.0, 6.0, -70.0))


def state(n):
    x = first_nominal(START, n)
    x = replace(x, rate=jnp.array([0.4, -0.7, 0.9]), acceleration=jnp.array([1.0, -5.0, 2.0]))
    return replace(x, clock=jnp.array([120.0, 3.0]) * (n > 15))


def motion_of(x):
    """What the world would say of a state."""
    R = quaternion.to_matrix(x.attitude)
    none = jnp.zeros(3)
    return Motion(np.int64(0), x.position, to_euler(R), R.T @ x.velocity, x.rate, none, none)


def measured(x, aiding):
    """The sensor's own measurement of a state, as one vector."""
    if aiding == "fixes":
        value = Gnss(lever_arm=ARM).measure(motion_of(x))
        return jnp.concatenate([value.position, value.velocity])
    value = GnssRanges(lever_arm=ARM).measure(motion_of(x))
    seen = jnp.asarray(value.received, float)
    clocked = value.pseudorange + x.clock[0], value.range_rate + x.clock[1]
    return jnp.concatenate([*clocked, value.satellites, value.satellite_velocities, seen])


@pytest.mark.thorough
@pytest.mark.parametrize(("aiding", "n", "expect"), [("fixes", 15, expect_fix), ("ranges", 17, expect_ranges)])
def test_prediction_and_jacobian_match_the_sensor(aiding, n, expect):
    """Of a state with an error put in; a gyro's bias that is missing turns the antenna too slowly."""
    x = state(n)

    def truth(e):
        true = put_error_in(x, e, x.P)
        return replace(true, rate=x.rate - e[9:12])

    e = expect(x, measured(x, aiding), 0.0, ARM, GnssNoise())
    np.testing.assert_allclose(e.y, 0, atol=1e-7)
    m = e.y.shape[0]
    J = jax.jacfwd(lambda err: measured(truth(err), aiding)[:m])(jnp.zeros(n))
    np.testing.assert_allclose(e.H, J, atol=1e-9)
    assert e.wanted.all()


@pytest.mark.thorough
def test_earlier_fix_is_predicted_at_its_time():
    x = state(15)
    value = measured(x, "fixes")
    e = expect_fix(x, value, -0.001, ARM, GnssNoise())
    np.testing.assert_allclose(e.y[:3], 0.001 * value[3:], atol=1e-12)
    np.testing.assert_allclose(e.y[3:], 0.001 * x.acceleration, atol=1e-12)


def test_fix_variances_match_receiver_noise_per_axis():
    e = expect_fix(state(15), jnp.zeros(6), 0.0, ARM, GnssNoise(position=2.0, position_down=3.0, velocity=0.1))
    np.testing.assert_allclose(e.R, [4, 4, 9, 0.01, 0.01, 0.08**2])


@pytest.mark.thorough
def test_missing_satellites_are_not_used():
    x = state(17)
    value = measured(x, "ranges").at[-8].set(0.0)
    wanted = np.asarray(expect_ranges(x, value, 0.0, ARM, GnssNoise()).wanted)
    assert not wanted[0]
    assert not wanted[8]
    assert wanted.sum() == 14


@pytest.mark.thorough
def test_first_ranges_initialise_the_clock():
    """From the received satellites only; the remaining innovations do not depend on the clock."""
    x = state(17)
    value = measured(x, "ranges").at[-8].set(0.0)
    off = replace(x, clock=jnp.zeros(2))
    e = expect_ranges(off, value, 0.0, ARM, GnssNoise())
    on, left = set_clock(off, e)
    np.testing.assert_allclose(on.clock, [120.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(left.y[left.wanted], 0, atol=1e-6)
