import json
import threading

import pytest

from trimtab.commands.link_test import LinkTestRequest, link_test
from trimtab.core.errors import InputError
from trimtab.links.latency import mean_latency
from trimtab.links.latency_trace import read_trace


@pytest.fixture
def echoing(tmp_path, monkeypatch):
    """The other end, under a name."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    stop = threading.Event()
    thread = threading.Thread(target=link_test, args=(LinkTestRequest("loopback://bench", echo=True), stop.is_set))
    thread.start()
    yield "loopback://bench"
    stop.set()
    thread.join()


def test_table_recordings_picture_and_settings(echoing, tmp_path, capsys):
    request = LinkTestRequest(echoing, loads=("2.9/22.0",), requests=12, rate=100, out=tmp_path / "found")
    assert link_test(request)
    text = capsys.readouterr().out
    assert "2.9/22" in text
    assert "round trip" in text
    names = {file.name for file in (tmp_path / "found").iterdir()}
    both = {"uplink-2.9-22.csv", "downlink-2.9-22.csv"}
    assert names == both | {"settings-2.9-22.txt", "link-test.json", "link-test.png"}
    assert all(len(read_trace(tmp_path / "found" / name).sent_s) == 12 for name in both)
    words = (tmp_path / "found" / "settings-2.9-22.txt").read_text().split()
    assert words[::2] == ["--set"] * 7
    assert words[1] == "links=measured"


def test_what_is_written_can_be_typed_after_run(echoing, tmp_path):
    from trimtab.commands import fly_scenario

    assert link_test(LinkTestRequest(echoing, loads=("2.9/22.0",), requests=12, rate=100, out=tmp_path / "found"))
    words = (tmp_path / "found" / "settings-2.9-22.txt").read_text().split()
    settings = dict(word.split("=", 1) for word in words[1::2])
    world = fly_scenario.build_from_request(fly_scenario.RunRequest("hovercraft/zero-velocity", settings)).world
    for channel, path in ((world.uplink, "up"), (world.downlink, "down")):
        recorded = read_trace(tmp_path / "found" / f"{path}link-2.9-22.csv").latency_s
        assert mean_latency(channel.latency) == pytest.approx(recorded.mean(), rel=0.02, abs=2e-5)


def test_json(echoing, capsys):
    assert link_test(LinkTestRequest(echoing, loads=("1/8", "2/16"), requests=10, rate=100, as_json=True))
    found = json.loads(capsys.readouterr().out)
    assert [(load["load_up_kbps"], load["load_down_kbps"]) for load in found["loads"]] == [(1, 8), (2, 16)]
    for load in found["loads"]:
        assert load["answered"] == load["requests"] == 10
        assert load["shared_clock"] is True
        trip = load["round_trip"]
        assert trip["min_ms"] <= trip["mean_ms"] <= trip["max_ms"]
        assert load["up"]["mean_ms"] + load["down"]["mean_ms"] == pytest.approx(trip["mean_ms"])
        assert load["up"]["lost"] == load["down"]["lost"] == 0


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"loads": ("22",)}, "'22' is not UP/DOWN in kb/s"),
        ({"loads": ("2.9/2200",)}, "each up to 1000"),
        ({"requests": 3}, "3 requests make no table"),
        ({"rate": 0.0}, "0 requests per second"),
        ({"uri": "bench"}, "it has no scheme"),
    ],
)
def test_wrong_input_is_refused_with_what_to_type(change, why):
    with pytest.raises(InputError) as caught:
        link_test(LinkTestRequest(**{"uri": "loopback://bench", **change}))
    assert why in str(caught.value)
    assert caught.value.fix


def test_nobody_answers(tmp_path, monkeypatch, capsys):
    from trimtab.live import link_test as measuring

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(measuring, "measure_delays", lambda *_: None)
    assert link_test(LinkTestRequest("loopback://nobody")) is False
    assert "--echo" in capsys.readouterr().err
