"""Speed controller: every transition, and the machine against a plain one written here.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.actuators.drive import MODES, SpeedController, SpeedControllerState
from trimtab.core.record import replace
from trimtab.core.time import ms

CONTROLLER = SpeedController()
step = jax.jit(CONTROLLER.step)


def _run(commands, controller_step=step):
    """Output, mode and brakes for [(t in ms, command)]."""
    state, rows = CONTROLLER.init(), []
    for t, command in commands:
        state, out = controller_step(np.int64(ms(t)), state, np.float64(command))
        rows.append((float(out), MODES[int(state.mode)], int(state.brakings)))
    return rows


def _plain(commands, brake=150):
    """The description in words as code: last direction, and a timer."""
    last, since, brakes, rows = "forward", None, 0, []
    for t, command in commands:
        if command < 0:
            last, since = "reverse", None
        elif command > 0 and last == "reverse" and since is None:
            since, brakes = t, brakes + 1
        if since is not None and t - since >= brake:
            last, since = "forward", None
        rows.append((0.0, "braking", brakes) if since is not None else (command, last, brakes))
    return rows


def test_controller_starts_in_forward_mode():
    assert _run([(0, 0)]) == [(0, "forward", 0)]
    assert _run([(0, 5000)]) == [(5000, "forward", 0)]


def test_forward_to_reverse_switches_at_once():
    assert _run([(0, 5000), (1, -3000)])[1] == (-3000, "reverse", 0)


def test_reverse_to_forward_brakes_for_150_ms():
    """[1] chapter 4: the residual brake of 150 ms falls on reverse to forward only."""
    rows = _run([(0, -3000), *((20 + k, 4000) for k in range(200))])
    assert rows[1:151] == [(0, "braking", 1)] * 150
    assert rows[151:] == [(4000, "forward", 1)] * 50


def test_negative_command_cancels_the_brake():
    rows = _run([(0, -3000), (20, 4000), (60, -1000), (61, 2000), (200, 2000), (210, 2000), (211, 2000)])
    assert rows[2] == (-1000, "reverse", 1)
    assert [r[1] for r in rows[3:]] == ["braking", "braking", "braking", "forward"], "a new brake has its full length"
    assert rows[-1] == (2000, "forward", 2)


def test_zero_command_keeps_the_mode():
    rows = _run([(0, -3000), (20, 0), (500, 0), (520, 100), (540, 0), (669, 0), (670, 0), (690, 100)])
    assert [r[:2] for r in rows] == [
        (-3000, "reverse"),
        (0, "reverse"),
        (0, "reverse"),
        (0, "braking"),
        (0, "braking"),
        (0, "braking"),
        (0, "forward"),
        (100, "forward"),
    ]


def test_second_forward_command_does_not_brake_again():
    rows = _run([(0, -1), (10, 1), (160, 1), (170, 0), (180, 5)])
    assert rows[-1] == (5, "forward", 1)


def test_zero_brake_duration_disables_the_brake():
    off = jax.jit(replace(CONTROLLER, brake=0).step)
    assert _run([(0, -3000), (1, 2000)], off) == [(-3000, "reverse", 0), (2000, "forward", 0)]


times = st.lists(st.integers(0, 400), min_size=1, max_size=30).map(np.cumsum)
speeds = st.sampled_from([-9000.0, -1.0, 0.0, 1.0, 9000.0])


@settings(deadline=None, max_examples=60)
@given(times, st.data())
def test_controller_matches_reference_state_machine(at, data):
    commands = [(int(t), data.draw(speeds)) for t in at]
    assert _run(commands) == _plain(commands)


def test_vectorised_step_keeps_the_types():
    state = SpeedControllerState(*(np.stack([v] * 3) for v in (np.int32(1), np.int64(0), np.int32(0))))
    new, out = jax.vmap(CONTROLLER.step, in_axes=(None, 0, 0))(np.int64(0), state, np.array([-1.0, 0.0, 1.0]))
    assert out.tolist() == [-1, 0, 0]
    assert new.mode.tolist() == [1, 1, 2]
    assert (new.mode.dtype, new.brake_until.dtype, new.brakings.dtype) == (np.int32, np.int64, np.int32)


@pytest.mark.parametrize("command", [-2000.0, 0.0, 2000.0])
def test_braking_ends_correctly_at_large_times(command):
    late = SpeedControllerState(np.int32(2), np.int64(10**15), np.int32(7))
    for t, over in ((10**15 - 1, False), (10**15, True)):
        _, out = step(np.int64(t), late, command)
        assert out == (command if over or command < 0 else 0)
