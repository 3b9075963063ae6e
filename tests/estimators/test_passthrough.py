"""The estimator that passes one sensor through."""

import pytest

from trimtab.core.rng import key
from trimtab.core.signals import Frame, PlanarState, hold_sample, new_sample
from trimtab.core.time import ms
from trimtab.estimators.passthrough import Passthrough


def test_passthrough_listens_only_to_its_sensor():
    assert Passthrough("truth").listens == ("truth",)


def test_estimate_equals_the_sample_and_its_age():
    sample = hold_sample(ms(20), new_sample(ms(6), PlanarState(1.0, -0.5, 0.2, 3.0)), fresh=True)
    other = new_sample(ms(46), PlanarState(0.0, 0.0, 0.0, 0.0))
    estimator = Passthrough()
    state = estimator.init(key(0))
    state, estimate = estimator.step(ms(46), state, Frame(t=ms(46), samples={"navigation": sample, "other": other}))
    assert state == ()
    assert estimate.state is sample.value
    assert estimate.age == pytest.approx(0.040)
    assert estimate.fresh
    assert estimate.valid
