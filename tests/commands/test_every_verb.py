"""Every verb, run on each scenario by command line.

A line in `SCENARIOS` adds a scenario. These tests check that a verb succeeds and prints a result. Each verb's own tests
check the numbers.
"""

import json
import re
import shutil
import socket
import subprocess
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner
from flight.pair import Program, fly_pair, make_key
from flight.transports.ends import free_port

from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.flight.console_packets import HEAD

RUNS = "70"


class Walk(NamedTuple):
    """What a scenario's verbs are asked.

    uncertain: a setting whose value differs from world to world.  gain: one of the law.  success: of a run.  cost:
    what tuning makes small.  settings: for all, e.g. a shorter flight.  shown: words that `trimtab run` says of it.
    has_firmware: whether its actuators say by which pulses they are told.  rare: what fails rarely.
    measured: what is found again from a log of a flight with it.  limits: of states and inputs, for a gain.  at: where.
    may_not_help: whether tuning so short may find nothing better.  design: makes the gain file that it flies by.
    """

    uncertain: str
    gain: str
    success: str
    cost: str
    settings: tuple[str, ...] = ("duration=4 s",)
    shown: str = ""
    has_firmware: bool = True
    rare: str = ""
    may_not_help: bool = False
    measured: str = ""
    limits: tuple[str, ...] = ()
    at: str = ""
    design: tuple[str, ...] = ()


SCENARIOS = {
    "hovercraft/forward": Walk(
        uncertain="world.vehicle.mass",
        gain="autopilot.law.k1",
        success="final:surge_velocity >= 0.5",
        cost="error_rms:surge_velocity",
        shown="surge_velocity",
    ),
    "tests/loop/lander.py:hover": Walk(
        uncertain="world.vehicle.mass",
        gain="autopilot.law.k",
        success="final:truth.altitude <= 7",
        cost="error_rms:truth.altitude",
        shown="flight.altitude",
        has_firmware=False,
    ),
    "quadrotor/track": Walk(
        uncertain="world.vehicle.mass",
        gain="autopilot.law.nominal.kx",
        success="mean:law.distance <= 0.1",
        cost="rms:law.distance",
        shown="flight.roll",
    ),
    "examples/my_boat.py:scenario": Walk(
        uncertain="world.vehicle.mass",
        gain="autopilot.law.k_heading",
        success="final:surge_velocity >= 0.7",
        cost="error_rms:law.off_course",
        shown="law.off_course",
        rare="peak:yaw_rate <= 0.905",
        measured="world.vehicle.mass=2.4",
        limits=("surge_velocity=0.2", "sway_velocity=0.3", "yaw_rate=0.3", "heading=0.2", "thrust=3", "rudder=0.5"),
        at="surge_velocity=1",
    ),
    "src/trimtab/templates/my_vehicle.py:scenario": Walk(
        uncertain="world.vehicle.speed",
        gain="autopilot.law.design_model.speed",
        success="final:truth.lean <= 0.1",
        cost="rms:truth.heading",
        shown="heading (deg)",
        limits=("lean=0.2", "lean_rate=0.7", "heading=0.5", "steer=0.2"),
        at="heading=0",
        may_not_help=True,
    ),
    "vessel/path": Walk(
        uncertain="world.vehicle.current.north",
        gain="autopilot.law.speed_gain",
        success="final:surge_velocity >= 0.3",
        cost="error_rms:law.cross_track",
        settings=("duration=6 s",),
        shown="law.cross_track",
    ),
    "f16/gcas": Walk(
        may_not_help=True,
        uncertain="world.vehicle.mass",
        gain="autopilot.law.roll_gain",
        success="final:truth.altitude >= 0",
        cost="rms:law.load_error",
        shown="flight.altitude",
    ),
    "cart-pole/swing-up, by a gain": Walk(
        uncertain="world.vehicle.cart_mass",
        gain="autopilot.law.K[0,0]",
        success="final:truth.angle <= 0.1",
        cost="rms:truth.position",
        settings=("start=leaning", "duration=4 s"),
        shown="angle_rate",
        design=(
            "--at=angle=0",
            *("--limit=position=1", "--limit=speed=1", "--limit=angle=0.2", "--limit=angle_rate=1", "--limit=force=10"),
        ),
    ),
    "quadrotor/track, by a gain": Walk(
        uncertain="world.vehicle.mass",
        gain="autopilot.law.K[0,7]",  # below 0
        success="final:truth.position[2] <= 3.2",
        cost="rms:law.error[2]",
        settings=("trajectory=place", "duration=4 s"),
        shown="flight.roll",
        design=(
            "--set=trajectory=place",
            *("--limit=position=0.5", "--limit=velocity=1", "--limit=attitude=0.2", "--limit=rate=2"),
            *("--limit=rotor_speed=100", "--limit=speed=60"),
        ),
        may_not_help=True,
    ),
}
"""Scenario, and what more tells it from others -> what its verbs are asked."""


def call(*words: str, codes: tuple[int, ...] = (0,)) -> str:
    """Return what a command prints. Its exit code must be 0 or one of the others given."""
    done = CliRunner().invoke(main, list(words))
    assert done.exit_code in codes, done.output
    return done.stdout or done.output


def common(name: str, walk: Walk, folder: Path) -> list[str]:
    """What all verbs are told of a scenario; its gain, where it flies by one, is made first."""
    settings = walk.settings
    if walk.design:
        file = folder / "gain.json"
        if not file.exists():
            call("design", name, "--lqr", *walk.design, "--out", str(file))
        settings += (f"gain={file}",)
    return [word for setting in settings for word in ("--set", setting)]


def do_list(name: str, walk: Walk, folder: Path) -> None:
    found = json.loads(call("list", name, "--json"))
    assert {walk.uncertain} | (set() if walk.design else {walk.gain}) <= set(found["settings"])


def do_run(name: str, walk: Walk, folder: Path) -> None:
    said = call("run", name, *common(name, walk, folder), "--plot", str(folder / "run.png"), "--out", str(folder))
    assert walk.shown in said
    assert "LOST" not in said
    assert (folder / "run.png").read_bytes()[:4] == b"\x89PNG"


def do_campaign(name: str, walk: Walk, folder: Path) -> None:
    words = ("--runs", RUNS, "--spread", f"{walk.uncertain}=uniform(95%, 105%)", "--success", walk.success)
    found = json.loads(call("campaign", name, *common(name, walk, folder), *words, "--json"))
    assert found["success"]["share"] > 0.5


def do_budget(name: str, walk: Walk, folder: Path) -> None:
    assert json.loads(call("budget", name, *common(name, walk, folder), "--runs", "2", "--json"))


def do_map(name: str, walk: Walk, folder: Path) -> None:
    words = ("--x", f"{walk.uncertain}=80%:120%:3", "--y", f"{walk.gain}=50%:150%:3", "--runs", "2", "--depth", "0")
    assert json.loads(call("map", name, *common(name, walk, folder), *words, "--success", walk.success, "--json"))


def do_falsify(name: str, walk: Walk, folder: Path) -> None:
    words = ("--spread", f"{walk.uncertain}=uniform(95%, 105%)", "--success", walk.success, "--runs", "400")
    found = json.loads(call("falsify", name, *common(name, walk, folder), *words, "--json", codes=(0, 1)))
    assert found["failed"] == (found["margin"] < 0)


def do_tune(name: str, walk: Walk, folder: Path) -> None:
    words = ("--gain", f"{walk.gain}=80%:120%", "--cost", walk.cost, "--runs", "8", "--judge-runs", "64")
    words += ("--spread", f"{walk.uncertain}=uniform(95%, 105%)", "--iterations", "2", "--out", str(folder / "t.py"))
    said = call("tune", name, *common(name, walk, folder), *words, codes=(0, 1) if walk.may_not_help else (0,))
    if "not written" in said:  # gains that don't help
        assert not (folder / "t.py").exists()
    else:
        assert "scenario" in (folder / "t.py").read_text()


def do_export(name: str, walk: Walk, folder: Path) -> None:
    for part in ("autopilot", "loop"):
        words = ("--part", part, "--steps", "300", "--out", str(folder / part))
        call("export", name, *common(name, walk, folder), *words)
        call("export", "--verify", str(folder / part))


def do_replay(name: str, walk: Walk, folder: Path) -> None:
    call("run", name, *common(name, walk, folder), "--no-ideal", "--out", str(folder))
    assert json.loads(call("replay", str(folder / "run.mcap"), *own(name), "--json"))["equal"]


def own(name: str) -> tuple[str, ...]:
    """What replay is told of a scenario that is in no catalogue: no file is run because a log names it."""
    return ("--scenario", name) if ".py:" in name else ()


def do_fly(name: str, walk: Walk, folder: Path) -> None:
    """Fly vehicle and autopilot as two processes over UDP, in wall-clock time; then replay the flight's log."""
    port = free_port(socket.SOCK_DGRAM)
    ends = (f"udp://127.0.0.1:{port}", f"udp://127.0.0.1:{port}")
    there, here = fly_pair(folder, name, *ends, "--unsigned", "--duration", "2", *common(name, walk, folder))
    assert here.status == 0, here.said
    assert there.result is not None, there.said
    call("replay", str(folder / "here" / "flight.mcap"), *own(name), "--json")


def do_firmware(name: str, walk: Walk, folder: Path) -> None:
    words = (
        "firmware",
        name,
        *(common(name, walk, folder) if walk.design else ()),
        "--out",
        str(folder / "board"),
        "--key",
        str(make_keys(folder)),
    )
    if not walk.has_firmware:
        assert "ServoPulse" in call(*words, codes=(2,))
        return
    assert "output 1: " in call(*words)
    if shutil.which("arm-none-eabi-gcc") is None or shutil.which("make") is None:
        pytest.skip("needs arm-none-eabi-gcc and make to build it")
    built = subprocess.run(["make", "-C", str(folder / "board")], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr[-2000:]


def do_rare(name: str, walk: Walk, folder: Path) -> None:
    found = json.loads(
        call("rare", name, *common(name, walk, folder), "--success", walk.rare, "--runs", "20000", "--json")
    )
    assert 0 < found["probability"] < 0.1


def do_identify(name: str, walk: Walk, folder: Path) -> None:
    """Identify from a flight's log the parameter with which it flew, though the scenario has another value."""
    call("run", name, "--set", walk.measured, "--no-ideal", "--out", str(folder))
    path, _, number = walk.measured.partition("=")
    found = json.loads(call("identify", name, str(folder / "run.mcap"), "--fit", path, "--json"))
    assert found["parameters"][path]["low"] < float(number) < found["parameters"][path]["high"]


def do_design(name: str, walk: Walk, folder: Path) -> None:
    """Compute trim, poles and a gain of the vehicle, and the poles of the loop."""
    file, point = name.partition(":")[0], ("--at", walk.at)
    assert json.loads(call("trim", file, *point, "--json"))
    assert json.loads(call("linearise", file, *point, "--json"))
    assert json.loads(call("linearise", name, "--closed-loop", "--json"))
    limits = [word for limit in walk.limits for word in ("--limit", limit)]
    call("design", file, "--lqr", *point, *limits, "--out", str(folder / "gain.json"))
    assert (folder / "gain.json").stat().st_size > 0


def make_keys(folder: Path) -> Path:
    make_key(folder)
    return folder / "config" / "keys" / "hovercraft.key"


def do_console(name: str, walk: Walk, folder: Path) -> None:
    """The page's address, its hello, and one row of numbers."""
    from websockets.sync.client import connect

    make_key(folder, name.partition("/")[0])
    program = Program("console", name, *common(name, walk, folder), folder=folder)
    try:
        assert program.process.stdout is not None
        told = "".join(iter_until(program.process.stdout, "console: http"))
        address = re.search(r"console: (http\S+)", told)
        assert address, program.said()
        host, cookie = urlsplit(address[1]).netloc, find_cookie(address[1])
        headers = {"Cookie": cookie}
        with connect(f"ws://{host}/live", origin=f"http://{host}", additional_headers=headers) as page:
            hello = json.loads(page.recv(30))
            assert hello["title"]
            while not isinstance(row := page.recv(30), bytes):
                pass
            assert len(row) == HEAD.size + 4 * len(hello["signals"])
    finally:
        program.process.terminate()
        program.process.communicate(timeout=60)


def iter_until(lines: IO[str], words: str) -> Iterator[str]:
    """Lines up to the first with these words, or to the end."""
    for line in lines:
        yield line
        if words in line:
            return


def find_cookie(address: str) -> str:
    """Return the cookie that a browser gets for the token."""

    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *args: object) -> None:
            return None

    try:
        urllib.request.build_opener(Stay).open(address, timeout=10)
    except urllib.error.HTTPError as answer:
        with answer:
            return str(answer.headers["Set-Cookie"]).partition(";")[0]
    raise AssertionError("it gives no cookie")


VERBS: dict[str, Callable[[str, Walk, Path], None]] = {
    name.removeprefix("do_"): do for name, do in list(globals().items()) if name.startswith("do_")
}
QUICK = (("hovercraft/forward", "list"), ("examples/my_boat.py:scenario", "list"))
REAL_TIME = ("fly", "console")
NEEDED = {"rare": "rare", "identify": "measured", "design": "limits"}
"""Verb -> what a walk has to say to be asked it."""
CASES = [
    pytest.param(
        scenario,
        verb,
        id=f"{scenario.replace('/', '-').replace(', ', '-').replace(' ', '-')}-{verb}",
        marks=() if (scenario, verb) in QUICK else pytest.mark.real_time if verb in REAL_TIME else pytest.mark.thorough,
    )
    for scenario in SCENARIOS
    for verb in VERBS
    if verb not in NEEDED or getattr(SCENARIOS[scenario], NEEDED[verb])
]


@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize(("scenario", "verb"), CASES)
def test_every_verb_works_on_each_scenario(scenario: str, verb: str, tmp_path: Path) -> None:
    VERBS[verb](scenario.partition(",")[0], SCENARIOS[scenario], tmp_path)
