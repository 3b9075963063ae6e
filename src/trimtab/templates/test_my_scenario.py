"""Tests of the scenario's settings, and of a flight: pytest test_my_scenario.py"""

import tomllib
from pathlib import Path

from trimtab import build, simulate

FILE = Path(__file__).with_name("my_scenario.toml")
FLOWN = build(str(FILE))


def test_uses_the_values_of_the_file():
    """The scenario contains the values of the file, in SI units."""
    written = tomllib.loads(FILE.read_text(encoding="utf-8"))
    assert FLOWN.name == written["name"]
    assert f"{FLOWN.world.vehicle.mass:g} kg" == written["world"]["vehicle"]["mass"]
    assert FLOWN.world.uplink.loss == written["world"]["uplink"]["loss"]


def test_reaches_its_target():
    """A flight, compiled to C, reaches its target although the radio sends no data for half a second."""
    log = simulate(FLOWN)
    (target,) = FLOWN.targets
    assert abs(log.final[target.path] - target.value) < target.band
    assert log["downlink.navigation.age"].max() > 0.5
