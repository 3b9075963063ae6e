"""The compiled step from Python gives what the simulation logged, sample by sample."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.native.compiler import find_compiler
from trimtab.run.fast_step import compile_autopilot
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


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


def test_it_repeats_the_run(flown):
    step, log = flown
    step.reset()
    for k in range(len(log)):
        replay(step, log, k)
        for path in step.writes:
            size = max(1e-3, np.abs(log[path]).max())
            assert abs(step.result(path) - log[path][k]) <= 1e-10 * size, (k, path)


def test_reset_begins_anew(flown):
    step, log = flown
    step.reset()
    replay(step, log, 0)
    first = step.outputs.copy()
    for k in range(1, 300):
        replay(step, log, k)
    step.reset()
    replay(step, log, 0)
    np.testing.assert_array_equal(step.outputs, first)


def test_wrong_paths_are_refused(flown):
    step, _ = flown
    with pytest.raises(InputError, match="no input"):
        step.set_inputs({"samples.navigation.value.heading_rate": 0.0})
    with pytest.raises(InputError, match="no output"):
        step.result("command.value.speed")


def test_two_do_not_share_a_state(flown):
    step, log = flown
    scenario, _ = catalogue.load_scenario("hovercraft/heading-bang-bang")
    other = compile_autopilot(replace(scenario, duration=seconds(2)))
    step.reset()
    replay(step, log, 0)
    before = step.outputs.copy()
    for k in range(200):
        replay(other, log, k)
    np.testing.assert_array_equal(step.outputs, before)
