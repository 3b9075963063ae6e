"""Overspeed: the vehicle goes to failsafe, and both ends report the reason."""

import pytest
from flight.virtual_programs import fly_pair

from trimtab.compiler.native.compiler import find_compiler

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
FASTEST = 0.5
"""m/s, of the 1.08 that the flight would reach."""


@pytest.mark.thorough
def test_overspeed_beyond_envelope_triggers_failsafe(tmp_path):
    settings = ("--set", f"limits.speed={FASTEST}", "--duration", "8 s")
    programs, there, here = fly_pair(tmp_path, "hovercraft/forward", *settings)
    assert (there.status, here.status) == (1, 1), (there, here)
    for said in (there.said, here.said):
        assert "failsafe: envelope: speed 0.5" in said
        assert f"at most {FASTEST}, by navigation" in said
    log = programs.read_log("vehicle")
    ended = log["truth.surge_velocity"][-1]
    assert FASTEST * 0.8 < log["truth.surge_velocity"].max() < FASTEST + 0.25
    assert log["actuators.speed_rpm"][-1] == 0
    assert ended < FASTEST + 0.25
