"""Command authority of a vehicle: requests from the link, in front of the compiled failsafe.

Times and rules are those of the page Failsafe: 250 ms, 1 s, latched.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from trimtab.actuators.drive import DriveCommand, drive_failsafe
from trimtab.actuators.failsafe import Failsafe
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.signals import Command
from trimtab.flight.duties import COMPUTER_MODE, Duties
from trimtab.flight.exchange import GroupSample
from trimtab.flight.manual_control import MANUAL_MODE
from trimtab.flight.mavlink.protocol import ArmRequest, JoystickAxes, ModeRequest, ReceiverChannels, State
from trimtab.flight.station.standard_services import Status
from trimtab.run.blocks import UNLIMITED

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
MS = 10_000
COMMAND = Command(t=np.int64(0), valid=False, value=DriveCommand(rudder_pulse=1.5e-3, speed_rpm=0.0))
READS = {"command.t": 0, "command.valid": 1, "command.value.rudder_pulse": 2, "command.value.speed_rpm": 3}
NAN = float("nan")


class Craft:
    """A vehicle's duties, asked every 10 ms."""

    def __init__(self):
        self.world = SimpleNamespace(reads=READS, inputs=np.full(4, -1.0))
        self.duties, self.t, self.modes = Duties(drive_failsafe(), COMMAND, self.world), 0, []

    def run(self, ms, *, command=None, asks=(), every=lambda: ()):
        """Advance by a number of milliseconds. command: (pulse, rpm), sent at each step."""
        for event in asks:
            self.duties.handle_event(event, self.t)
        for _ in range(0, ms, 10):
            self.t += 10 * MS
            for event in every():
                self.duties.handle_event(event, self.t)
            if self.duties.act(self.t, None if command is None else self.taken(*command)):
                self.modes.append((self.t // MS, *self.duties.mode))

    def taken(self, pulse, rpm, t=None):
        slots = [
            self.duties.commands.slot(f"command.{n}") for n in ("t", "valid", "value.rudder_pulse", "value.speed_rpm")
        ]
        return GroupSample(self.t if t is None else t, slots, (0, 1, pulse, rpm), 0)

    @property
    def acting(self):
        """valid, pulse, rpm as received by the world's actuators."""
        return tuple(self.world.inputs[1:].tolist())

    @property
    def lift(self):
        return bool(self.duties.step.result("lift"))


@pytest.fixture
def craft():
    return Craft()


def arm(wanted=True):
    return ArmRequest(wanted)


def receiver(*pulses_us):
    return ReceiverChannels(tuple(p * 1e-6 for p in pulses_us))


STOPPED = (0.0, 1.5e-3, 0.0)


def test_actuators_stay_safe_until_armed(craft):
    craft.run(100, command=(1.7e-3, 5000.0))
    assert (craft.acting, craft.lift, craft.duties.is_commanded) == (STOPPED, False, False)
    assert craft.duties.status.state == State.STANDBY
    craft.run(10, asks=[arm()])
    craft.run(20, command=(1.7e-3, 5000.0))
    assert (craft.acting, craft.lift, craft.duties.is_commanded) == ((1.0, 1.7e-3, 5000.0), True, True)
    assert craft.duties.status == Status(COMPUTER_MODE, True, State.ACTIVE)
    craft.run(10, asks=[arm(False)], command=(1.7e-3, 5000.0))
    assert craft.acting == STOPPED
    assert [m[1:] for m in craft.modes] == [("computer", "arm request"), ("disarmed", "disarm request")]


def test_command_loss_stops_thrust_then_lift_until_rearmed(craft):
    craft.run(10, asks=[arm()])
    craft.run(100, command=(1.6e-3, 4000.0))
    last = craft.t // MS
    craft.run(240)
    assert craft.acting == (1.0, 1.6e-3, 4000.0)
    craft.run(10)
    assert (craft.acting, craft.lift) == (STOPPED, True)
    assert craft.modes[-1] == (last + 250, "failsafe", "no command")
    assert craft.duties.status.state == State.CRITICAL
    craft.run(990)
    assert craft.lift
    craft.run(20)
    assert not craft.lift
    craft.run(200, command=(1.6e-3, 4000.0))
    assert craft.acting == STOPPED
    craft.run(10, asks=[arm()])
    craft.run(20, command=(1.6e-3, 4000.0))
    assert (craft.acting, craft.lift) == ((1.0, 1.6e-3, 4000.0), True)


@pytest.mark.parametrize("wrong", [(1.6e-3, NAN), (1.6e-3, 1e6), (5e-3, 0.0)])
def test_implausible_commands_count_as_no_command(craft, wrong):
    craft.run(10, asks=[arm()])
    craft.run(50, command=(1.6e-3, 4000.0))
    craft.run(300, command=wrong)
    assert craft.duties.mode == ("failsafe", "no command")
    assert craft.duties.step.result("rejected") == 30


def test_commands_with_wrong_time_count_as_no_command(craft):
    """Replayed commands, or commands of an autopilot that uses another clock."""
    craft.run(10, asks=[arm()])
    craft.run(2000, command=(1.6e-3, 4000.0))
    for wrong in (-1500 * MS, 3000 * MS):
        for _ in range(30):
            craft.t += 10 * MS
            craft.duties.act(craft.t, craft.taken(1.6e-3, 4000.0, craft.t + wrong))
    assert craft.duties.mode == ("failsafe", "no command")


def test_receiver_switch_takes_over_and_returns_control(craft):
    """With channel 5 above 1.5 ms the sticks command, each channel scaled from the failsafe's low to its high."""
    craft.run(10, asks=[arm()])
    craft.run(50, command=(1.6e-3, 4000.0))
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [receiver(1500, 1750, 1500, 1500, 1900)])
    valid, pulse, rpm = craft.acting
    assert (valid, craft.duties.mode) == (1.0, ("manual", "takeover"))
    low, high = drive_failsafe().low, drive_failsafe().high
    assert pulse == pytest.approx((low.rudder_pulse + high.rudder_pulse) / 2)
    assert rpm == pytest.approx(low.speed_rpm + 0.75 * (high.speed_rpm - low.speed_rpm))
    assert craft.duties.status.mode == MANUAL_MODE
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [receiver(1500, 1750, 1500, 1500, 1100)])
    assert (craft.acting, craft.duties.mode.mode) == ((1.0, 1.6e-3, 4000.0), "computer")


def test_receiver_loss_triggers_failsafe_in_manual_mode(craft):
    craft.run(10, asks=[arm()])
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [receiver(1500, 1750, 1500, 1500, 1900)])
    craft.run(490)
    assert craft.duties.mode.mode == "manual"
    craft.run(30)
    assert (craft.acting, craft.duties.mode) == (STOPPED, ("failsafe", "pilot's radio lost"))


def test_released_receiver_is_not_a_lost_radio(craft):
    """After a release the autopilot flies on, and the vehicle may be armed again later."""
    craft.run(10, asks=[arm()])
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [receiver(1500, 1750, 1500, 1500, 1900)])
    assert craft.duties.mode.mode == "manual"
    craft.run(1000, command=(1.6e-3, 4000.0), asks=[ReceiverChannels((NAN,) * 18, is_release=True)])
    assert (craft.acting, craft.duties.mode.mode) == ((1.0, 1.6e-3, 4000.0), "computer")
    assert craft.duties.pilot.radio_silence(craft.t) is None


def test_receiver_stays_active_after_another_stations_release(craft):
    """Another station releases its sticks in the same step."""
    craft.run(10, asks=[arm()])
    released = ReceiverChannels((NAN,) * 18, is_release=True)
    pilot = receiver(1500, 1750, 1500, 1500, 1900)
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [released, pilot])
    assert craft.duties.mode.mode == "manual"
    assert craft.duties.pilot.radio_silence(craft.t) is not None


def test_receiver_without_stick_channels_does_not_take_over(craft):
    """A receiver with only the switch, or without valid stick channels, commands no output."""
    craft.run(10, asks=[arm()])
    for pulses in ((NAN, NAN, NAN, NAN, 1900), (1500,), (1500, NAN, 1500, 1500, 1900)):
        craft.run(30, command=(1.6e-3, 4000.0), every=lambda p=pulses: [receiver(*p)])
        assert craft.duties.mode.mode == "computer"


def test_a_ground_station_takes_over_by_mode_and_joystick(craft):
    craft.run(10, asks=[arm()])
    craft.run(50, command=(1.6e-3, 4000.0), asks=[ModeRequest(MANUAL_MODE)])
    assert craft.duties.mode.mode == "computer"  # nobody holds a stick
    held = JoystickAxes(surge=0.5, sway=0.0, heave=0.0, yaw=-1.0)
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [held])
    assert craft.duties.mode.mode == "manual"
    assert craft.acting == pytest.approx((1.0, drive_failsafe().low.rudder_pulse, 9600.0))
    craft.run(50, command=(1.6e-3, 4000.0), asks=[ModeRequest(COMPUTER_MODE)], every=lambda: [held])
    assert craft.duties.mode.mode == "computer"


def test_last_of_two_requests_in_one_step_wins(craft):
    craft.run(10, asks=[arm(), arm(False)])
    assert not craft.duties.is_commanded
    craft.run(10, asks=[arm(False), arm()])
    assert craft.duties.is_commanded


def test_joystick_is_ignored_without_command_limits():
    """Without limits, a small stick deflection would command values of 1e299."""
    wide = Failsafe(
        safe=DriveCommand(rudder_pulse=0.0, speed_rpm=0.0),
        low=DriveCommand(rudder_pulse=-UNLIMITED, speed_rpm=-UNLIMITED),
        high=DriveCommand(rudder_pulse=UNLIMITED, speed_rpm=UNLIMITED),
    )
    duties = Duties(wide, COMMAND, SimpleNamespace(reads=READS, inputs=np.full(4, -1.0)))
    held = JoystickAxes(surge=0.6, sway=0.0, heave=0.0, yaw=0.0)
    for event in (arm(), ModeRequest(MANUAL_MODE), held):
        duties.handle_event(event, 0)
    duties.act(0, None)
    assert duties.mode.mode == "computer"


def test_limit_breach_latches_failsafe_with_its_cause(craft):
    for kind in ("fence", "envelope"):
        craft.run(10, asks=[arm()])
        craft.run(50, command=(1.6e-3, 4000.0))
        craft.duties.breach = kind
        craft.run(10, command=(1.6e-3, 4000.0))
        assert (craft.acting, craft.duties.mode) == (STOPPED, ("failsafe", kind))
        craft.duties.breach = "none"
        craft.run(100, command=(1.6e-3, 4000.0))
        assert craft.duties.mode == ("failsafe", kind)


def test_safety_pilot_overrides_a_fence_breach(craft):
    craft.run(10, asks=[arm()])
    craft.duties.breach = "fence"
    craft.run(50, command=(1.6e-3, 4000.0), every=lambda: [receiver(1500, 1750, 1500, 1500, 1900)])
    assert craft.duties.mode == ("manual", "takeover")
