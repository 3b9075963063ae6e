"""Ideal twin of a scenario: the sensor of the true state. Vector settings that are tuples."""

from typing import Any, ClassVar

import jax.numpy as jnp
import pytest
from loop.lander import HoverOutput, Lander, Thrust, hover

from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record, replace
from trimtab.core.time import ms
from trimtab.estimators.passthrough import Passthrough
from trimtab.run.loop_linearisation import linearise_loop
from trimtab.run.plant import plant_of_vehicle
from trimtab.scenarios.build import build
from trimtab.sensors.navigation_errors import PlanarNavigation
from trimtab.sensors.planar_pose import PlanarPose


@record
class HoldNorth:
    """Law that reads a position which the vehicle's state does not contain. Source: this test."""

    reads: ClassVar[tuple[str, ...]] = ("north",)

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        error = jnp.stack([-estimate.state.north, 0.0, 0.0])
        return state, HoverOutput(Thrust(error), error, 0.0, 0.0)


def test_default_truth_sensor_measures_position_for_a_law_that_reads_it():
    world = replace(hover().world, sensors={"pose": PlanarPose(period=ms(10))})
    autopilot = replace(hover().autopilot, estimator=Passthrough("pose"), law=HoldNorth())
    twin = replace(hover(), world=world, autopilot=autopilot).ideal()
    assert isinstance(twin.world.sensors["truth"], PlanarPose)


def test_ideal_twin_names_the_signal_that_its_sensor_lacks():
    own = replace(build("torpedo/depth"), truth_sensor=PlanarNavigation())
    with pytest.raises(
        InputError, match=r"in the ideal twin, .* which the sensor PlanarNavigation does not"
    ) as refused:
        own.ideal()
    assert "truth_sensor=…" in refused.value.fix
    assert "simulate(scenario)" in refused.value.fix


@record
class WindyLander(Lander):
    """Lander whose gravity is a vector setting, as a tuple. Source: this test."""

    gravity: Any = quantity("m/s^2", "Gravity.", frame="W", shape=(3,), default=(0.0, 0.0, 9.81))

    def acceleration(self, u: Any) -> Any:
        return u.F / self.mass + self.gravity


def tilted():
    return replace(hover(), world=replace(hover().world, vehicle=WindyLander()))


def test_ideal_twin_and_trim_accept_a_tuple_as_vector_setting():
    assert tilted().ideal().world.vehicle.gravity == (0.0, 0.0, 9.81)
    own = tilted()
    model = plant_of_vehicle("own", own.world.vehicle, own.initial, own.world.actuators.neutral().u).model
    assert model.evaluate(model.x0, model.u0)[0].max() == pytest.approx(9.81)


@pytest.mark.thorough
def test_loop_linearisation_accepts_a_tuple_as_vector_setting():
    assert linearise_loop(tilted(), settle=60.0).A.shape[0] > 6


def test_fault_of_own_dynamics_is_refused_with_its_line_by_trim():
    class Faulty(WindyLander):
        def acceleration(self, u: Any) -> Any:
            return u.F / self.mass + (1.0, 2.0)  # a tuple

    own = tilted()
    with pytest.raises(InputError, match=r"test_ideal_twin.py:\d+: unsupported operand"):
        plant_of_vehicle("own", Faulty(), own.initial, own.world.actuators.neutral().u)
