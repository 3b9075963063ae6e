"""Group `refused`: input that is refused ends with exit code 2. What is said of it is a note: words may change."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command import call

REST, FORWARD, HEADING = "hovercraft/zero-velocity", "hovercraft/forward", "hovercraft/heading-proportional"
CAMPAIGN = ("campaign", REST, "--runs", "10")
FALSIFY = ("falsify", REST, "--spread", "world.vehicle.mass=uniform(80%, 120%)")
TUNE = ("tune", REST, "--gain")

REFUSED: dict[str, tuple[str, ...]] = {
    "no verb of that name": ("sail",),
    "no option of that name": ("run", REST, "--speed", "3"),
    "unknown scenario": ("run", "hovercraft/fly"),
    "unknown folder": ("run", "submarine/dive"),
    "missing file": ("run", "nowhere.py:scenario"),
    "missing module": ("run", "nowhere:scenario"),
    "missing function": ("run", "empty.py:scenario"),
    "no scenario": ("run", "number.py:scenario"),
    "list of nothing": ("list", "hovercraft/fly"),
    "unknown path": ("run", REST, "--set", "world.vehicle.mas=3"),
    "path of a part": ("run", REST, "--set", "world.vehicle=3"),
    "no equals sign": ("run", REST, "--set", "world.vehicle.mass"),
    "text for a number": ("run", REST, "--set", "world.vehicle.mass=heavy"),
    "list for a number": ("run", REST, "--set", "world.vehicle.mass=[1,2]"),
    "not a number": ("run", REST, "--set", "world.vehicle.mass=nan"),
    "infinity": ("run", REST, "--set", "autopilot.law.k1=inf"),
    "negative mass": ("run", REST, "--set", "world.vehicle.mass=-1"),
    "period of zero": ("run", REST, "--set", "autopilot.period=0"),
    "negative steps": ("run", REST, "--set", "world.downlink.steps=-1"),
    "negative duration": ("run", REST, "--duration", "-3"),
    "duration in words": ("run", REST, "--duration", "long"),
    "log period in words": ("run", REST, "--log-period", "often"),
    "not a choice": ("run", HEADING, "--set", "initial=flying"),
    "not an option's word": ("run", HEADING, "--set", "autopilot.law.form=x"),
    "unknown imperfection": ("run", REST, "--without", "gravity"),
    "no navigation to choose": ("run", "hypersonic/noise", "--navigation", "ins"),
    "unknown navigation": ("run", REST, "--navigation", "stars"),
    "negative seed": ("run", REST, "--seed", "-1"),
    "seed too large": ("run", REST, "--seed", "4294967296"),
    "unknown backend": ("run", REST, "--backend", "fortran"),
    "out below a file": ("run", REST, "--out", "/dev/null/flight"),
    "picture without ending": ("run", REST, "--plot", "picture"),
    "fault of no part": ("run", FORWARD, "--fault", "sensor:gps off"),
    "fault without word": ("run", FORWARD, "--fault", "uplink"),
    "fault of unknown kind": ("run", FORWARD, "--fault", "uplink tired @ 3 s"),
    "trace that is missing": ("run", FORWARD, "--set", "uplink=nowhere.csv"),
    "no runs": ("campaign", REST, "--runs", "0"),
    "spread of no path": (*CAMPAIGN, "--spread", "world.vehicle.mas=normal(1, 2)"),
    "spread of no kind": (*CAMPAIGN, "--spread", "world.vehicle.mass=weibull(1, 2)"),
    "spread without equals": (*CAMPAIGN, "--spread", "world.vehicle.mass"),
    "correlation too large": (*CAMPAIGN, "--correlate", "world.vehicle.mass,world.vehicle.inertia=1.5"),
    "metric of no kind": (*CAMPAIGN, "--metric", "speed:yaw_rate"),
    "metric of no signal": (*CAMPAIGN, "--metric", "final:altitude"),
    "success without sign": (*CAMPAIGN, "--success", "settling:yaw_rate"),
    "requirement without level": (*CAMPAIGN, "--require", "success"),
    "unknown sampling": (*CAMPAIGN, "--sampling", "dice"),
    "no such run": (*CAMPAIGN, "--rerun", "10"),
    "no gpu": (*CAMPAIGN, "--device", "gpu"),
    "axis without range": ("map", REST, "--x", "delay", "--y", "loss=0:0.9"),
    "axis twice": ("map", REST, "--x", "delay=0:1", "--y", "delay=0:1"),
    "too few runs to search": (*FALSIFY, "--success", "error_rms:yaw_rate <= 1", "--runs", "10"),
    "gain of no path": (*TUNE, "autopilot.law.k9=1:2"),
    "gain upside down": (*TUNE, "autopilot.law.k1=3:1"),
    "system of no name": ("design", "bicycle"),
    "certificate that is missing": ("design", "--check", "nowhere.json"),
    "certificate that is none": ("design", "--check", "empty.py"),
    "log that is missing": ("replay", "nowhere.mcap"),
    "log that is none": ("replay", "empty.py"),
    "noise of no log": ("calibrate", "noise", "nowhere.mcap"),
    "export to nowhere": ("export", REST),
    "export without board": ("export", REST, "--fly", "--out", "x"),
    "verify nothing": ("export", "--verify", "nowhere"),
    "study of no name": ("reproduce", "rocket1960"),
    "group of no name": ("reproduce", "hovercraft2006", "--only", "gravity"),
    "imperfection of no name": ("budget", REST, "--only", "gravity"),
    "line of no kind": ("fly", REST, "--link", "pigeon://here", "--unsigned"),
    "line without key": ("fly", REST, "--link", "udp://127.0.0.1:14999"),
    "line without signature": ("vehicle", REST, "--listen", "udp://0.0.0.0:14999", "--unsigned"),
    "load of no rate": ("link-test", "udp://127.0.0.1:14999", "--load", "fast"),
    "too few requests": ("link-test", "udp://127.0.0.1:14999", "--requests", "1"),
    "board of no name": ("firmware", REST, "--out", "board", "--board", "abacus"),
    "injected nothing": ("inject", FORWARD, "nothing", "--link", "udp://127.0.0.1:14999", "--unsigned"),
}
"""What is wrong -> words of the command."""

FILES = {"empty.py": '"""Nothing."""\n', "number.py": "def scenario():\n    return 3\n"}


def refused(folder: Path, wanted: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every input that can't be, with its exit code."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    for name, words in REFUSED.items():
        if wanted in name:
            done = call(*words, folder=folder, limit=120)
            yield name, {"same": {"exit": done.code, "out": done.printed}, "notes": done.err.splitlines()}
