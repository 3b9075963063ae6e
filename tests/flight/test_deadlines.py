"""Deadlines of an autopilot in its own process: at 1 kHz for TRIMTAB_DEADLINE_MINUTES, by default one minute.

Limit: 99.9 % of the compiled steps take less than a tenth of the 1 ms period. On a machine whose cores are all busy
with other programs, this limit is skipped, and all other limits hold.
"""

import os

import numpy as np
import pytest
from flight import pair
from flight.transports.ends import free_port

from trimtab.compiler.native.compiler import find_compiler
from trimtab.logs.mcap import read_mcap

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
MINUTES = float(os.environ.get("TRIMTAB_DEADLINE_MINUTES", "1"))
PERIOD = 1e-3
SHARE = 0.1
BUCKET = 1.033
"""A histogram tells a time to 3 %."""


@pytest.mark.timeout(60 * MINUTES + 300)
def test_deadlines_are_met_at_1_khz(tmp_path, monkeypatch):
    monkeypatch.setattr(pair, "BUILD_S", 60 * MINUTES + 200)
    line, length = f"udp://127.0.0.1:{free_port()}", ("--duration", f"{60 * MINUTES} s")
    there, here = pair.fly_pair(tmp_path, "hovercraft/zero-velocity", line, line, *length)
    assert (there[0], here[0]) == (0, 0), (there, here)
    found, log = here[1]["deadlines"], read_mcap(tmp_path / "here" / "flight.mcap")
    print(f"\n{found['work']['n']} periods of 1 ms, {here[1]['real_time']}, load {os.getloadavg()[0]:.1f} at the end")
    for name in ("late", "step", "work"):
        cells = [f"{q} {found[name][q] * 1e6:9.1f}" for q in ("p50", "p99", "p999", "longest")]
        print(f"  {name:5} us  {'  '.join(cells)}")
    print(f"  overruns {found['overruns']}, skipped {found['skipped']}")
    steps, period = found["step"]["n"], round(PERIOD * 1e7)
    assert steps + found["skipped"] >= 60_000 * MINUTES
    assert len(log) == steps
    assert (np.diff(log.ticks) >= period).all()
    assert (np.diff(log.ticks) == period).sum() >= steps - 1 - found["skipped"]
    assert sum(found["overruns"].values()) - log["loop.overruns"][-1] in (0, 1)  # the last row comes before its verdict
    for name, wanted in (("step", log["loop.step"]), ("late", np.maximum(log["loop.late"], 0))):
        for q, share in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999)):
            exact = np.sort(wanted)[int(np.ceil(share * steps)) - 1]
            assert exact - 1e-9 <= found[name][q] <= exact * BUCKET + 1e-9, (name, q)
    if found["step"]["p999"] >= SHARE * PERIOD and os.getloadavg()[0] > len(os.sched_getaffinity(0)):
        pytest.skip(f"99.9 % of steps within {found['step']['p999'] * 1e6:.0f} us at load {os.getloadavg()[0]:.1f}")
    assert found["step"]["p999"] < SHARE * PERIOD
