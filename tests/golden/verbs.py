"""Groups `json` and `studies`: what every verb of the command line prints with --json, and its exit code.

Commands are given in order and share a folder, so that a later one can read what an earlier one wrote. What they print
without --json, and what they say on standard error, is kept as a note: words may change.
"""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command import both, call, skeleton

REST, SPIN, FORWARD, NOISE = "hovercraft/zero-velocity", "hovercraft/spin", "hovercraft/forward", "hypersonic/noise"
MASS = ("--spread", "world.vehicle.mass=normal(100%, 5%)")
GAIN = ("--spread", "autopilot.law.k2=uniform(80%, 120%)")
BOUNDS = ("--spread", "world.vehicle.mass=uniform(80%, 120%)", "--spread", "autopilot.law.k2=uniform(50%, 200%)")
LINK = ("--x", "delay=0:0.6", "--y", "loss=0:0.9", "--success", "error_rms:yaw_rate <= 0.6")

VERBS: dict[str, tuple[str, ...]] = {
    "list": ("list",),
    "run spin": ("run", SPIN, "--duration", "5", "--seed", "3"),
    "run spin again": ("run", SPIN, "--duration", "5", "--seed", "3"),
    "run spin set": ("run", SPIN, "--set", "autopilot.law.spinning.k2=5", "--set", "world.vehicle.mass=3.2"),
    "run spin without": ("run", SPIN, "--without", "navigation-error", "--no-ideal", "--run", "7"),
    "run ins": ("run", REST, "--navigation", "ins", "--duration", "5"),
    "run faults": ("run", FORWARD, "--fault", "uplink off @ 2 s for 2 s", "--fault", "sensor:navigation off @ 6 s"),
    "run imu fault": ("run", FORWARD, "--navigation", "ins", "--fault", "sensor:imu garbage @ 3 s for 1 s"),
    "run actuators fault": ("run", FORWARD, "--fault", "actuators wrong by -2 @ 1 s for 500 ms"),
    "run jax": ("run", REST, "--backend", "jax", "--duration", "5"),
    "run noise": ("run", NOISE, "--duration", "10"),
    "run picture": ("run", REST, "--duration", "3", "--plot", "rest.png"),
    "run still": ("run", "navigation/still", "--out", "still"),
    "calibrate noise": ("calibrate", "noise", "still/run.mcap", "--out", "allan"),
    "calibrate one": ("calibrate", "noise", "still/run.mcap", "--signal", "sensors.imu.value.angular_rate"),
    "budget": ("budget", SPIN, "--runs", "2", "--seed", "1"),
    "budget only": ("budget", FORWARD, "--navigation", "ins", "--runs", "2", "--only", "imu-noise"),
    "campaign store": ("campaign", REST, *MASS, "--runs", "100", "--store", "mass.zarr"),
    "campaign more": ("campaign", REST, *MASS, "--runs", "200", "--store", "mass.zarr"),
    "campaign rerun": ("campaign", REST, *MASS, "--runs", "200", "--store", "mass.zarr", "--rerun", "12"),
    "campaign saltelli": (
        *("campaign", REST, *MASS, *GAIN, "--sampling", "saltelli"),
        *("--runs", "256", "--out", "matters"),
    ),
    "campaign morris": ("campaign", REST, *MASS, *GAIN, "--sampling", "morris", "--runs", "60"),
    "campaign latin": (
        *("campaign", REST, *MASS, *GAIN, "--sampling", "latin"),
        *("--runs", "64", "--success", "error_rms:yaw_rate <= 0.3"),
    ),
    "map": ("map", REST, *LINK, "--runs", "2", "--depth", "1"),
    "map jitter": ("map", FORWARD, "--x", "delay=0:0.4", "--y", "jitter=0:0.4", "--runs", "2", "--depth", "0"),
    "map gains": (
        *("map", REST, "--x", "world.vehicle.mass=1:5:3", "--y", "autopilot.law.k2=50%:400%:3"),
        *("--success", "error_rms:yaw_rate <= 0.4", "--runs", "2", "--depth", "1"),
    ),
    "falsify": (
        *("falsify", REST, *BOUNDS, "--success", "error_rms:yaw_rate <= 0.5"),
        *("--runs", "1000", "--out", "worst.py"),
    ),
    "run worst": ("run", "worst.py:scenario"),
    "falsify nothing": ("falsify", REST, *BOUNDS, "--success", "error_rms:yaw_rate <= 50", "--runs", "1000"),
    "tune search": (
        *("tune", REST, "--gain", "autopilot.law.k1=0.5:3", "--gain", "autopilot.law.k2=1:5", "--out", "tuned.py"),
        *("--iterations", "3", "--runs", "16", "--judge-runs", "32"),
    ),
    "run tuned": ("run", "tuned.py:scenario"),
    "tune gradient": (
        *("tune", REST, "--gain", "autopilot.law.k2=1:5", "--method", "gradient"),
        *("--iterations", "3", "--runs", "8", "--judge-runs", "16"),
    ),
    "design": ("design", "hypersonic", "--out", "gain.json"),
    "design check": ("design", "--check", "gain.json"),
    "design check model": ("design", "hypersonic", "--check", "gain.json"),
    "design printed": ("design", "hypersonic", "--filter", "printed"),
    "design integral": ("design", "hypersonic", "--integral"),
    "design lmi": ("design", "hypersonic", "--method", "lmi"),
    "export": ("export", SPIN, "--steps", "300", "--out", "autopilot"),
    "export verify": ("export", "--verify", "autopilot"),
    "export board": ("export", SPIN, "--target", "cortex-m7", "--fly", "--steps", "50"),
    "reproduce": ("reproduce",),
}
"""Name -> words before --json."""

HELP = (
    *("", "run", "list", "budget", "campaign", "map", "falsify", "tune", "design", "calibrate", "calibrate noise"),
    *("demo", "export", "firmware", "fly", "vehicle", "inject", "link-test", "live-faults", "replay", "reproduce"),
)

STUDIES = {
    "hovercraft2006": (
        *("control-laws", "stabilisability", "rudder-and-thrust", "inertia", "radio-links", "ultrasonic-cone"),
        *("simulated-autopilot", "simulated-heading", "heading-filter"),
        *("velocity-position-filter", "gyro-compensation", "gyro-square-wave"),
        "hardware-flights",
    ),
    "hypersonic2022": (
        *("trim-and-model", "exact-linearisation", "internal-dynamics", "filter", "printed-matrices", "printed-gain"),
        *("gains", "closed-loop", "closed-loop-disturbances", "closed-loop-mismatch", "closed-loop-noise"),
    ),
}
"""Study -> groups of figures that take less than half a minute."""


def verbs(folder: Path, wanted: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every verb; the settings of every scenario; every --help; a line measured on this machine."""
    if wanted in "list of each":
        listed = call("list", "--json", folder=folder).printed
        for name in listed["scenarios"]:
            yield f"list {name}", _said(("list", name), folder)
    for name, words in VERBS.items():
        if wanted in name:
            yield name, _said(words, folder)
    for verb in HELP:
        if wanted in f"help {verb}":
            done = call(*verb.split(), "--help", folder=folder)
            yield f"help {verb}", {"same": {"exit": done.code}, "notes": done.out.splitlines()}
    if wanted in "link-test":
        yield "link-test", _line(folder)


def studies(folder: Path, wanted: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Figures of publications, computed again."""
    for study, groups in STUDIES.items():
        for group in [g for g in groups if wanted in f"{study} {g}"]:
            yield f"{study} {group}", _said(("reproduce", study, "--only", group), folder)


def _said(words: tuple[str, ...], folder: Path) -> dict[str, Any]:
    before = _files(folder)
    done = call(*words, "--json", folder=folder)
    made = sorted(_files(folder) - before)
    return {"same": {"exit": done.code, "json": done.printed, "made": made}, "notes": done.err}


def _files(folder: Path) -> set[str]:
    """Below a folder, but keys and the insides of stores."""
    found = {str(f.relative_to(folder)) for f in folder.rglob("*") if f.is_file()}
    return {f for f in found if not f.startswith("config") and ".zarr" not in f}


def _line(folder: Path) -> dict[str, Any]:
    """Delays are this machine's own: only which figures there are, and the counts, are compared."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        uri = f"udp://127.0.0.1:{probe.getsockname()[1]}"
    words = ("link-test", uri, "--load", "2.9/22.0", "--requests", "20", "--rate", "50", "--json")
    one, other = both(("link-test", uri, "--echo"), words, folder=folder, ready="echoing on")
    return {"same": {"exit": [one.code, other.code], "json": skeleton(other.printed)}, "notes": one.err}
