"""Settings of the scenario, and a flight: pytest test_my_scenario.py"""

import tomllib
from pathlib import Path

from trimtab import build, simulate

FILE = Path(__file__).with_name("my_scenario.toml")
FLOWN = build(str(FILE))


def test_it_is_the_file():
    """The values in the file are those that fly, in SI units."""
    said = tomllib.loads(FILE.read_text(encoding="utf-8"))
    assert FLOWN.name == said["name"]
    assert f"{FLOWN.world.vehicle.mass:g} kg" == said["world"]["vehicle"]["mass"]
    assert FLOWN.world.uplink.loss == said["world"]["uplink"]["loss"]


def test_it_reaches_its_target():
    """A flight, compiled to C; the radio is silent for half a second meanwhile."""
    log = simulate(FLOWN)
    (target,) = FLOWN.targets
    assert abs(log.final[target.path] - target.value) < target.band
    assert log["downlink.navigation.age"].max() > 0.5
