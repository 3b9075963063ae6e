"""quadrotor/track, whole flights: paths, recovery from upside down, and loss of each rotor."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.loop.fault_text import inject_faults
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios.build import build

ROTORS = range(1, 5)


def fly(seed=0, faults=(), **choices):
    scenario = build("quadrotor/track", choices)
    return simulate(inject_faults(scenario, list(faults)) if faults else scenario, seed=seed)


@pytest.mark.thorough
@pytest.mark.parametrize(("trajectory", "most"), [("circle", 0.1), ("eight", 0.1), ("helix", 0.05)])
def test_quadrotor_stays_on_its_path(trajectory, most):
    log = fly(trajectory=trajectory)
    assert log["law.distance"][log.t > 5].max() < most
    assert log["law.attitude_error"].max() < 0.2
    assert not log["law.lost"].any()
    np.testing.assert_allclose(np.linalg.norm(log["truth.attitude"], axis=1), 1, atol=1e-12)


@pytest.mark.thorough
def test_quadrotor_reaches_and_holds_a_place():
    log = fly(trajectory="place")
    assert log["law.distance"][log.t > 3].max() < 0.05


@pytest.mark.thorough
def test_quadrotor_recovers_from_upside_down():
    log = fly(trajectory="recovery")
    assert log["law.attitude_error"].max() > 1.8
    assert log["law.attitude_error"][log.t > 2].max() < 0.5
    assert log["law.distance"][-1] < 6
    assert log["law.distance"][-1] < log["law.distance"].max() / 2, "it falls, and comes back"


@pytest.mark.thorough
@pytest.mark.parametrize("rotor", ROTORS)
def test_lost_rotor_keeps_the_quadrotor_near_its_place(rotor):
    """Within 3 m in the first seconds, within 0.1 m from 6 s after the loss, spinning at about 3 Hz."""
    log = fly(trajectory="place", motor=f"{rotor}-fails")
    after = log.t > 2
    assert log.t[np.argmax(log["law.lost"])] < 2.1
    assert (log["law.rotor"][log["law.lost"] > 0] == rotor - 1).all()
    assert log["law.distance"][after].max() < 3
    assert log["law.distance"][log.t > 8].max() < 0.1
    assert 2.5 < abs(log["truth.rate"][-1, 2]) / (2 * np.pi) < 4
    assert (log["truth.rotor_speed"][after & (log.t > 2.2), rotor - 1] < 1).all()


@pytest.mark.thorough
@pytest.mark.parametrize("rotor", ROTORS)
def test_lost_rotor_hover_holds_for_25_seeds(rotor):
    for seed in range(1, 26):
        log = fly(seed, trajectory="place", motor=f"{rotor}-fails")
        assert log["law.distance"][log.t > 2].max() < 3, seed
        assert log["law.distance"][log.t > 8].max() < 0.15, seed


@pytest.mark.thorough
@pytest.mark.parametrize("rotor", ROTORS)
def test_recovers_from_rotor_loss_on_the_circle(rotor):
    """On the circle the loss of rotor 3 tips the craft over: with most seeds it is upside down a second later."""
    scenario = build("quadrotor/track", {"motor": f"{rotor}-fails"})
    logs = simulate_many(scenario, seeds=range(20), log_period=ms(20), signals=("law.distance",))
    assert max(log.between(2, 10)["law.distance"].max() for log in logs) < 5
    assert max(log.between(8, 10)["law.distance"].max() for log in logs) < 0.1


@pytest.mark.thorough
def test_motor_failure_equals_the_actuator_fault():
    log = fly(trajectory="place", faults=["actuators:speed[1] off @ 2 s"])
    same = fly(trajectory="place", motor="2-fails")
    np.testing.assert_array_equal(log["truth.position"], same["truth.position"])


@pytest.mark.thorough
def test_slowed_rotor_is_not_detected_as_lost():
    log = fly(trajectory="place", faults=["actuators:speed[0] wrong by -0.1 @ 2 s"])
    assert not log["law.lost"].any()
    assert log["actuators.u.speed"][-1, 0] == pytest.approx(0.9 * log["command.value.speed"][-1, 0], abs=20)
    assert log["law.distance"][log.t > 8].max() < 0.3


def test_rejects_the_neural_law_with_a_lost_rotor():
    with pytest.raises(InputError, match="not trained for flight with a failed rotor"):
        build("quadrotor/track", {"law": "neural", "motor": "1-fails"})


@pytest.mark.thorough
def test_ideal_twin_keeps_the_vehicle_and_its_model():
    """Drag and motor lag belong to the vehicle; speed steps and limits are imperfections of the drives."""
    flown = build("quadrotor/track")
    ideal = flown.ideal()
    ideal.check()
    assert ideal.world.vehicle.lag == flown.world.vehicle.lag
    np.testing.assert_array_equal(ideal.autopilot.allocation.craft.drag, flown.world.vehicle.drag)
    assert flown.world.actuators.resolution > 0
    assert ideal.world.actuators.resolution == 0
    assert not ideal.world.actuators.saturation
