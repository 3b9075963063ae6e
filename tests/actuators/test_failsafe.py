"""Failsafe: each row of its page's table, times to the step, and the machine against a plain one written here.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.actuators.drive import DriveCommand, drive_failsafe
from trimtab.actuators.failsafe import CAUSES, MODES, Failsafe, FailsafeInput
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.core.signals import PlanarForce, Sample, new_sample
from trimtab.core.time import ms, seconds

SAFE = (1.5e-3, 0.0)
GOOD, STICKS = (1.7e-3, 6000.0), (1.4e-3, 2500.0)
failsafe = to_arrays(drive_failsafe())
step = jax.jit(Failsafe.step)


def at(now_ms, *requests, command=None, issued=None, valid=True, age=0.0, sticks=STICKS):
    """The input at an instant; requests out of arm, disarm, radio, takeover; command None: the last one is held."""
    value = DriveCommand(*map(np.float64, command or GOOD))
    sent = now_ms if issued is None else issued
    sample = Sample(value, np.int64(ms(sent)), np.float64(age), np.bool_(command is not None), np.bool_(valid))
    flags = {name: np.bool_(name in requests) for name in ("arm", "disarm", "radio", "takeover")}
    return FailsafeInput(command=sample, manual=DriveCommand(*map(np.float64, sticks)), **flags)


class Run:
    """The block with its state, asked at times in ms."""

    def __init__(self, block=failsafe):
        self.block, self.state, self.out = block, block.init(), None

    def __call__(self, now_ms, *requests, **what):
        given = at(now_ms, *requests, **what)
        self.state, self.out = step(self.block, np.int64(ms(now_ms)), self.state, given)
        return self

    @property
    def mode(self):
        return MODES[int(self.out.mode)]

    @property
    def cause(self):
        return CAUSES[int(self.out.cause)]

    @property
    def value(self):
        c = self.out.command
        return (float(c.value.rudder_pulse), float(c.value.speed_rpm)) if c.valid else None


def flying():
    """Armed at 0 ms, commanded at 0, 20, 40 ms."""
    run = Run()(0, "arm", command=GOOD)
    return run(20, command=GOOD)(40, command=GOOD)


def test_no_command_acts_before_arming():
    run = Run()
    for t in range(0, 100, 20):
        run(t, "radio", "takeover", command=GOOD)
        assert (run.mode, run.cause, run.value) == ("disarmed", "start", None)
        assert not run.out.lift
        assert not run.out.armed
        assert float(run.out.command.value.speed_rpm) == 0.0


def test_command_received_before_arming_is_ignored():
    run = Run()(0, command=GOOD)(10, "arm")
    assert (run.mode, run.cause, run.value, bool(run.out.lift)) == ("computer", "arm request", None, False)
    run(20, command=(1.6e-3, 3000.0))
    assert run.value == (1.6e-3, 3000.0)
    assert run.out.lift
    assert run.out.armed


def test_command_received_with_arming_acts_at_once():
    assert Run()(0, "arm", command=GOOD).value == GOOD


def test_command_loss_stops_thrust_then_lift_fan():
    """250 ms (reconstructed)."""
    run = flying()
    for t in range(41, 290):
        assert run(t).value == GOOD, t
    run(290)
    assert (run.mode, run.cause, run.value) == ("failsafe", "no command", None)
    assert (float(run.out.command.value.rudder_pulse), float(run.out.command.value.speed_rpm)) == SAFE
    for t in range(291, 1290, 9):
        assert run(t).out.lift, t
    assert run(1289).out.lift
    assert not run(1290).out.lift


def test_failsafe_stays_latched_until_rearmed():
    run = flying()(300)
    for t in range(320, 3000, 20):
        run(t, command=GOOD)
        assert (run.mode, run.value) == ("failsafe", None)
    assert (run(3000, "arm").mode, run.value) == ("computer", None), "the command has to be a new one"
    assert run(3020, command=GOOD).value == GOOD
    assert run.out.lift


def test_disarms_after_10_s_without_a_command():
    run = Run()(0, "arm")
    assert run(9999).mode == "computer"
    assert not run.out.lift
    assert (run(10000).mode, run.cause) == ("disarmed", "no command since arming")


@pytest.mark.parametrize("before", ["computer", "manual", "failsafe"])
def test_disarming_stops_thrust_and_lift_at_once(before):
    run = flying()
    if before == "manual":
        run(60, "radio", "takeover")
    if before == "failsafe":
        run(400)
    assert run.mode == before
    run(401, "disarm", "arm", "radio", "takeover", command=GOOD)
    assert (run.mode, run.cause, run.value, bool(run.out.lift)) == ("disarmed", "disarm request", None, False)


def test_pilot_takes_over_and_returns_control():
    run = flying()(60, "radio", "takeover", command=GOOD)
    assert (run.mode, run.cause, run.value) == ("manual", "takeover", STICKS)
    assert run.out.lift
    assert run.out.armed
    run(80, "radio", command=GOOD)
    assert (run.mode, run.cause, run.value) == ("computer", "takeover ended", GOOD)


def test_pilot_keeps_control_without_commands():
    run = flying()(300)(310, "radio", "takeover")
    assert (run.mode, run.value) == ("manual", STICKS)
    for t in range(320, 5000, 20):
        assert run(t, "radio", "takeover").value == STICKS
    run(5000, "radio", command=GOOD)
    assert (run.mode, run.cause, run.value) == ("failsafe", "takeover ended", None), "it had tripped: still latched"


def test_return_to_a_silent_computer_trips_the_failsafe():
    run = flying()(60, "radio", "takeover")(1000, "radio", "takeover")(1001, "radio")
    assert (run.mode, run.cause, run.value) == ("failsafe", "takeover ended", None)


@pytest.mark.parametrize("lost", [{"requests": ["takeover"]}, {"requests": [], "sticks": STICKS}])
def test_lost_transmitter_trips_the_failsafe(lost):
    run = flying()(60, "radio", "takeover", command=GOOD)(80, *lost["requests"], command=GOOD)
    assert (run.mode, run.cause, run.value) == ("failsafe", "pilot's radio lost", None)


def test_nan_sticks_count_as_lost_radio():
    run = flying()(60, "radio", "takeover", command=GOOD)
    assert run(80, "radio", "takeover", command=GOOD, sticks=(np.nan, 100.0)).cause == "pilot's radio lost"
    assert run.value is None
    assert run(100, "radio", "takeover", command=GOOD).mode == "manual", "as soon as they mean something again"


def test_arming_in_manual_clears_the_latch():
    run = flying()(300)(310, "radio", "takeover")(320, "radio", "takeover", "arm")
    assert run.mode == "manual"
    assert run(330, "radio", "takeover", command=GOOD)(340, "radio", command=GOOD).mode == "computer"


BAD = {
    "not finite": {"command": (np.nan, 6000.0)},
    "infinite": {"command": (1.6e-3, np.inf)},
    "pulse too long": {"command": (2.21e-3, 6000.0)},
    "pulse too short": {"command": (0.79e-3, 6000.0)},
    "too fast": {"command": (1.6e-3, 19201.0)},
    "too fast in reverse": {"command": (1.6e-3, -19201.0)},
    "too old": {"command": (1.6e-3, 3000.0), "age": 0.51},
    "from the future": {"command": (1.6e-3, 3000.0), "age": -0.51},
    "not finite age": {"command": (1.6e-3, 3000.0), "age": np.nan},
    "issued before the last": {"command": (1.6e-3, 3000.0), "issued": 39},
}


@pytest.mark.parametrize("what", BAD.values(), ids=BAD)
def test_bad_command_is_rejected_and_counts_as_missing(what):
    run = flying()
    for k, t in enumerate(range(60, 290, 10)):
        assert run(t, **what).value == GOOD
        assert int(run.out.rejected) == k + 1
    assert (run(290, **what).mode, run.value) == ("failsafe", None)


def test_invalid_command_stops_the_thrust_at_once():
    run = flying()(60, command=GOOD, valid=False)
    assert (run.mode, run.value) == ("computer", None)
    assert int(run.out.rejected) == 0
    assert run(80, command=GOOD).value == GOOD
    run(100, command=GOOD, valid=False)
    assert run(330, valid=False).mode == "failsafe"


def _plain(events, timeout=250, patience=10000):
    """The page's table in plain words, for good commands and sound sticks."""
    mode, latched, heard, armed, rows = "disarmed", False, None, None, []
    for t, arm, disarm, radio, takeover, comes in events:
        if disarm:
            mode, latched = "disarmed", False
        elif arm and (mode == "disarmed" or latched):
            mode = "manual" if mode == "manual" else "computer"
            latched, heard, armed = False, None, t
        if comes:
            heard = t
        quiet = heard is None or t - heard >= timeout
        if mode == "manual" and not (radio and takeover):
            mode = "computer" if radio and not takeover and not latched and not quiet else "failsafe"
        elif mode in ("computer", "failsafe") and radio and takeover:
            mode = "manual"
        elif mode == "computer" and heard is None and t - armed >= patience:
            mode = "disarmed"
        elif mode == "computer" and heard is not None and quiet:
            mode = "failsafe"
        latched = latched or mode == "failsafe"
        acts = {"manual": STICKS, "computer": GOOD if heard is not None else None}.get(mode)
        rows.append((mode, acts))
    return rows


FLAGS = st.tuples(*[st.booleans()] * 5)
EVENTS = st.lists(st.tuples(st.sampled_from([1, 20, 249, 250, 9000]), FLAGS), min_size=1, max_size=30)


@pytest.mark.thorough
@settings(max_examples=150, deadline=None)
@given(EVENTS)
def test_failsafe_matches_reference_state_machine(events):
    t, told, run, rows = 0, [], Run(), []
    for wait, flags in events:
        t += wait
        told.append((t, *flags))
        names = [n for n, f in zip(("arm", "disarm", "radio", "takeover"), flags, strict=False) if f]
        run(t, *names, command=GOOD if flags[4] else None)
        rows.append((run.mode, run.value))
    assert rows == _plain(told)


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_failsafe_in_c_matches_jax():
    given = at(0, "arm", command=GOOD)
    compiled = compile(lambda b, t, s, i: b.step(t, s, i), failsafe, np.int64(0), failsafe.init(), given)
    rng = np.random.default_rng(3)
    a = b = failsafe.init()
    t = 0
    for _ in range(400):
        t += int(rng.integers(1, 120))
        names = [n for n, p in (("arm", 0.1), ("disarm", 0.02), ("radio", 0.8), ("takeover", 0.2)) if rng.random() < p]
        command = [None, GOOD, (np.nan, 1.0)][rng.integers(3)]
        given = at(t, *names, command=command)
        a, x = step(failsafe, np.int64(ms(t)), a, given)
        b, y = compiled(failsafe, np.int64(ms(t)), b, given)
        for p, q in zip(jax.tree.leaves((a, x)), jax.tree.leaves((b, y)), strict=True):
            np.testing.assert_array_equal(p, q)


def test_failsafe_accepts_another_command_type():
    block = Failsafe(
        safe=PlanarForce(0.0, 0.0), low=PlanarForce(-2.0, -2.0), high=PlanarForce(2.0, 2.0), timeout=seconds(1)
    )
    block.check()
    state = block.init()
    arm = FailsafeInput(new_sample(0, PlanarForce(1.0, 0.5)), PlanarForce(0.0, 0.0), arm=True)
    state, out = block.step(0, state, arm)
    assert (float(out.command.value.FX), float(out.command.value.FY)) == (1.0, 0.5)


def test_rejects_inconsistent_limits():
    with pytest.raises(InputError, match=r"safe\.speed_rpm.*must lie"):
        replace(drive_failsafe(), low=DriveCommand(0.8e-3, 100.0)).check()
    with pytest.raises(InputError, match="has the fields"):
        replace(drive_failsafe(), high=PlanarForce(1.0, 1.0)).check()
    drive_failsafe().check()
