"""MAVLink types of the vehicles, against the numbers of pymavlink."""

import pytest

from trimtab.core.errors import InputError
from trimtab.scenarios import catalogue
from trimtab.vehicles.vehicle_type import VehicleType, mav_type

WANTED = {
    "cart-pole": "GENERIC",
    "dubins": "GROUND_ROVER",
    "f16": "FIXED_WING",
    "hovercraft": "SURFACE_BOAT",
    "hypersonic": "FIXED_WING",
    "navigation/aerial": "FIXED_WING",
    "navigation/platform": "GENERIC",
    "quadrotor": "QUADROTOR",
    "swarm": "GENERIC",
    "torpedo": "SUBMARINE",
}


QUICK = {name.split("/")[0]: name for name in catalogue.scenario_names() if not name.startswith("hypersonic/")}
"""A scenario of each vehicle that builds quickly, by the first part of its name."""


@pytest.mark.thorough(*(name for name in catalogue.scenario_names() if name not in QUICK.values()))
@pytest.mark.parametrize("name", catalogue.scenario_names())
def test_every_scenario_vehicle_has_its_mavlink_type(name):
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    wanted = next((kind for start, kind in WANTED.items() if name.startswith(start)), "SURFACE_BOAT")
    scenario, _ = catalogue.load_scenario(name)
    assert mav_type(scenario.world.vehicle) == getattr(common, f"MAV_TYPE_{wanted}")


def test_vehicle_without_declared_type_is_generic():
    assert mav_type(object()) == 0


def test_rejects_unknown_vehicle_type():
    class Boat:
        MAV_TYPE = "SURFACE-BOAT"

    with pytest.raises(InputError, match="Boat declares MAV_TYPE = 'SURFACE-BOAT'") as refused:
        mav_type(Boat())
    assert "SURFACE_BOAT" in refused.value.choices


OWN_NAMES = {"GROUND_STATION": "GCS", "ONBOARD_COMPUTER": "ONBOARD_CONTROLLER"}


def test_vehicle_types_match_mavlink_numbers():
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    names = {int(number): entry.name.removeprefix("MAV_TYPE_") for number, entry in common.enums["MAV_TYPE"].items()}
    assert {kind.value: OWN_NAMES.get(kind.name, kind.name) for kind in VehicleType}.items() <= names.items()
    vehicles = ("ROTOR", "COPTER", "WING", "ROVER", "BOAT", "SUBMARINE", "AIRSHIP", "BALLOON", "ROCKET", "VTOL_QUAD")
    assert {n for n in names.values() if n.endswith(vehicles)} <= set(VehicleType.__members__)


@pytest.mark.parametrize("name", ["MAV_TYPE_SUBMARINE", "submarine", "SUBMARIN"])
def test_misspelt_type_suggests_the_right_one(name):
    with pytest.raises(InputError) as refused:
        mav_type(type("Boat", (), {"MAV_TYPE": name})())
    assert 'MAV_TYPE = "SUBMARINE"' in refused.value.fix
