"""A written scenario equals the original bit for bit, also for a user's scenario file."""

import numpy as np
import pytest

from trimtab.analysis.campaign.sampling.distributions import parse_distribution
from trimtab.analysis.campaign.search.falsify import spread_levels
from trimtab.analysis.campaign.search.scenario_file import check_file, write_scenario
from trimtab.analysis.campaign.workers.prepare import CampaignPlan, parameters_at, prepare_campaign, scenario_at
from trimtab.core.errors import InputError
from trimtab.core.record import leaves
from trimtab.loop.calibration import Calibration, Entry, format_calibration
from trimtab.scenarios.build import build

OWN = """
from trimtab.scenarios.build import build


def boat():
    return build("hovercraft/zero-velocity", {"duration": "2 s"})
"""

VERSION_0_1 = '''
import numpy as np

from trimtab.core.record import with_leaf
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import build

SETTINGS = {'duration': '2 s'}
WITHOUT = ('navigation-error',)
FAULTS = ()
VALUES = {'world.vehicle.mass': (2.9, 'float64')}


def scenario() -> Scenario:
    """The scenario with these values."""
    made = build('hovercraft/zero-velocity', SETTINGS, WITHOUT, FAULTS)
    for path, (value, dtype) in VALUES.items():
        made = with_leaf(made, path, lambda old, declared, value=value, dtype=dtype: np.array(value, dtype)[()])
    return made
'''


def of(path, *names):
    return [next(v for p, v, _ in leaves(build(path)) if p == name) for name in names]


def test_values_settings_and_omissions_round_trip(tmp_path):
    plan = CampaignPlan("hovercraft/zero-velocity", (("duration", "2 s"),), ("navigation-error",))
    values = {"world.vehicle.mass": np.float64(0.1 + 0.2), "autopilot.law.k1": np.nextafter(1.0, 2.0)}
    write_scenario(tmp_path / "made" / "found.py", plan, values, 'says """this"""')
    name = f"{tmp_path / 'made' / 'found.py'}:scenario"
    assert of(name, *values) == list(values.values())
    wanted = build("hovercraft/zero-velocity", {"duration": "2 s"}, ["navigation-error"])
    rest = {p: v for p, v, _ in leaves(wanted) if p not in values}
    again = {p: v for p, v, _ in leaves(build(name)) if p not in values}
    assert {p: str(v) for p, v in again.items()} == {p: str(v) for p, v in rest.items()}


def test_user_scenario_loads_from_another_folder(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "boat.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    plan = CampaignPlan("mine/boat.py:boat")
    write_scenario(tmp_path / "out" / "found.py", plan, {"world.vehicle.mass": np.float64(3.0)}, "mine")
    monkeypatch.chdir(tmp_path / "out")
    assert of("found.py:scenario", "world.vehicle.mass", "duration") == [3.0, 20_000_000]


def test_recorded_link_loads_from_another_folder(tmp_path, monkeypatch):
    (tmp_path / "radio").mkdir()
    (tmp_path / "radio" / "up.csv").write_text("sent_s,latency_s\n0.0,0.041\n0.02,0.5\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    plan = CampaignPlan("hovercraft/zero-velocity", settings=(("duration", "2"), ("uplink", "radio/up.csv")))
    write_scenario(tmp_path / "out" / "found.py", plan, {"world.vehicle.mass": np.float64(3.0)}, "recorded")
    monkeypatch.chdir(tmp_path / "out")
    mass, latency = of("found.py:scenario", "world.vehicle.mass", "world.uplink.latency")
    assert (mass, np.asarray(latency).tolist()) == (3.0, [0.041, 0.5])


def test_parameters_at_a_point_match_the_distributions():
    texts = {"world.vehicle.mass": "uniform(80%, 120%)", "autopilot.law.k1": "normal(2, 0.1)"}
    spread = tuple((p, parse_distribution(t)) for p, t in sorted(texts.items()))
    ready = prepare_campaign(CampaignPlan("hovercraft/zero-velocity", spread=spread, runs=4))
    low, high = (parameters_at(ready, spread_levels(ready, np.full(2, end))) for end in (0.0, 1.0))
    assert [low["autopilot.law.k1"], high["autopilot.law.k1"]] == pytest.approx([1.7, 2.3])  # three deviations
    assert [low["world.vehicle.mass"], high["world.vehicle.mass"]] == pytest.approx([0.8 * 2.6, 1.2 * 2.6])
    made = {p: v for p, v, _ in leaves(scenario_at(ready, spread_levels(ready, np.full(2, 1.0))))}
    assert {p: made[p] for p in high} == high


@pytest.mark.parametrize("name", ["found.txt", "not a name.py"])
def test_rejects_invalid_scenario_file_name(name, tmp_path):
    with pytest.raises(InputError, match="Python file"):
        check_file("--out", tmp_path / name)


def test_file_of_version_0_1_loads(tmp_path):
    (tmp_path / "found.py").write_text(VERSION_0_1, encoding="utf-8")
    mass, duration = of(f"{tmp_path / 'found.py'}:scenario", "world.vehicle.mass", "duration")
    assert (mass, duration) == (2.9, 20_000_000)


def test_calibration_is_written_into_the_file(tmp_path):
    boat = Calibration({"Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002, source='a "bench"')})
    plan = CampaignPlan("hovercraft/zero-velocity", calibration=format_calibration(boat))
    write_scenario(tmp_path / "found.py", plan, {}, "calibrated")
    found = build(f"{tmp_path / 'found.py'}:scenario")
    assert found.world.vehicle.inertia == found.autopilot.law.model.inertia == 0.11
