"""A flight that gets too fast: the vehicle ends it by itself, both ends say why, and both logs."""

import socket

import pytest
from links.ends import free_port
from live.pair import fly_pair

from trimtab.logs.mcap import read_mcap
from trimtab.native.compiler import find_compiler

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
FASTEST = 0.5
"""m/s, of the 1.08 that the flight would reach."""


def test_too_fast_for_its_envelope_it_goes_to_failsafe(tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    patient = ("--set", "failsafe.timeout=5 s", "--set", "failsafe.age_max=5")  # a busy machine ends no flight here
    settings = ("--set", f"limits.speed={FASTEST}", *patient, "--duration", "8 s", "--no-real-time")
    lines = f"udp://:{port}", f"udp://127.0.0.1:{port}"
    there, here = fly_pair(tmp_path, "hovercraft/forward", *lines, *settings)
    assert (there.status, here.status) == (1, 1), (there, here)
    for said in (there.said, here.said):
        assert "failsafe: envelope: speed 0.5" in said
        assert f"at most {FASTEST}, by navigation" in said
    log = read_mcap(tmp_path / "there" / "vehicle.mcap")
    ended = log["truth.surge_velocity"][-1]
    assert FASTEST * 0.8 < log["truth.surge_velocity"].max() < FASTEST + 0.25
    assert log["actuators.speed_rpm"][-1] == 0
    assert ended < FASTEST + 0.25
