"""A parameter changed in flight: its event is exact, and both replays apply it at its step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.compiler.compiled_block import compile_block
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.logs.log import Log
from trimtab.run.blocks import autopilot_block
from trimtab.run.inputs import leaf_paths
from trimtab.run.parameter_changes import AutopilotChange, read_changes
from trimtab.run.replay import find_steps, step_c, step_jax
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

COMMAND = "command.value.speed_rpm"


def with_events(*texts):
    ticks = np.arange(2)
    events = [{"t": 0.0, "text": text} for text in texts]
    return Log(ticks * 1e-7, ticks, {"a.b": np.zeros(2)}, metadata={"events": events})


@given(st.integers(0, 2**50), st.integers(0, 500), st.floats(allow_nan=False, allow_infinity=False))
def test_change_event_round_trips_exactly(t, slot, value):
    change = AutopilotChange(t, "law.inner.k1", slot, value)
    assert read_changes(with_events(str(change))) == [change]


def test_unrelated_events_are_not_parameter_changes():
    texts = ["armed", "vehicle: parameter autopilot.law.k1[0] = 2.0 from 1.0000000 s", "parameter world.a[0] = 1.0"]
    assert read_changes(with_events(*texts)) == []
    assert read_changes(Log(np.zeros(1), np.zeros(1, int), {"a.b": np.zeros(1)})) == []


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_c_and_jax_replays_apply_a_change_at_its_step():
    scenario, _ = catalogue.load_scenario("hovercraft/forward")
    scenario = replace(scenario, duration=ms(2000))
    log, block = simulate(scenario, seed=1), autopilot_block(scenario, seed=1)
    steps = find_steps(log, leaf_paths(block.input), scenario.autopilot.period)
    at = len(steps.inputs) // 2
    changes = [AutopilotChange(int(steps.ticks[at]), "law.k1", 0, 1.5), AutopilotChange(0, "law.reference", 0, 2.5)]
    changed, plain = (step_c(compile_block(block), steps, c)[COMMAND] for c in (changes, changes[1:]))
    assert (changed[:at] == plain[:at]).all()
    assert changed[at] != plain[at]
    by_jax = step_jax(block, steps, changes)[COMMAND]
    np.testing.assert_allclose(by_jax, changed, rtol=1e-10)
    assert (step_c(compile_block(block), steps)[COMMAND] != plain).any()
