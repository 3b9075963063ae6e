"""The messages: what a sample says about its own age."""

import jax
import numpy as np
import pytest

from trimtab.core import signals
from trimtab.core.record import Quantity, declarations, leaves
from trimtab.core.signals import PlanarState, Sample, held, measured
from trimtab.core.time import ms

VALUE = PlanarState(1.0, 2.0, 3.0, 4.0)


def test_measured_now_is_fresh_valid_and_of_no_age():
    s = measured(ms(12), VALUE)
    assert (s.t, s.age, s.fresh, s.valid) == (ms(12), 0.0, True, True)
    assert s.value is VALUE
    assert not measured(0, VALUE, fresh=False).fresh


def test_held_ages_and_keeps_its_value():
    s = held(ms(48), measured(ms(12), VALUE))
    assert float(s.age) == pytest.approx(0.036, rel=1e-12)
    assert (s.t, s.fresh, s.valid) == (ms(12), False, True)
    assert s.value is VALUE
    assert held(ms(13), s, fresh=True).fresh


def test_held_does_not_make_an_invalid_sample_valid():
    nothing = Sample(value=VALUE, t=0, age=0.0, fresh=False, valid=False)
    assert not held(ms(5), nothing).valid


def test_held_works_while_traced():
    age = jax.jit(lambda now: held(now, measured(ms(12), VALUE)).age)(np.int64(ms(14)))
    assert float(age) == pytest.approx(0.002, rel=1e-12)


def test_planar_signals_have_si_units():
    units = {p: d.unit for p, _, d in leaves(VALUE) if isinstance(d, Quantity)}
    assert units == {"surge_velocity": "m/s", "sway_velocity": "m/s", "yaw_rate": "rad/s", "heading": "rad"}
    heading = declarations(signals.PlanarState)["heading"]
    assert isinstance(heading, Quantity)
    assert heading.kind == "angle"
