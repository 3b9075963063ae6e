"""The autopilot alone: a frame in, a command out; invalid estimates, and errors at construction."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from loop.cart import SECOND, Doubling, RulerReading, Speed, cart_autopilot

from trimtab.core.errors import InputError
from trimtab.core.record import record, replace
from trimtab.core.rng import key
from trimtab.core.signals import Frame, Sample
from trimtab.estimators.passthrough import Passthrough
from trimtab.loop.structure import strengthen_types


def frame(now, x, t=None, *, fresh=True, valid=True):
    """Return the frame at `now` with x measured at t."""
    t = now if t is None else t
    value = RulerReading(x=np.float64(x), v=np.float64(0.0))
    sample = Sample(value, np.int64(t), np.float64((now - t) * 1e-7), np.bool_(fresh), np.bool_(valid))
    return Frame(t=np.int64(now), samples={"ruler": sample})


def fly(autopilot, *frames):
    """Return the autopilot's state after each frame."""
    state, states = strengthen_types(autopilot.init(key(0), frame(0, 0.0, valid=False))), []
    for one in frames:
        state, command = autopilot.step(one.t, state, one)
        assert command is state.command
        states.append(state)
    return states


def test_a_frame_gives_a_command_with_its_time():
    (state,) = fly(cart_autopilot(), frame(SECOND, 4.0))
    assert (int(state.command.t), bool(state.command.valid), float(state.command.value.v)) == (SECOND, True, 5.0)
    assert float(state.estimate.state.x) == 4.0
    assert float(state.output.demand.v) == 5.0


def test_missing_sample_holds_the_law_and_invalidates_the_command():
    first, second = fly(cart_autopilot(), frame(0, 0.0, valid=False), frame(SECOND, 1.0))
    assert (int(first.law), bool(first.command.valid)) == (0, False)
    assert (int(second.law), bool(second.command.valid)) == (1, True)


@pytest.mark.parametrize("x", [np.nan, np.inf, -np.inf])
def test_nonfinite_estimate_is_invalid_and_holds_the_law(x):
    before, bad, after = fly(cart_autopilot(), frame(0, 1.0), frame(SECOND, x), frame(2 * SECOND, 2.0))
    assert bool(before.command.valid)
    assert not bool(bad.estimate.valid)
    assert not bool(bad.command.valid)
    assert [int(s.law) for s in (before, bad, after)] == [1, 1, 2], "the law stands still"
    assert (bool(after.command.valid), float(after.command.value.v)) == (True, 3.0)


def test_nan_in_an_unread_field_leaves_the_command_valid():
    odd = frame(0, 1.0)
    odd.samples["ruler"].value.__dict__["v"] = np.float64(np.nan)
    (state,) = fly(cart_autopilot(), odd)
    assert bool(state.command.valid)


@record
class Dividing(Doubling):
    """Demands 1/x: infinite at 0. Source: this test."""

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        new, output = super().step(t, state, estimate)
        return new, type(output)(demand=Speed(1.0 / jnp.asarray(estimate.state.x)))


def test_nonfinite_demand_invalidates_the_command_and_holds_the_law():
    good, bad = fly(cart_autopilot(law=Dividing()), frame(0, 2.0), frame(SECOND, 0.0))
    assert (bool(good.command.valid), float(good.command.value.v), int(good.law)) == (True, 0.5, 1)
    assert bool(bad.estimate.valid)
    assert not bool(bad.command.valid)
    assert int(bad.law) == 1


def test_fresh_marks_samples_newer_than_the_last_step():
    """Freshness follows the measurement time: a sample received between two steps is fresh at the next step."""
    states = fly(
        cart_autopilot(period=2 * SECOND),
        frame(0, 1.0),
        frame(2 * SECOND, 1.0, t=0, fresh=False),
        frame(4 * SECOND, 2.0, t=3 * SECOND, fresh=False),
        frame(6 * SECOND, 2.0, t=3 * SECOND, fresh=False),
    )
    assert [bool(s.estimate.fresh) for s in states] == [True, False, True, False]
    assert [int(s.seen["ruler"]) for s in states] == [0, 0, 3 * SECOND, 3 * SECOND]
    np.testing.assert_allclose([float(s.estimate.age) for s in states], [0, 2, 1, 3])


def test_holds_outputs_between_control_periods_without_fresh_flag():
    autopilot = cart_autopilot(period=2 * SECOND)
    (state,) = fly(autopilot, frame(0, 1.0))
    held = autopilot.hold(np.int64(SECOND), state)
    assert (int(held.estimate.t), bool(held.estimate.fresh)) == (SECOND, False)
    assert held.command is state.command
    assert (held.law, held.output, held.seen) == (state.law, state.output, state.seen)
    assert bool(held.estimate.valid)


def test_recomputed_outputs_are_dropped_from_the_state():
    autopilot = cart_autopilot()
    (state,) = fly(autopilot, frame(0, 1.0))
    assert autopilot.drop_derived_outputs(state, frozenset({2 * SECOND})) is state
    dropped = autopilot.drop_derived_outputs(state, frozenset({SECOND}))
    assert (dropped.estimate, dropped.output, dropped.command) == ((), (), ())
    assert dropped.law is state.law


@record
class Reader(Doubling):
    """Reads a field that the ruler does not measure. Source: this test."""

    reads: ClassVar[tuple[str, ...]] = ("xs",)


@record
class Mute(Doubling):
    """Gives no demand. Source: this test."""

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        return state, Speed(1.0 + estimate.state.x)


@record
class OneName(Passthrough):
    """An estimator whose sensors are a text. Source: this test."""

    listens = "ruler"


@record
class Stubborn:
    """An allocation that reads a missing field of the demand. Source: this test."""

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, demand: Any) -> Any:
        return state, demand.torque


def test_mismatched_parts_raise_an_error_naming_both():
    first = frame(0, 0.0, valid=False)
    with pytest.raises(InputError, match=r"reads sensor 'ruler', but the world sends only \(tape\)"):
        cart_autopilot().init(key(0), Frame(first.t, {"tape": first.samples["ruler"]}))
    text = replace(cart_autopilot(), estimator=OneName())
    with pytest.raises(InputError, match=r"`listens` must be a tuple of sensor names, got a string") as refused:
        text.init(key(0), first)
    assert refused.value.fix == 'listens = ("ruler",)'
    with pytest.raises(
        InputError, match=r"reads 'xs', which the estimate of Passthrough does not(.|\n)*read 'x' instead"
    ):
        cart_autopilot(law=Reader()).init(key(0), first)
    with pytest.raises(InputError, match="the output of Mute has no field 'demand'"):
        cart_autopilot(law=Mute()).init(key(0), first)
    with pytest.raises(InputError, match=r"autopilot\.allocation: does not fit autopilot\.law.*torque"):
        cart_autopilot(allocation=Stubborn()).init(key(0), first)
