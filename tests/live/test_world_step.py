"""World and autopilot as two compiled steps, facing each other, fly what `simulate` flies: bit for bit."""

from itertools import takewhile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.core.record import replace
from trimtab.core.time import seconds, timetable
from trimtab.live.world_step import compile_world, instants
from trimtab.native.compiler import find_compiler
from trimtab.run.fast_step import compile_autopilot
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue


@settings(deadline=None)
@given(
    st.lists(st.integers(3, 300), min_size=1, max_size=4),
    st.integers(2, 100),
    st.integers(1, 2000),
)
def test_instants_are_those_of_the_timetable(periods, max_step, duration):
    wanted = timetable(periods, 3000, max_step).t
    found = np.array(list(takewhile(lambda t: t < 3000, instants(periods, max_step))))
    np.testing.assert_array_equal(found[found < duration], wanted[wanted < duration])


def face_to_face(scenario, seed):
    """The rows of the world's outputs, one an instant."""
    world, _, _ = compile_world(scenario, seed=seed)
    pilot = compile_autopilot(scenario, seed=seed)
    commands = [(world.reads[p], where) for p, where in pilot.writes.items() if p.startswith("command.")]
    frame = [(where, world.writes["downlink" + p[7:]]) for p, where in pilot.reads.items() if p != "t"]
    last, rows = 0, []
    for t in takewhile(lambda t: t < scenario.duration, instants(_periods(scenario), scenario.world.max_step)):
        world.set_inputs({"t": last, "h": t - last, "first": t == 0})
        world.step()
        rows.append(world.outputs.copy())
        due = t % scenario.autopilot.period == 0
        if due:
            pilot.set_inputs({"t": t})
            for to, from_ in frame:
                pilot.inputs[to] = world.outputs[from_]
            pilot.step()
            for to, from_ in commands:
                world.inputs[to] = pilot.outputs[from_]
        world.set_inputs({"fresh": due})
        last = t
    return world.writes, np.array(rows)


def _periods(scenario):
    return [*scenario.world.periods(), scenario.autopilot.period]


@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("hovercraft/forward", {}),
        ("hovercraft/zero-velocity", {"links": "measured"}),
        pytest.param("hovercraft/forward", {"navigation": "ins"}, marks=pytest.mark.slow),
        pytest.param("hypersonic/noise", {}, marks=pytest.mark.slow),
    ],
)
def test_two_steps_facing_each_other_are_the_simulation(name, choices):
    scenario, _ = catalogue.load_scenario(name, choices)
    scenario = replace(scenario, duration=seconds(2))
    log = simulate(scenario, seed=5, log_period=1, backend="c")
    writes, rows = face_to_face(scenario, 5)
    assert len(rows) == len(log)
    for path, where in writes.items():
        found = rows[:, where]
        if path.startswith(("uplink.", "actuators.")):  # told at the end of what they did
            found = found[1:]
        np.testing.assert_array_equal(found, np.asarray(log[path], float)[: len(found)], err_msg=path)


@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_parameters_are_read_in_place():
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {})
    scenario = replace(scenario, duration=seconds(0.1))
    world, _, _ = compile_world(scenario)

    def coast():
        world.reset()
        world.parameters["initial.surge_velocity"][...] = 1.0
        world.reset_state()
        for k in range(100):
            world.set_inputs({"t": max(k - 1, 0) * 10_000, "h": 10_000 * (k > 0), "first": k == 0})
            world.step()
        return float(world.result("truth.north"))

    assert coast() == pytest.approx(0.099, rel=1e-6)
    world.set_inputs({"held": True, "t": 990_000, "h": 10_000})
    before = {p: world.result(p).copy() for p in world.writes if p.startswith("truth.")}
    world.step()
    assert {p: world.result(p) for p in before} == before
    world.set_inputs({"held": False, "t": 1_000_000})
    world.step()
    assert world.result("truth.north") > before["truth.north"]
