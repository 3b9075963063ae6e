"""Reports of a silent link."""

from types import SimpleNamespace

from trimtab.core.time import ms
from trimtab.flight.silence import SILENCE, SilenceWatch


def test_silence_and_its_end_are_each_reported_once():
    counts = SimpleNamespace(accepted=0)
    watch = SilenceWatch(counts)
    counts.accepted = 1
    assert watch.update(ms(1)) == ""
    assert watch.update(ms(1) + SILENCE - 1) == ""
    assert watch.update(ms(1) + SILENCE) == "no data from the vehicle for 0.250 s"
    assert watch.is_silent
    assert watch.update(ms(500)) == ""
    counts.accepted = 2
    assert watch.update(ms(600)) == "data from the vehicle again after 0.599 s"
    assert not watch.is_silent
    assert watch.length(ms(650)) == ms(50)


def test_link_is_alive_within_100_ms_of_a_frame():
    counts = SimpleNamespace(accepted=5)
    watch = SilenceWatch(counts)
    watch.update(ms(0))
    assert watch.is_heard(ms(99))
    assert not watch.is_heard(ms(100))
    counts.accepted = 6
    assert watch.is_heard(ms(500))
    watch.restart(ms(1000))
    assert watch.length(ms(1010)) == ms(10)
