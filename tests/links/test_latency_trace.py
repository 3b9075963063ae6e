import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Channel
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.links.latency_trace import LatencyTrace, Trace, read_trace, write_trace

RECORDED = Trace(
    sent_s=np.arange(6) * 0.02,
    latency_s=np.array([0.041, 0.030, 0.0, 0.055, 0.037, 0.1 + 0.2]),  # the last has no short decimal form
    lost=np.array([False, False, True, False, False, False]),
)
HEAD = "sent_s,latency_s\n"


def test_recording_round_trips_bit_by_bit(tmp_path):
    write_trace(tmp_path / "a.csv", RECORDED)
    for got, want in zip(read_trace(tmp_path / "a.csv"), RECORDED, strict=True):
        np.testing.assert_array_equal(got, want)
        assert got.dtype == want.dtype
    assert (tmp_path / "a.csv").read_text().splitlines()[:4] == ["sent_s,latency_s", "0.0,0.041", "0.02,0.03", "0.04,"]


def test_replay_reproduces_a_recording_exactly(drive):
    """For an ordered link on its own grid each arrival equals the recorded one, also after the recording restarts."""
    random = np.random.default_rng(0)
    sent = np.arange(40) * ms(20)
    arrival = np.maximum.accumulate(sent + random.integers(20, 120, 40) * ms(1))
    arrival[-1] = min(arrival[-1], ms(40 * 20))  # so that it can start again without waiting for the last one
    arrival = np.minimum.accumulate(arrival[::-1])[::-1]
    lost = random.random(40) < 0.2
    lost[0] = False
    link = LatencyTrace.of(Trace(sent * 1e-7, (arrival - sent) * 1e-7 * ~lost, lost), send_period=ms(20), capacity=8)
    link.check()
    t, out, state = drive(link, key(0), 1600)

    seen = {}
    for cycle in (0, ms(800)):
        seen |= {a + cycle: s + cycle for s, a, gone in zip(sent, arrival, lost, strict=True) if not gone}
    seen = {a: s for a, s in seen.items() if a < ms(1600)}  # of packets that arrive together, the newest
    np.testing.assert_array_equal(t[out.fresh], sorted(seen))
    np.testing.assert_array_equal(out.t[out.fresh], [seen[a] for a in sorted(seen)])
    assert (state.sent[-1], state.lost[-1]) == (80, 2 * lost.sum())
    assert lost.sum() > 3


def test_imperfections_can_be_disabled_one_by_one():
    link = LatencyTrace.of(RECORDED)
    mean = RECORDED.latency_s[~RECORDED.lost].mean()
    np.testing.assert_array_equal(without(link, "delay").latency, 0.0)
    np.testing.assert_allclose(without(link, "jitter").latency, mean)
    np.testing.assert_array_equal(without(link, "jitter").lost, RECORDED.lost)
    whole = without(link, "loss")
    assert not whole.lost.any()
    np.testing.assert_allclose(whole.latency, np.where(RECORDED.lost, mean, RECORDED.latency_s))
    with pytest.raises(InputError, match=r"no imperfection 'order'.*\nChoices: delay, jitter, loss"):
        without(link, "order")


def test_trace_with_all_packets_lost_never_delivers(drive):
    link = LatencyTrace(np.zeros(2), np.ones(2, bool))
    assert (without(link, "jitter").latency == 0).all()
    _, out, state = drive(link, key(0), 100)
    assert not out.valid.any()
    assert state.lost[-1] == 5


@pytest.mark.parametrize(
    ("text", "where", "why"),
    [
        ("", "", "the file is empty"),
        (" \n\n", "", "the file is empty"),
        ("0.0,0.04\n0.02,0.04\n", ", line 1", r"the header is '0.0,0.04'"),
        (HEAD, "", "packets in the file: 0, must be at least 2"),
        (HEAD + "0.0,0.04\n", "", "packets in the file: 1, must be at least 2"),
        (HEAD + "0.0,0.04\n0.02,fast\n", ", line 3", "latency_s is 'fast', not a finite number"),
        (HEAD + "now,0.04\n0.02,0.04\n", ", line 2", "sent_s is 'now', not a finite number"),
        (HEAD + "0.0,0.04\n\n0.02,-0.001\n", ", line 4", r"the latency must be at least 0, got -0.001 s"),
        (HEAD + "0.0,nan\n0.02,0.04\n", ", line 2", "latency_s is 'nan', not a finite number"),
        (HEAD + "0.0,0.04\n0.02,inf\n", ", line 3", "latency_s is 'inf', not a finite number"),
        (HEAD + "0.0,0.04\n,0.04\n", ", line 3", "sent_s is '', not a finite number"),
        (HEAD + "0.04,0.04\n0.02,0.04\n", ", line 3", r"sent at 0.02 s, before the packet above it \(0.04 s\)"),
        (HEAD + "0.0,0.04,1\n0.02,0.04\n", ", line 2", "the line '0.0,0.04,1' has 3 fields, but must have 2"),
        (HEAD + "0.0\n0.02,0.04\n", ", line 2", "the line '0.0' has 1 fields, but must have 2"),
    ],
)
def test_rejects_malformed_trace_file(tmp_path, text, where, why):
    path = tmp_path / "trace.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=why) as caught:
        read_trace(path)
    assert caught.value.part == f"{path}{where}"
    assert caught.value.fix


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: file not found\.\nFix: .*trimtab link-test URI --out"):
        read_trace(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot be read as text"):
        read_trace(tmp_path)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="cannot be read as text"):
        read_trace(tmp_path / "binary.csv")


def test_reads_spaces_byte_order_mark_and_equal_times(tmp_path):
    (tmp_path / "a.csv").write_text("\ufeffsent_s, latency_s\r\n 0.02 , 0.04 \r\n0.02,\r\n", encoding="utf-8")
    trace = read_trace(tmp_path / "a.csv")
    np.testing.assert_array_equal(trace.sent_s, [0.02, 0.02])
    np.testing.assert_array_equal(trace.latency_s, [0.04, 0.0])
    np.testing.assert_array_equal(trace.lost, [False, True])


def test_invalid_latencies_are_not_written(tmp_path):
    for bad in (np.full(6, np.nan), np.full(6, -0.01)):
        with pytest.raises(InputError, match="line 2"):
            write_trace(tmp_path / "a.csv", RECORDED._replace(latency_s=bad))
    assert not (tmp_path / "a.csv").exists()


def test_bad_settings_are_refused():
    link = LatencyTrace.of(RECORDED)
    link.check()
    assert isinstance(link, Channel)
    with pytest.raises(InputError, match="must be lists of equal length"):
        replace(link, lost=np.zeros(3, bool)).check()
    with pytest.raises(InputError, match="must be lists of equal length"):
        LatencyTrace(np.zeros(0), np.zeros(0, bool)).check()
    with pytest.raises(InputError, match=r"packet 3 has the latency nan s"):
        replace(link, latency=np.where(np.arange(6) == 3, np.nan, 0.01)).check()
    with pytest.raises(InputError, match=r"capacity.*\nFix: set capacity to at least 17"):
        replace(link, capacity=5).check()
