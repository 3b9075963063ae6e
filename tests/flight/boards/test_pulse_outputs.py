"""Outputs of a board: source of their limits, safe values, and error messages."""

import numpy as np
import pytest

from trimtab.actuators.failsafe import Failsafe
from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record, replace
from trimtab.core.signals import PlanarForce
from trimtab.core.time import ms
from trimtab.flight.boards.firmware_folder import FIRMWARE_BOARDS, firmware_outputs
from trimtab.flight.boards.pulse_outputs import frame_of
from trimtab.run.blocks import carried_structures
from trimtab.run.command_pulses import find_outputs
from trimtab.scenarios.build import build

BOAT = "examples/my_boat.py:scenario"


def outputs_of(scenario, most=8):
    return find_outputs(scenario, carried_structures(scenario)[1], most)


def test_actuator_bank_limits_map_to_1_and_2_ms():
    thrust, rudder = outputs_of(build(BOAT))
    assert (thrust.name, rudder.name) == ("thrust", "rudder")
    assert thrust.safe == pytest.approx(1e-3 + 1e-3 * 3 / 9)  # 0 N between -3 and 6 N
    assert rudder.safe == pytest.approx(1.5e-3)


@pytest.mark.thorough
def test_rotor_pulses_span_zero_to_maximum_speed():
    outputs = outputs_of(build("quadrotor/track"))
    assert [o.name for o in outputs] == [f"speed[{k}]" for k in range(4)]
    for o in outputs:
        np.testing.assert_array_equal(o.pulse.values, [0.0, 615.0])
        assert o.safe == 1e-3


def test_servo_limits_come_from_the_vehicle():
    scenario = build("torpedo/depth", {"world.vehicle.fin_limit": "0.3"})
    rudder, stern, shaft = outputs_of(scenario)
    assert rudder.pulse.values[1] == stern.pulse.values[1] == 0.3
    assert shaft.safe == 1.5e-3  # stands still, whatever its actuators did without a command


def test_failsafe_defines_pulse_limits_and_safe_values():
    scenario = build("torpedo/depth")
    kind = type(scenario.world.actuators.neutral().u)
    failsafe = Failsafe(safe=kind(0.1, 0.0, 50.0), low=kind(-0.2, -0.2, 0.0), high=kind(0.2, 0.2, 100.0))
    rudder, _, shaft = outputs_of(replace(scenario, failsafe=failsafe))
    assert rudder.safe == pytest.approx(1.75e-3)
    np.testing.assert_array_equal(shaft.pulse.values, [0.0, 100.0])
    assert shaft.safe == pytest.approx(1.5e-3)


@record
class Declared:
    """A command with ranges of its own. Source: this test."""

    FX: object = quantity("N", "Push.", low=-1.0, high=3.0)


def test_declared_command_range_is_used_and_missing_one_rejected():
    scenario = build("tests/loop/lander.py:hover")
    with pytest.raises(InputError, match=r"declares no limits for 'F' \(N\).*\n.*ServoPulse"):
        firmware_outputs(scenario)
    command = replace(carried_structures(scenario)[1], value=Declared(FX=np.float64(0.0)))
    (push,) = find_outputs(replace(scenario, failsafe=()), command)
    np.testing.assert_array_equal(push.pulse.values, [-1.0, 3.0])
    with pytest.raises(InputError, match="'FX'"):
        find_outputs(scenario, replace(command, value=PlanarForce(np.float64(0.0), np.float64(0.0))))


@pytest.mark.thorough
def test_rejects_more_command_values_than_board_outputs():
    scenario = build("quadrotor/track")
    with pytest.raises(InputError, match=r"(?s)4 numbers \(speed\[0\], .*3 outputs.*board=\"cortex-m7\""):
        outputs_of(scenario, most=3)
    for board in FIRMWARE_BOARDS:
        assert len(firmware_outputs(scenario, board)) == 4


@pytest.mark.thorough("cart-pole/swing-up-10", "vessel/path-20", "hovercraft/spin-20")
@pytest.mark.parametrize(
    ("name", "frame"),
    [("quadrotor/track", 5), ("cart-pole/swing-up", 10), ("vessel/path", 20), ("hovercraft/spin", 20)],
)
def test_pulse_frame_follows_actuator_period_within_servo_limits(name, frame):
    assert frame_of(build(name)) == ms(frame)


def test_pulse_frame_is_at_least_3_ms():
    scenario = build("cart-pole/swing-up")
    fast = replace(scenario.world.actuators, period=ms(1))
    assert frame_of(replace(scenario, world=replace(scenario.world, actuators=fast))) == ms(3)
