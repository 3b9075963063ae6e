"""Default times of the supervisor, in a flight that loses its link or whose estimate becomes too old."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.actuators.drive import NEUTRAL_COMMAND
from trimtab.core.signals import Estimate
from trimtab.core.time import ms
from trimtab.loop.structure import strengthen_types
from trimtab.loop.supervisor import CAUSES, MODES, Supervisor, SupervisorInput

STEP_MS, STEPS = 10, 600


@jax.jit
def fly(is_stale):
    """Fly with the default times. After the first step, either no sample arrives or the estimate becomes older."""
    supervisor = Supervisor(neutral=NEUTRAL_COMMAND, automatic=True)

    def body(s, k):
        t, age = k * ms(STEP_MS), jnp.where(is_stale, 1e-3 * STEP_MS * k, 0.0)
        estimate = Estimate(t=t, age=age, fresh=np.bool_(True), valid=np.bool_(True), state=None)
        return supervisor.step(t, s, SupervisorInput(estimate, is_stale | (k == 0), np.bool_(True)))

    return jax.lax.scan(body, strengthen_types(supervisor.init()), jnp.arange(STEPS, dtype=np.int64))[1]


@pytest.mark.parametrize(("is_stale", "cause", "lost"), [(False, "link lost", 200), (True, "estimate stale", 410)])
def test_default_times_from_a_loss_to_the_end_of_the_flight(is_stale, cause, lost):
    """Lost after 200 ms without a sample, or when the estimate is older than 0.4 s. After that, the law commands for
    300 ms, and the neutral command is sent until the flight ends after 5 s."""
    out = jax.tree.map(np.asarray, fly(np.bool_(is_stale)))
    modes = [MODES[m] for m in out.mode]
    starts = {mode: STEP_MS * modes.index(mode) for mode in dict.fromkeys(modes)}
    assert starts == {"flying": 0, "lost": lost, "ended": lost + 5000}
    assert CAUSES[out.cause[lost // STEP_MS]] == cause
    assert CAUSES[out.cause[-1]] == "lost for too long"
    assert STEP_MS * int(out.law.sum()) == lost + 300
    assert STEP_MS * int(out.sends.sum()) == lost + 5000
