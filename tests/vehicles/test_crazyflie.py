"""The Crazyflie of another library as a vehicle and a law: the same flights as in its simulation; and the commands."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "crazyflie"
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(importlib.util.find_spec("crazyflow") is None, reason="pip install crazyflow==0.4.0"),
]
FLIGHTS = """
import json, sys
import numpy as np
from crazyflow.sim import Sim
from hover import scenario
from trimtab import simulate
from trimtab.core.record import replace
from trimtab.core.spatial_reference import FixedPlace
from trimtab.core.time import ms, seconds

place, heading = json.loads(sys.argv[1])
flown = scenario().ideal()
law = replace(flown.autopilot.law, reference=FixedPlace(tuple(place), heading))
flown = replace(flown, autopilot=replace(flown.autopilot, law=law), duration=seconds(2))
ours = simulate(flown, log_period=ms(2))["truth.position"]

how = dict(drone="cf2x_L250", dynamics="first_principles", control="state", integrator="rk4")
sim = Sim(n_worlds=1, n_drones=1, freq=500, state_freq=100, attitude_freq=500, **how)
command = np.zeros((1, 1, 16))
command[0, 0, :3] = np.array(place) * [1, -1, -1]
command[0, 0, 11:13] = -np.sin(heading / 2), np.cos(heading / 2)
sim.state_control(command)
theirs = [np.zeros(3)]
for _ in range(len(ours) - 1):
    sim.step()
    theirs.append(np.asarray(sim.data.states.pos)[0, 0] * [1, -1, -1])
print(json.dumps({"difference": float(np.abs(ours - theirs).max()), "height": float(-ours[-1, 2]), "steps": len(ours)}))
"""


def run(*words, cwd):
    """Run Python with these arguments, and return its standard output."""
    variables = os.environ | {"SCIPY_ARRAY_API": "1", "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(FOLDER)])}
    done = subprocess.run([sys.executable, *words], cwd=cwd, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("place", "heading", "most"), [((0.3, 0, -0.5), 0.0, 1e-12), ((0.3, -0.4, -0.5), 0.7, 5e-6)], ids=["plane", "turn"]
)
def test_flight_equals_that_of_crazyflow(tmp_path, place, heading, most):
    found = json.loads(run("-c", FLIGHTS, json.dumps([place, heading]), cwd=tmp_path).splitlines()[-1])
    assert found["steps"] == 1000
    assert found["height"] > 0.4
    assert found["difference"] <= most


def test_commands_accept_the_adapters(tmp_path):
    of = f"{FOLDER / 'hover.py'}:scenario"
    done = json.loads(run("-m", "trimtab.cli", "run", of, "--out", "here", "--json", cwd=tmp_path))
    assert done["real"]["metrics"]["law.distance"]["tail_rms"] < 0.05
    assert "identical bit for bit" in run(
        "-m", "trimtab.cli", "replay", "here/run.mcap", "--scenario", of, cwd=tmp_path
    )
    run("-m", "trimtab.cli", "export", of, "--out", "c", cwd=tmp_path)
    assert "same outputs" in run("-m", "trimtab.cli", "export", "--verify", "c", cwd=tmp_path)


def test_adapters_have_at_most_80_lines():
    for name in ("crazyflie.py", "mellinger.py"):
        assert len((FOLDER / name).read_text(encoding="utf-8").splitlines()) <= 80
