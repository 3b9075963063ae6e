"""Allocation to rotors: exact if feasible, otherwise by priority; lost rotors; and the drive."""

import functools

import jax
import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

import trimtab
from trimtab.actuators.rotor_allocation import EFFORT, RotorAllocation, RotorDrive
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import new_sample
from trimtab.vehicles.quadrotor import Multirotor, RotorDemand, Rotors, RotorSpeeds, ring_rotors

QUAD = RotorAllocation(craft=replace(Multirotor(), rotors=replace(Rotors(), torque_ratio=0.026)))
ALL = np.ones(4, bool)
WEIGHT = 4.34 * 9.81


def hexarotor(spins):
    places, turns = ring_rotors(spins, 0.4)
    return RotorAllocation(craft=replace(Multirotor(), rotors=Rotors(places=places, spins=turns, torque_ratio=0.026)))


@functools.cache
def thrusts():
    return jax.jit(lambda allocation, demand: allocation.thrusts(demand))


def give(allocation, thrust, moment, working):
    found = np.asarray(thrusts()(allocation, RotorDemand(np.float64(thrust), np.asarray(moment, float), working)))
    return found, np.asarray(allocation.craft.rotors.effectiveness()) @ found


@pytest.mark.thorough
def test_feasible_demand_is_met_exactly():
    rng = np.random.default_rng(1)
    B = np.asarray(QUAD.craft.rotors.effectiveness())
    for _ in range(200):
        T = rng.uniform(QUAD.least + 0.1, QUAD.most - 0.1, 4)
        want = B @ T
        found, made = give(QUAD, want[0], want[1:], ALL)
        np.testing.assert_allclose(found, T, atol=1e-4)
        np.testing.assert_allclose(made, want, atol=1e-4)


@pytest.mark.thorough
def test_infeasible_demand_matches_weighted_least_squares():
    rng = np.random.default_rng(2)
    B = np.asarray(QUAD.craft.rotors.effectiveness())
    reach = np.abs(B).sum(1) / 2
    W = np.diag(np.asarray(QUAD.weights) / QUAD.weights.max())
    for _ in range(200):
        v = rng.normal(size=4) * [40, 8, 8, 2]
        rows = np.vstack([W @ (B / reach[:, None]), EFFORT * np.eye(4)])
        aim = np.concatenate([W @ (v / reach), np.full(4, EFFORT * v[0] / 4)])
        want = lsq_linear(rows, aim, (QUAD.least, QUAD.most), tol=1e-15).x
        found, _ = give(QUAD, v[0], v[1:], ALL)
        cost = [np.linalg.norm(rows @ T - aim) for T in (found, want)]
        assert cost[0] <= cost[1] * (1 + 1e-6) + 1e-9
        assert ((found >= QUAD.least - 1e-12) & (found <= QUAD.most + 1e-12)).all()


def test_priority_is_tilt_then_thrust_then_yaw():
    _, made = give(QUAD, 4 * QUAD.most, [2.0, -1.0, 0.0], ALL)
    np.testing.assert_allclose(made[1:3], [2.0, -1.0], atol=0.1)
    assert made[0] < 4 * QUAD.most - 5
    _, made = give(QUAD, WEIGHT, [3.0, 0.0, 5.0], ALL)
    np.testing.assert_allclose(made[:3], [WEIGHT, 3.0, 0.0], atol=0.05)
    assert made[3] < 1.2, "yaw takes what is left"


def test_lost_rotor_is_unused_and_yaw_is_sacrificed():
    for lost in range(4):
        working = np.arange(4) != lost
        found, made = give(QUAD, WEIGHT, np.zeros(3), working)
        assert found[lost] == 0
        assert (found[working] >= QUAD.least - 1e-12).all()
        assert made[0] == pytest.approx(WEIGHT, rel=0.05)
        np.testing.assert_allclose(made[1:3], 0, atol=0.15)
        assert np.sign(made[3]) == -np.sign(np.asarray(QUAD.craft.rotors.spins)[working].sum())


def reachable(allocation, lost, size=0.3):
    """Whether weight and every small moment, to either side of each axis, are within the limits: by linear programs."""
    B = np.delete(np.asarray(allocation.craft.rotors.effectiveness()), lost, axis=1)
    bounds = [(allocation.least, allocation.most)] * B.shape[1]
    demands = [np.array([WEIGHT, *(s * size * np.eye(3)[k])]) for k in range(3) for s in (-1, 1)]
    return all(linprog(np.zeros(B.shape[1]), A_eq=B, b_eq=v, bounds=bounds).status == 0 for v in demands)


@pytest.mark.thorough
def test_hexarotor_controllability_after_rotor_loss_depends_on_layout():
    """PPNNPN keeps it where any of four rotors is lost, PNPNPN never: G.-X. Du, Q. Quan, B. Yang, K.-Y. Cai,
    "Controllability analysis for multirotor helicopter rotor degradation and failure", JGCD 38 (2015)."""
    assert not any(reachable(hexarotor("PNPNPN"), lost) for lost in range(6))
    allocation = hexarotor("PPNNPN")
    kept = [lost for lost in range(6) if reachable(allocation, lost)]
    assert len(kept) == 4
    for lost in kept:
        working = np.arange(6) != lost
        for axis in range(3):
            for sign in (-1, 1):
                want = sign * 0.3 * np.eye(3)[axis]
                found, made = give(allocation, WEIGHT, want, working)
                assert found[lost] == 0
                np.testing.assert_allclose(made, [WEIGHT, *want], atol=1e-3)


def test_redundant_rotors_share_thrust_evenly():
    found, _ = give(hexarotor("PNPNPN"), WEIGHT, np.zeros(3), np.ones(6, bool))
    np.testing.assert_allclose(found, WEIGHT / 6, rtol=1e-4)


@pytest.mark.thorough
def test_allocation_in_c_matches_jax():
    demand = RotorDemand(np.float64(90.0), np.array([3.0, -2.0, 1.0]), np.array([True, True, False, True]))
    step = trimtab.compile(lambda a, d: a.thrusts(d), QUAD, demand)
    np.testing.assert_allclose(step(QUAD, demand), thrusts()(QUAD, demand), atol=1e-12)


def test_rejects_minimum_thrust_above_maximum():
    with pytest.raises(InputError, match="minimum thrust of 40 N"):
        replace(QUAD, least=40.0).check()


def test_drive_clips_and_quantises_rotor_speeds():
    drive = RotorDrive(resolution=0.5)

    def tell(speeds, part=drive, valid=True):
        sample = new_sample(np.int64(0), RotorSpeeds(np.asarray(speeds, float)))
        return np.asarray(part.step(0, part.init(key(0)), replace(sample, valid=np.asarray(valid)))[1].u.speed)

    np.testing.assert_allclose(tell([0.0, 10.0, 300.3, 9000.0]), [0, 40, 300.5, 615])
    np.testing.assert_allclose(tell([300.3] * 4, valid=False), 0)
    free = replace(drive, resolution=0.0, saturation=False)
    np.testing.assert_allclose(tell([-20.0, 10.0, 300.3, 9000.0], free), [-20, 10, 300.3, 9000])
