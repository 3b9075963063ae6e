"""Settings that replace parts by the names of their classes."""

import json

import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import is_record
from trimtab.laws.spin import ConstantSpin
from trimtab.links.wire import Wire
from trimtab.loop.integration import Integration
from trimtab.loop.parts import find_class, part_modules, presets
from trimtab.loop.settings import with_settings
from trimtab.scenarios import catalogue
from trimtab.sensors.imu import Imu


@pytest.fixture(scope="module")
def spin():
    return catalogue.load_scenario("hovercraft/spin")[0]


def test_lists_the_class_names_of_records():
    modules = part_modules()
    assert modules["Hovercraft"] == "trimtab.vehicles.hovercraft"
    assert {"Wire", "Imu", "ConstantSpin", "FanDrive", "Passthrough", "Circle"} <= modules.keys()
    assert "Distribution" not in modules  # no record
    for name in ("Imu", "Wire", "ConstantSpin"):
        assert is_record(find_class("", name)())


def test_setting_a_class_name_replaces_the_part(spin):
    made = with_settings(spin, {"autopilot.law.k1": "2 kg/s", "autopilot.law": "ConstantSpin"})
    assert isinstance(made.autopilot.law, ConstantSpin)
    assert made.autopilot.law.k1 == 2
    assert made.autopilot.law.k2 == ConstantSpin().k2
    assert with_settings(spin, {"world.uplink": "Wire", "world.uplink.period": "2 ms"}).world.uplink.period == 20_000


def test_setting_the_same_class_keeps_its_parameters(spin):
    changed = with_settings(spin, {"world.vehicle.mass": "9"})
    assert with_settings(changed, {"world.vehicle": "Hovercraft"}).world.vehicle.mass == 9


def test_adds_and_removes_a_sensor(spin):
    made = with_settings(spin, {"world.sensors.imu": "Imu.microstrain_3dm_gx1", "world.sensors.imu.period": "10 ms"})
    assert list(made.world.sensors) == ["navigation", "imu"]
    assert made.world.sensors["imu"].gyro.noise == Imu.microstrain_3dm_gx1().gyro.noise
    assert made.world.sensors["imu"].period == 100_000
    assert list(with_settings(made, {"world.sensors.navigation": "none"}).world.sensors) == ["imu"]


def test_adds_and_removes_an_optional_part(spin):
    made = with_settings(spin, {"world.integration": "Integration", "world.integration.method": "rk4-doubling"})
    assert made.world.integration.method == "rk4-doubling"
    assert with_settings(made, {"world.integration": "none"}).world.integration is None
    assert isinstance(with_settings(spin, {"world.integration.relative": "1e-6"}).world.integration, Integration)


def test_presets_are_methods_without_arguments():
    assert "microstrain_3dm_gx1" in presets(Imu)
    assert "reading" not in presets(find_class("", "NavigationErrors"))  # it wants a name
    assert presets(Wire) == {}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"autopilot.law": "ConstantSpni"}, "unknown part 'ConstantSpni'[\\s\\S]*ConstantSpin"),
        ({"autopilot.law": "os.system"}, "unknown part 'os'"),
        ({"world.sensors.imu": "Imu.nothing"}, "Imu has no product 'nothing'"),
        ({"world.vehicle": "none"}, "can't be left out"),
        ({"world.vehicle.mass": "3 m"}, "'m' is not a unit of this quantity[\\s\\S]*kg"),
        ({"world.vehicle.mass": "three"}, "'three' is not a number"),
        ({"world.actuators.thruster.reverse_ratio": "[1, 2] m"}, "'m' is not a unit"),
        ({"world.actuators.thruster.reverse_ratio": "[1, 2]"}, "has shape"),
        ({"world.actuators.thruster.reverse_ratio": "[1, x]"}, "not a list"),
    ],
)
def test_rejects_invalid_parts(spin, settings, said):
    with pytest.raises(InputError, match=said) as refused:
        with_settings(spin, settings)
    assert refused.value.fix


def test_missing_field_without_default_raises(spin):
    with pytest.raises(InputError, match=r"settings initial.position: RigidBodyState needs .position."):
        with_settings(spin, {"initial": "RigidBodyState"})


def test_arrays_accept_units(spin):
    path = "initial.surge_velocity"
    assert with_settings(spin, {path: "36 km/h"}).initial.surge_velocity == pytest.approx(10)
    turned = with_settings(spin, {"autopilot.allocation.rudder.angles": f"[{', '.join(['90'] * 21)}] deg"})
    assert turned.autopilot.allocation.rudder.angles[3] == pytest.approx(3.141592653589793 / 2)
    each = with_settings(spin, {"autopilot.allocation.rudder.angles": json.dumps(["90 deg"] * 21)})
    assert each.autopilot.allocation.rudder.angles[20] == pytest.approx(3.141592653589793 / 2)
