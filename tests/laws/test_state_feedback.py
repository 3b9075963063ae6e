"""State feedback with integrals: hand calculation, integral limit, and gains of wrong shape."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.signals import Estimate, PlanarForce, PlanarState
from trimtab.laws.state_feedback import StateFeedback

K = np.array([[-1.0, 0.0, 0.0, 0.5], [0.0, -2.0, 3.0, 0.0]])


def estimate(*state):
    return Estimate(t=0, age=0.0, fresh=True, valid=True, state=PlanarState(*state), dt=0.1)


def test_demand_and_limited_integral_match_hand_calculation():
    law = StateFeedback(
        K=K, x0=np.array([1.0, 0, 0, 0.2]), u0=PlanarForce(0.3, 0.0), integrated=(0,), L=np.array([[-4.0], [0.0]]),
        most=np.array([0.15]),
    )  # fmt: skip
    law.check()
    state, sums = law.init(None), []
    for _ in range(3):
        state, out = law.step(0, state, estimate(2.0, 0.5, 0.1, 0.4))
        sums.append(float(state.integrals[0]))
    assert sums == pytest.approx([0.1, 0.15, 0.15])  # held at its limit
    assert float(out.demand.FX) == pytest.approx(0.3 - 1.0 + 0.5 * 0.2 - 4 * 0.15)
    assert float(out.demand.FY) == pytest.approx(-2 * 0.5 + 3 * 0.1)
    np.testing.assert_allclose(out.error, [1.0, 0.5, 0.1, 0.2])


@pytest.mark.parametrize(
    "change",
    [
        {"K": np.zeros(4)},
        {"L": np.zeros((3, 0))},
        {"integrated": (0,)},
        {"integrated": (4,), "L": np.zeros((2, 1)), "most": np.ones(1)},
    ],
)
def test_rejects_gains_of_wrong_shape(change):
    with pytest.raises(InputError, match="StateFeedback"):
        StateFeedback(**{"K": K, **change}).check()
