import numpy as np

from trimtab.core.interfaces import Channel
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.links.wire import Wire


def test_the_sample_comes_out_at_once_and_unchanged(drive, sent_at):
    t, out, _ = drive(Wire(), key(0), 50, sensor_period=ms(6))
    sent = sent_at(t, ms(6))
    np.testing.assert_array_equal(out.t, sent.t)
    np.testing.assert_array_equal(out.fresh, t % ms(6) == 0)
    np.testing.assert_allclose(out.age, sent.age, rtol=0, atol=1e-15)
    assert out.valid.all()
    for name in ("surge_velocity", "sway_velocity", "yaw_rate", "heading"):
        np.testing.assert_allclose(getattr(out.value, name), getattr(sent.value, name), rtol=0, atol=1e-15)


def test_nothing_is_valid_before_the_first_sample(drive):
    t, out, _ = drive(Wire(period=ms(2)), key(0), 20, first=ms(10))
    np.testing.assert_array_equal(out.valid, t >= ms(10))


def test_it_is_a_channel_without_memory_or_faults():
    assert isinstance(Wire(), Channel)
    assert Wire.IMPERFECTIONS == ()
