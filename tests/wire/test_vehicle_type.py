"""What vehicles say they are, against the numbers of pymavlink."""

import pytest

from trimtab.core.errors import InputError
from trimtab.scenarios import catalogue
from trimtab.wire.telemetry import mav_type

WANTED = {"hovercraft": "SURFACE_BOAT", "hypersonic": "FIXED_WING", "navigation/platform": "GENERIC"}


@pytest.mark.parametrize("name", catalogue.scenario_names())
def test_every_scenarios_vehicle_is_of_its_type(name):
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    wanted = next((kind for start, kind in WANTED.items() if name.startswith(start)), "SURFACE_BOAT")
    scenario, _ = catalogue.load_scenario(name)
    assert mav_type(scenario.world.vehicle) == getattr(common, f"MAV_TYPE_{wanted}")


def test_a_vehicle_that_declares_nothing_is_generic():
    assert mav_type(object()) == 0


def test_a_type_that_is_not_known_is_refused():
    class Boat:
        MAV_TYPE = "SURFACE-BOAT"

    with pytest.raises(InputError, match="Boat declares MAV_TYPE = 'SURFACE-BOAT'") as refused:
        mav_type(Boat())
    assert "SURFACE_BOAT" in refused.value.choices
