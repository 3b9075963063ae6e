"""The writer's recorder, without a process: what is in the ring comes out of the file."""

import os

import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.messages import layout_record, run_record
from trimtab.logs.ring import Ring
from trimtab.logs.stream_writer import Recorder


def test_rows_that_go_back_in_time_are_left_out_and_counted(tmp_path):
    nothing = np.empty(0, np.int64)
    counts = {"log.dropped": nothing, "log.unwritten": nothing}
    signals = {"law.x": np.empty(0)} | counts
    declared = {"law.x": Quantity("m", "A number.")}
    empty = Log(
        t=nothing.astype(float), ticks=nothing, signals=signals, declarations=declared, metadata={"scenario": "s"}
    )
    ring = Ring.create(columns=2, rows=16)
    path = tmp_path / "one.mcap"
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        recorder = Recorder(ring, file, run_record(empty), layout_record(empty))
        for t, x in ((0, 1.0), (10_000, 2.5), (10_000, 9.0), (5_000, 9.0), (20_000, -0.1)):
            ring.write_row(np.array([t, x]))
        recorder.read_ring()
        recorder.finish("{}")
    finally:
        os.close(file)
        ring.unlink()
        ring.close()
    log = read_mcap(path)
    np.testing.assert_array_equal(log.ticks, [0, 10_000, 20_000])
    np.testing.assert_array_equal(log["law.x"], [1.0, 2.5, -0.1])
    assert log["log.unwritten"][-1] == 2
