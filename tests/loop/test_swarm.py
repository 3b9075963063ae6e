"""N parts side by side behave like each one alone; craft communicate only by radio."""

import jax
import numpy as np
import pytest

from trimtab.actuators.allocation import ThrustVectorAllocation
from trimtab.actuators.drive import DriveCommand, FanDrive
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import Key, key, split
from trimtab.core.signals import Motion, PeerMessage, PlanarForce, Sample, SwarmInput
from trimtab.core.time import NEVER, ms
from trimtab.loop.swarm import Each, Swarm, SwarmActuators
from trimtab.sensors.planar_pose import NoisyPlanarPose
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

N = 3
RNG = np.random.default_rng(1)


def row(tree, i):
    return jax.tree.map(lambda v: v[i], tree)


def motions():
    six = [RNG.normal(0, 1, (N, 3)) for _ in range(6)]
    return Motion(np.full(N, ms(10), np.int64), *six)


def same(a, b, rtol=1e-13):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=rtol, atol=1e-13)


@pytest.mark.thorough
def test_each_sensor_measures_its_own_motion_with_its_own_noise():
    swarm, keys, motion = Each(NoisyPlanarPose(), N), split(key(3), N), motions()
    state = swarm.init(key(3))
    _, sample = swarm.step(np.int64(ms(10)), state, motion)
    for i in range(N):
        one = NoisyPlanarPose()
        alone = Key(keys.seed[i], keys.run[i], keys.stream)
        _, expected = one.step(np.int64(ms(10)), one.init(alone), row(motion, i))
        same(row(sample.value, i), expected.value)
    assert sample.t == ms(10)
    assert sample.t.shape == sample.valid.shape == ()
    noise = jax.tree.leaves(jax.tree.map(np.subtract, sample.value, swarm.measure(motion)))
    assert all(len(set(np.asarray(v).round(9))) == N for v in noise), "two craft have the same noise"


def test_noise_of_a_craft_is_independent_of_swarm_size():
    few, many = split(key(7), 3), split(key(7), 100)
    np.testing.assert_array_equal(few.seed, many.seed[:3])
    assert len(set(zip(many.seed.tolist(), many.run.tolist(), strict=True))) == 100


@pytest.mark.thorough
def test_each_actuator_has_its_own_state():
    swarm = Each(FanDrive(period=ms(20)), N)
    commands = DriveCommand(rudder_pulse=np.array([1.4e-3, 1.5e-3, 1.6e-3]), speed_rpm=np.array([9e3, -7e3, 0.0]))
    state = swarm.init(key(0))
    for k in range(3):
        t = np.int64(k * ms(20))
        state, out = swarm.step(t, state, Sample(commands, t, 0.0, True, True))
    for i in range(N):
        one, alone = FanDrive(period=ms(20)), FanDrive(period=ms(20)).init(key(0))
        for k in range(3):
            t = np.int64(k * ms(20))
            alone, expected = one.step(t, alone, Sample(row(commands, i), t, 0.0, True, True))
        same(row(out, i), expected)


@pytest.mark.thorough
def test_per_craft_fields_take_one_value_per_craft():
    zones = np.array([0.05, 0.5, 2.0])
    swarm = Each(replace(ThrustVectorAllocation(), dead_zone=zones), N, ("dead_zone",))
    swarm.check()
    _, out = swarm.step(np.int64(0), swarm.init(key(0)), PlanarForce(np.full(N, 0.4), np.zeros(N)))
    np.testing.assert_array_equal(out.speed_rpm > 0, [True, False, False])
    with pytest.raises(InputError, match="3 craft"):
        Each(replace(ThrustVectorAllocation(), dead_zone=zones[:2]), N, ("dead_zone",)).check()
    with pytest.raises(InputError, match="no field"):
        Each(ThrustVectorAllocation(), N, ("mass",)).check()


def test_swarm_dynamics_match_each_vehicle_alone():
    craft = Hovercraft()
    x = HovercraftState(*RNG.normal(0, 1, (6, N)))
    u = SwarmInput(PlanarForce(*RNG.normal(0, 1, (2, N))), PeerMessage())
    rate, motion = Swarm(craft, N).dynamics(0.0, x, u), Swarm(craft, N).motion(np.int64(5), x, u)
    for i in range(N):
        same(row(rate, i), craft.dynamics(0.0, row(x, i), row(u.act, i)))
        same(row(replace(motion.each, t=np.full(N, 5)), i), craft.motion(np.int64(5), row(x, i), row(u.act, i)))


@pytest.mark.thorough
def test_no_message_is_sent_without_a_valid_command():
    silence = PeerMessage(np.full(N, NEVER), *np.zeros((4, N)))
    actuators = SwarmActuators(Each(FanDrive(period=ms(20)), N), silence)
    words = PeerMessage(np.full(N, 5), *np.ones((4, N)))
    value = SwarmInput(DriveCommand(np.full(N, 1.5e-3), np.full(N, 5e3)), words)
    for valid in (False, True):
        state = actuators.init(key(0))
        _, out = actuators.step(np.int64(0), state, Sample(value, np.int64(0), 0.0, True, valid))
        same(out.u.message, words if valid else silence)
        assert (np.asarray(out.u.act.FX) > 0).all() == valid
