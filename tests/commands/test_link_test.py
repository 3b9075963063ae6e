"""`trimtab link-test`: table, recordings, settings for `run`, JSON, and invalid arguments."""

import json
import re
import shlex
import signal
import subprocess
import sys
import threading

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands import link_test
from trimtab.flight.line_delays import echo_requests
from trimtab.flight.transports.open_link import open_link
from trimtab.links.latency import mean_latency
from trimtab.links.latency_trace import read_trace
from trimtab.scenarios.build import build

HEARS_CTRL_C = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from trimtab.cli import main
main()
"""
"""The command line. A process that a shell put into the background would ignore SIGINT otherwise."""


def call(*words):
    return CliRunner().invoke(main, ["link-test", *map(str, words)])


@pytest.fixture
def echoing(tmp_path, monkeypatch):
    """Address of a running echo."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    stop = threading.Event()
    link = open_link("loopback://bench", listen=True)
    thread = threading.Thread(target=echo_requests, args=(link,), kwargs={"stop": stop.is_set})
    thread.start()
    yield "loopback://bench"
    stop.set()
    thread.join()
    link.close()


@pytest.mark.real_time
def test_prints_table_and_writes_recordings_plot_and_settings(echoing, tmp_path):
    done = call(echoing, "--load", "2.9/22.0", "--requests", 12, "--rate", 100, "--out", tmp_path / "found")
    assert done.exit_code == 0, done.output
    assert "2.9/22" in done.stdout
    assert "round trip" in done.stdout
    names = {file.name for file in (tmp_path / "found").iterdir()}
    both = {"uplink-2.9-22.csv", "downlink-2.9-22.csv"}
    assert names == both | {"settings-2.9-22.txt", "link-test.json", "link-test.png"}
    assert all(len(read_trace(tmp_path / "found" / name).sent_s) == 12 for name in both)
    words = (tmp_path / "found" / "settings-2.9-22.txt").read_text().split()
    assert words[::2] == ["--set"] * 7
    assert words[1] == "links=measured"


@pytest.mark.real_time
def test_written_settings_are_accepted_by_run(echoing, tmp_path):
    done = call(echoing, "--load", "2.9/22.0", "--requests", 12, "--rate", 100, "--out", tmp_path / "found")
    assert done.exit_code == 0, done.output
    words = (tmp_path / "found" / "settings-2.9-22.txt").read_text().split()
    settings = dict(word.split("=", 1) for word in words[1::2])
    world = build("hovercraft/zero-velocity", settings).world
    for channel, path in ((world.uplink, "up"), (world.downlink, "down")):
        recorded = read_trace(tmp_path / "found" / f"{path}link-2.9-22.csv").latency_s
        assert mean_latency(channel.latency) == pytest.approx(recorded.mean(), rel=0.02, abs=2e-5)


def test_duration_is_printed_before_first_request(monkeypatch):
    class Silent:
        def close(self):
            pass

    monkeypatch.setattr(link_test, "open_link", lambda uri, listen: Silent())
    monkeypatch.setattr(link_test, "measure_delays", lambda link, exchange, plan: None)
    said = call("udp://127.0.0.1:14551", "--load", "1/8", "--load", "2/16", "--requests", 300).stderr
    assert said.startswith("the test takes about 60 s; the other end must answer within 30 s\nerror: ")


@pytest.mark.real_time
def test_json_reports_round_trip_and_loss_per_load(echoing):
    found = json.loads(
        call(echoing, "--load", "1/8", "--load", "2/16", "--requests", 10, "--rate", 100, "--json").stdout
    )
    assert [(load["load_up_kbps"], load["load_down_kbps"]) for load in found["loads"]] == [(1, 8), (2, 16)]
    for load in found["loads"]:
        assert load["answered"] == load["requests"] == 10
        assert load["shared_clock"] is True
        trip = load["round_trip"]
        assert trip["min_ms"] <= trip["mean_ms"] <= trip["max_ms"]
        assert load["up"]["mean_ms"] + load["down"]["mean_ms"] == pytest.approx(trip["mean_ms"])
        assert load["up"]["lost"] == load["down"]["lost"] == 0


@pytest.mark.parametrize(
    ("uri", "shown"),
    [
        ("udp://:14551", r"udp://127\.0\.0\.1:14551"),
        ("udp://192.168.4.1:14551", r"udp://192\.168\.4\.1:14551"),
        ("udp://0.0.0.0:14551", r"udp://(?!0\.0\.0\.0)[\w.-]+:14551"),
        ("serial:///dev/ttyUSB0?baud=115200", r"serial:///dev/ttyUSB0\?baud=115200"),
    ],
)
def test_echo_prints_command_for_the_other_end(uri, shown, monkeypatch):
    class Silent:
        def close(self):
            pass

    monkeypatch.setattr(link_test, "open_link", lambda uri, listen: Silent())
    monkeypatch.setattr(link_test, "echo_requests", lambda link: None)
    done = call(uri, "--echo")
    line = done.stderr.strip()
    assert line.startswith(f"echoing on {uri}; the other end: ")
    words = shlex.split(line.partition("the other end: ")[2])
    assert words[:2] == ["trimtab", "link-test"]
    assert re.fullmatch(shown, words[2])


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("loopback://bench", "--load", "22"), "'22' is not UP/DOWN in kb/s"),
        (("loopback://bench", "--load", "2.9/2200"), "each up to 1000"),
        (("loopback://bench", "--requests", 3), "must be at least 10, got 3"),
        (("loopback://bench", "--rate", 0.0), "must be above 0 and at most 200, got 0"),
        (("bench",), "the address has no scheme"),
    ],
)
def test_invalid_arguments_are_rejected_with_fix(words, why):
    done = call(*words)
    assert done.exit_code == 2
    assert why in done.stderr
    assert "Fix:" in done.stderr


def test_no_answer_exits_with_1_and_suggests_echo(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("trimtab.commands.link_test.measure_delays", lambda *_: None)
    done = call("loopback://nobody")
    assert done.exit_code == 1
    assert "--echo" in done.stderr


@pytest.mark.real_time
@pytest.mark.parametrize("scheme", ["udp", "tcp"])
def test_echo_at_port_0_prints_assigned_port(scheme):
    words = [sys.executable, "-c", HEARS_CTRL_C, "link-test", f"{scheme}://:0", "--echo"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as far:
        try:
            line = far.stderr.readline()
            port = int(re.match(rf"echoing on {scheme}://:(\d+); the other end: ", line)[1])
            assert port > 0
            address = shlex.split(line.partition("the other end: ")[2])[2]
            assert address == f"{scheme}://127.0.0.1:{port}"
            done = call(address, "--load", "1/8", "--requests", 10, "--rate", 100, "--json")
            assert done.exit_code == 0, done.stderr
            assert json.loads(done.stdout)["loads"][0]["up"]["lost"] == 0
        finally:
            far.send_signal(signal.SIGINT)
        assert far.wait(20) == 0


def test_rejects_port_0_for_connecting_end():
    done = call("udp://127.0.0.1:0", "--requests", 10)
    assert done.exit_code == 2
    assert "a port from 1 to 65535" in done.stderr
