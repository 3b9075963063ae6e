"""The table of all settings of a scenario."""

import pytest

from trimtab.core.errors import InputError
from trimtab.scenarios.settings_table import SHOWN, settings


def test_settings_have_value_unit_and_meaning():
    table = settings("hovercraft/spin")
    assert table["world.vehicle.mass"][:3] == (2.6, "kg", "Total mass with batteries.")
    assert str(table["duration"]) == "22 s"
    assert str(table["autopilot.law.threshold"]) == "published"
    assert str(table["world.downlink.steps"]) == "6"
    assert str(table["world.actuators.thruster.reverse_ratio"]) == "[0.0009734, -0.03277, 0.3833, -1.099]"
    assert list(table["world.vehicle"]) == ["world.vehicle.mass", "world.vehicle.inertia", "world.vehicle.arm"]


def test_settings_are_shown_as_text_and_html_tables():
    table = settings("hovercraft/spin")
    lines = repr(table).splitlines()
    assert lines[0] == f"hovercraft/spin: {len(table)} settings"
    assert len(lines) == SHOWN + 2
    assert repr(table["world.vehicle"]).count("\n") == 3
    assert table._repr_html_().count("<tr>") == len(table) + 1


def test_unknown_path_suggests_similar_settings():
    with pytest.raises(InputError, match="unknown setting") as refused:
        settings("hovercraft/spin")["world.vehicle.mas"]
    assert "world.vehicle.mass" in refused.value.choices
