import numpy as np

from trimtab.core.imperfections import imperfections
from trimtab.core.interfaces import Channel
from trimtab.core.rng import key
from trimtab.core.signals import hold_sample, new_sample
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


def test_output_is_invalid_before_the_first_sample(drive):
    t, out, _ = drive(Wire(period=ms(2)), key(0), 20, first=ms(10))
    np.testing.assert_array_equal(out.valid, t >= ms(10))


def test_sample_between_two_updates_is_fresh_once():
    tick, end = ms(6.5536), ms(200)
    wire, made, fresh = Wire(), -1, []
    state = wire.init(key(0), new_sample(np.int64(0), 0.0))
    for t in sorted({*range(0, end, ms(1)), *range(0, end, tick)}):
        made = t if t % tick == 0 else made
        if t % ms(1) == 0:
            sample = hold_sample(np.int64(t), new_sample(np.int64(made), 0.0), fresh=np.bool_(t == made))
            state, out = wire.step(np.int64(t), state, sample)
            fresh += [int(out.t)] if out.fresh else []
    assert fresh == list(range(0, end, tick))


def test_wire_is_a_channel_without_imperfections():
    assert isinstance(Wire(), Channel)
    assert imperfections(Wire()) == {}
