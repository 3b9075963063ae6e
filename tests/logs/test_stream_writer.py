"""The writer's recorder without a process: the file contains the rows of the ring."""

import os

import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.messages import layout_record, run_record
from trimtab.logs.ring import Ring
from trimtab.logs.stream_writer import Recorder


class RacingRing(Ring):
    """A ring in which a text and two rows arrive after the reader has taken texts and before it takes rows."""

    def read_texts(self):
        texts = super().read_texts()
        if not self.waiting_rows:
            self.write_row(np.array([0, 1.0]))
            self.write_text("armed")
            self.write_row(np.array([10_000, 2.0]))
        return texts


def record(path, make_ring, use):
    nothing = np.empty(0, np.int64)
    counts = {"log.dropped": nothing, "log.unwritten": nothing}
    signals = {"law.x": np.empty(0)} | counts
    declared = {"law.x": Quantity("m", "A number.")}
    empty = Log(
        t=nothing.astype(float), ticks=nothing, signals=signals, declarations=declared, metadata={"scenario": "s"}
    )
    ring = make_ring.create(columns=2, rows=16)
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        recorder = Recorder(ring, file, run_record(empty), layout_record(empty))
        use(ring, recorder)
        recorder.finish("{}")
    finally:
        os.close(file)
        ring.unlink()
        ring.close()
    return read_mcap(path)


def test_rows_back_in_time_are_dropped_and_counted(tmp_path):
    def write(ring, recorder):
        for t, x in ((0, 1.0), (10_000, 2.5), (10_000, 9.0), (5_000, 9.0), (20_000, -0.1)):
            ring.write_row(np.array([t, x]))
        recorder.read_ring()

    log = record(tmp_path / "one.mcap", Ring, write)
    np.testing.assert_array_equal(log.ticks, [0, 10_000, 20_000])
    np.testing.assert_array_equal(log["law.x"], [1.0, 2.5, -0.1])
    assert log["log.unwritten"][-1] == 2


def test_event_has_the_time_of_the_preceding_row(tmp_path):
    log = record(tmp_path / "one.mcap", RacingRing, lambda ring, recorder: recorder.read_ring())
    assert log.metadata["events"][0] == {"t": 0.0, "text": "armed"}
    assert log.ticks[:2].tolist() == [0, 10_000]
