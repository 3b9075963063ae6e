import numpy as np
import pytest

from trimtab.core.signals import Estimate
from trimtab.core.time import seconds
from trimtab.laws.turntable import Turntable


def rate(law, s):
    estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=())
    return float(law.step(np.int64(seconds(s)), (), estimate)[1].demand.rate)


def test_rate_is_constant_after_its_ramp():
    law = Turntable(rate=-2.0, ramp=4.0)
    assert [rate(law, s) for s in (0, 1, 4, 9)] == pytest.approx([0, -0.5, -2, -2])
    assert rate(Turntable(rate=-2.0, ramp=0.0), 0) == -2


def test_rate_follows_square_wave_and_sine():
    square, sine = (Turntable(rate=3.0, cycle=2.0, waveform=w) for w in ("square", "sine"))
    assert [rate(square, s) for s in (0, 0.9, 1.0, 1.9, 2.0, 101)] == [3, 3, -3, -3, 3, -3]
    for s in (0, 0.3, 1.7, 12.4):
        assert rate(sine, s) == pytest.approx(3 * np.sin(np.pi * s), abs=1e-9)
