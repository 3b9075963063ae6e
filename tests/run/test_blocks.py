"""Blocks compiled separately: the autopilot repeats a run; world and autopilot together repeat it bit for bit."""

from itertools import takewhile

import jax
import numpy as np
import pytest
from loop.falling import Ball, HeightState, fall

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.flight.virtual_vehicle import instants
from trimtab.loop.integration import Integration
from trimtab.run.blocks import compile_autopilot, compile_world, loop_block
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


def face_to_face(scenario, seed):
    """Return the rows of the world's outputs, one per instant."""
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


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("hovercraft/forward", {}),
        ("hovercraft/zero-velocity", {"links": "measured"}),
        ("hovercraft/forward", {"navigation": "ins"}),
        ("hypersonic/noise", {}),
    ],
)
def test_coupled_world_and_autopilot_steps_match_the_simulation(name, choices):
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


@pytest.mark.parametrize("method", ["rk4", "rosenbrock"])
def test_world_step_locates_events_like_the_simulation(method):
    scenario = fall(Ball(), HeightState(), Integration(method=method))
    log = simulate(scenario, log_period=1, backend="c")
    writes, rows = face_to_face(scenario, 0)
    assert log["world.events"][-1] == 1
    for path in ("truth.z", "truth.w"):
        np.testing.assert_array_equal(rows[:, writes[path]].ravel(), log[path], err_msg=path)


def thrust(world):
    """Return the speed after 0.1 s of full thrust."""
    world.set_inputs({"command.valid": True, "command.value.rudder_pulse": 1.5e-3, "command.value.speed_rpm": 9000})
    for k in range(100):
        world.set_inputs({"t": max(k - 1, 0) * 10_000, "h": 10_000 * (k > 0), "first": k == 0, "fresh": True})
        world.set_inputs({"command.t": k * 10_000})
        world.step()
    return float(world.result("truth.surge_velocity"))


@pytest.mark.thorough
def test_compiled_step_reads_changed_parameters():
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {})
    scenario = replace(scenario, duration=seconds(0.1))
    heavy = replace(scenario, world=replace(scenario.world, vehicle=replace(scenario.world.vehicle, mass=5.0)))
    world, wanted = compile_world(scenario)[0], thrust(compile_world(heavy)[0])
    light = thrust(world)
    world.reset()
    world.parameters["world.vehicle.mass"][...] = 5.0
    assert thrust(world) == wanted < light
    world.reset()
    assert thrust(world) == light


@pytest.mark.thorough
def test_held_vehicle_does_not_move():
    scenario, _ = catalogue.load_scenario("hovercraft/forward", {})
    initial = replace(scenario.initial, surge_velocity=1.0)
    world, _, _ = compile_world(replace(scenario, duration=seconds(0.1), initial=initial))
    for k in range(100):
        world.set_inputs({"t": max(k - 1, 0) * 10_000, "h": 10_000 * (k > 0), "first": k == 0})
        world.step()
    assert float(world.result("truth.north")) == pytest.approx(0.099, rel=1e-6)
    world.set_inputs({"is_held": True, "t": 990_000, "h": 10_000})
    before = {p: world.result(p).copy() for p in world.writes if p.startswith("truth.")}
    world.step()
    assert {p: world.result(p) for p in before} == before
    world.set_inputs({"is_held": False, "t": 1_000_000})
    world.step()
    assert world.result("truth.north") > before["truth.north"]


@pytest.fixture(scope="module")
def flown():
    scenario, _ = catalogue.load_scenario("hovercraft/heading-bang-bang")
    scenario = replace(scenario, duration=seconds(2))
    log = simulate(scenario, log_period=scenario.autopilot.period, backend="jax")
    return compile_autopilot(scenario), log


def replay(step, log, k):
    for path, where in step.reads.items():
        source = log.ticks if path == "t" else log["downlink" + path.removeprefix("samples")]
        step.inputs[where] = source[k]
    step.step()


@pytest.mark.thorough
def test_compiled_autopilot_repeats_the_logged_run(flown):
    step, log = flown
    step.reset()
    for k in range(len(log)):
        replay(step, log, k)
        for path in step.writes:
            size = max(1e-3, np.abs(log[path]).max())
            assert abs(step.result(path) - log[path][k]) <= 1e-10 * size, (k, path)


def test_reset_restores_the_initial_state(flown):
    step, log = flown
    step.reset()
    replay(step, log, 0)
    first = step.outputs.copy()
    for k in range(1, 300):
        replay(step, log, k)
    step.reset()
    replay(step, log, 0)
    np.testing.assert_array_equal(step.outputs, first)


def test_rejects_unknown_input_and_output_paths(flown):
    step, _ = flown
    with pytest.raises(InputError, match="no input"):
        step.set_inputs({"samples.navigation.value.heading_rate": 0.0})
    with pytest.raises(InputError, match="no output"):
        step.result("command.value.speed")


def test_compiled_steps_do_not_share_state(flown):
    step, log = flown
    scenario, _ = catalogue.load_scenario("hovercraft/heading-bang-bang")
    other = compile_autopilot(replace(scenario, duration=seconds(2)))
    step.reset()
    replay(step, log, 0)
    before = step.outputs.copy()
    for k in range(200):
        replay(other, log, k)
    np.testing.assert_array_equal(step.outputs, before)


def test_loop_block_leaves_out_the_diagnostics_of_the_integration():
    block = loop_block(fall(Ball(), HeightState()), frozenset())
    output = jax.eval_shape(block.step, block.parameters, block.init(block.parameters), block.input)[1]
    assert output.truth.z.shape == ()
    assert jax.tree.leaves(output.world) == []
