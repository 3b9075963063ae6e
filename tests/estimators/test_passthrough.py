"""The estimator that believes one sensor."""

import pytest

from trimtab.core.rng import key
from trimtab.core.signals import Frame, PlanarState, Sample, held, measured
from trimtab.core.time import ms
from trimtab.estimators.passthrough import Passthrough

TRUE, OTHER = PlanarState(0.4, 0.1, 1.0, 0.2), PlanarState(9.0, 9.0, 9.0, 9.0)


def _estimate(now, sample, sensor="navigation"):
    frame = Frame(t=now, samples={"navigation": sample, "other": measured(now, OTHER)})
    one = Passthrough(sensor)
    return one.step(now, one.init(key(0)), frame)[1]


def test_the_newest_sample_is_the_estimate():
    estimate = _estimate(ms(12), measured(ms(12), TRUE))
    assert estimate.state is TRUE
    assert (estimate.t, estimate.age, estimate.fresh, estimate.valid) == (ms(12), 0.0, True, True)


def test_age_counts_from_the_measurement_and_not_from_the_arrival():
    estimate = _estimate(ms(48), held(ms(40), measured(ms(12), TRUE)))
    assert float(estimate.age) == pytest.approx(0.036, rel=1e-12)
    assert not estimate.fresh
    assert estimate.state is TRUE


def test_not_valid_before_anything_has_arrived():
    assert not _estimate(ms(5), Sample(value=TRUE, t=0, age=0.0, fresh=False, valid=False)).valid


def test_only_the_named_sensor_is_read():
    assert Passthrough("other").listens == ("other",)
    assert _estimate(ms(5), measured(ms(5), TRUE), "other").state is OTHER
