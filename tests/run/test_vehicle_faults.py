"""Faults of a vehicle on a real link: uplink faults act before the failsafe and stop the vehicle."""

import numpy as np
import pytest

from trimtab.compiler.compiled_block import compile_block
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.flight.duties import Duties
from trimtab.flight.exchange import GroupSample
from trimtab.flight.injector import fault_parameter_names, plan_fault
from trimtab.flight.mavlink.protocol import ArmRequest
from trimtab.flight.station.parameters import Parameters
from trimtab.links.wire import Wire
from trimtab.loop.fault_text import inject_faults
from trimtab.loop.faults import KINDS, FaultyChannel
from trimtab.run.blocks import choose_failsafe, compile_world, replace_links, uplink_block
from trimtab.scenarios import catalogue


@pytest.fixture(scope="module")
def scenario():
    built, _ = catalogue.load_scenario("hovercraft/forward")
    return built


@pytest.fixture(scope="module")
def parts(scenario):
    bare = replace(scenario, world=replace(scenario.world, uplink=Wire(), downlink=Wire()))
    world, _, command = compile_world(bare)
    return bare, world, command


@pytest.fixture(scope="module")
def step(parts):
    return compile_block(uplink_block(FaultyChannel(inner=Wire(), capacity=600), parts[2]))


def driven(parts, step, word, severity=1.0):
    """Return speeds (rpm) at the actuators each millisecond, and the modes, for a command each 20 ms."""
    bare, world, command = parts
    if step is not None:
        step.reset()
        fault = {"kind": KINDS.index(word), "start": ms(500), "duration": ms(500), "severity": severity}
        for name, value in fault.items():
            step.parameters[f"uplink.fault.{name}"][...] = value
    duties = Duties(choose_failsafe(bare, command), command, world, step)
    where = [duties.commands.slot(f"command.{n}") for n in ("t", "valid", "value.rudder_pulse", "value.speed_rpm")]
    duties.handle_event(ArmRequest(True), 0)
    speeds, modes = [], []
    for k in range(1500):
        t = ms(k)
        taken = GroupSample(t, where, (t, True, 1.5e-3, 5000.0 + k), 0) if k % 20 == 0 else None
        duties.act(t, taken)
        valid = world.inputs[world.reads["command.valid"]]
        speeds.append(world.inputs[world.reads["command.value.speed_rpm"]] if valid else 0.0)
        modes.append(duties.mode.mode)
    return np.array(speeds), modes


@pytest.mark.thorough
def test_commands_pass_unchanged_without_a_fault(parts, step):
    speeds, modes = driven(parts, step, "none")
    assert set(modes) == {"computer"}
    assert np.array_equal(speeds, 5000.0 + np.arange(1500) // 20 * 20)
    assert np.array_equal(speeds, driven(parts, None, "none")[0])


@pytest.mark.parametrize("word", ["off", "stuck", "garbage"])
def test_uplink_without_new_commands_triggers_failsafe(parts, step, word):
    """The last good command arrives at 480 ms; 250 ms later the fan stops for good."""
    speeds, modes = driven(parts, step, word)
    assert modes.index("failsafe") == 730
    assert (speeds[:730] > 0).all()
    assert (speeds[730:] == 0).all()
    assert modes[-1] == "failsafe"


def test_only_a_long_uplink_delay_triggers_failsafe(parts, step):
    assert set(driven(parts, step, "delayed", 0.2)[1]) == {"computer"}
    assert driven(parts, step, "delayed", 0.3)[1][-1] == "failsafe"


def test_wrong_uplink_commands_are_accepted_only_within_limits(parts, step):
    speeds, modes = driven(parts, step, "wrong", 0.1)
    assert set(modes) == {"computer"}
    assert speeds[700] == pytest.approx(1.1 * 5700)
    speeds, modes = driven(parts, step, "wrong", 5.0)
    assert modes[-1] == "failsafe"
    assert speeds.max() < 6600


def test_command_line_faults_are_kept_on_a_real_link(scenario):
    """Regression: the faults were lost with the simulated channels that they wrapped."""
    both = replace_links(inject_faults(scenario, ["uplink delayed by 0.3 @ 1 s", "downlink off @ 2 s"]))
    for channel, word in ((both.world.uplink, "delayed"), (both.world.downlink, "off")):
        assert KINDS[int(channel.fault.kind)] == word
        assert isinstance(channel.inner, Wire)
        channel.check()
    assert isinstance(replace_links(scenario).world.uplink, Wire)


def test_fault_plan_names_existing_vehicle_parameters(scenario):
    from trimtab.flight.injector import add_idle_faults

    table = Parameters(add_idle_faults(scenario).world, "world").table()
    plan = plan_fault(scenario, "sensor:navigation wrong by 0.25 for 2 s", fault_parameter_names(scenario))
    assert [table[name][0].removeprefix("world.sensors.navigation.fault.") for name in plan.values] == [
        "start",
        "duration",
        "severity",
        "bias",
        "kind",
    ]
    assert list(plan.values.values()) == [0.0, 2e7, 0.25, 0.0, KINDS.index("wrong")]
