"""The messages: what a sample says about its own age."""

import jax
import numpy as np
import pytest

from trimtab.core import signals
from trimtab.core.record import Quantity, declarations, leaves
from trimtab.core.signals import PlanarState, Sample, hold_sample, new_sample
from trimtab.core.time import ms

VALUE = PlanarState(1.0, 2.0, 3.0, 4.0)


def test_new_sample_is_fresh_valid_and_has_zero_age():
    s = new_sample(ms(12), VALUE)
    assert (s.t, s.age, s.fresh, s.valid) == (ms(12), 0.0, True, True)
    assert s.value is VALUE
    assert not new_sample(0, VALUE, fresh=False).fresh


def test_held_sample_ages_and_keeps_its_value():
    s = hold_sample(ms(48), new_sample(ms(12), VALUE))
    assert float(s.age) == pytest.approx(0.036, rel=1e-12)
    assert (s.t, s.fresh, s.valid) == (ms(12), False, True)
    assert s.value is VALUE
    assert hold_sample(ms(13), s, fresh=True).fresh


def test_holding_keeps_an_invalid_sample_invalid():
    nothing = Sample(value=VALUE, t=0, age=0.0, fresh=False, valid=False)
    assert not hold_sample(ms(5), nothing).valid


def test_hold_sample_works_under_jit():
    age = jax.jit(lambda now: hold_sample(now, new_sample(ms(12), VALUE)).age)(np.int64(ms(14)))
    assert float(age) == pytest.approx(0.002, rel=1e-12)


def test_planar_signals_have_si_units():
    units = {p: d.unit for p, _, d in leaves(VALUE) if isinstance(d, Quantity)}
    assert units == {"surge_velocity": "m/s", "sway_velocity": "m/s", "yaw_rate": "rad/s", "heading": "rad"}
    heading = declarations(signals.PlanarState)["heading"]
    assert isinstance(heading, Quantity)
    assert heading.kind == "angle"
