"""Group `replay`: logs, kept as files, and what their replay says.

A log is recorded with the trimtab of that day into OUT/logs. Afterwards
`record.py OUT --only replay --logs BEFORE/logs` replays the old files with new code, and records its own once more:
the messages in them must be the same.
"""

import hashlib
import json
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command import both, call
from digest import digest, of_settings
from mcap.reader import make_reader

FLIGHTS = {
    "spin": ("hovercraft/spin", "--duration", "5", "--seed", "4"),
    "spin-jax": ("hovercraft/spin", "--duration", "2", "--backend", "jax"),
    "reverse-plain": ("hovercraft/reverse", "--duration", "3", "--without", "navigation-error"),
    "forward-measured": ("hovercraft/forward", "--duration", "4", "--set", "links=measured"),
    "forward-supervised": ("hovercraft/forward", "--duration", "4", "--set", "supervisor=automatic"),
    "forward-stuck": ("hovercraft/forward", "--duration", "3", "--fault", "sensor:navigation stuck @ 1 s for 1 s"),
    "forward-ins": ("hovercraft/forward", "--duration", "4", "--navigation", "ins"),
    "forward-coupled": ("hovercraft/forward", "--duration", "4", "--navigation", "ins-coupled"),
    "rest-heavy": ("hovercraft/zero-velocity", "--duration", "3", "--set", "world.vehicle.mass=3.2", "--run", "5"),
    "bang-bang": ("hovercraft/heading-bang-bang", "--duration", "4", "--set", "initial=rest"),
    "noise": ("hypersonic/noise", "--duration", "10", "--log-period", "5 ms"),
    "adaptive": ("hypersonic/noise", "--duration", "5", "--log-period", "5 ms", "--set", "filter=adaptive"),
    "encoder": ("navigation/platform-encoder", "--duration", "4"),
    "ranging": ("navigation/platform-ranging", "--duration", "3"),
}
"""Name of a log -> words after `trimtab run`."""

LOCKSTEP = {"lockstep-spin": "hovercraft/spin", "lockstep-rest": "hovercraft/zero-velocity"}
"""Name of a log -> scenario of a vehicle and an autopilot, two processes in step over a line."""

OTHERWISE = {
    "spin otherwise": ("spin", "--with", "law.spinning.k2=5"),
    "spin on jax": ("spin", "--backend", "jax"),
    "forward-ins otherwise": ("forward-ins", "--with", "estimator=ins-coupled"),
}
"""Replays that are not to the bit."""

TUNED = "tuned.py"
"""A scenario file that `trimtab tune` writes, kept beside the logs and flown again."""
TUNE = (
    *("tune", "hovercraft/zero-velocity", "--gain", "autopilot.law.k1=0.5:3", "--gain", "autopilot.law.k2=1:5"),
    *("--out", TUNED, "--iterations", "3", "--runs", "16", "--judge-runs", "32"),
)


def replay(folder: Path, wanted: str, logs: Path | None) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each log as recorded now, and each replay of the old ones, or of these where there are none."""
    own = folder.parent.parent / "logs"
    own.mkdir(parents=True, exist_ok=True)
    for name, words in FLIGHTS.items():
        if wanted in name:
            yield f"recorded {name}", _recorded(name, words, own, folder)
    for name, scenario in LOCKSTEP.items():
        if wanted in name:
            yield f"recorded {name}", _lockstep(name, scenario, own, folder)
    old = (logs or own).resolve()
    for name in [n for n in (*FLIGHTS, *LOCKSTEP) if wanted in n]:
        yield f"replayed {name}", _replayed((str(old / f"{name}.mcap"),), folder)
    for name, (log, *words) in OTHERWISE.items():
        if wanted in name:
            yield f"replayed {name}", _replayed((str(old / f"{log}.mcap"), *words), folder)
    if wanted in "scenario file":
        yield "scenario file", _scenario_file(own, old, folder)
    kept = Path(__file__).parent / "old-log.mcap"
    if kept.exists() and wanted in "old-log":
        yield "replayed old-log", _replayed((str(kept),), folder)


def contents(file: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Messages of a log by topic, and its settings; when it was made, classes of its parts and words may differ."""
    hashes: dict[str, Any] = {}
    rows: dict[str, int] = {}
    last: dict[str, Any] = {}
    about: dict[str, str] = {}
    with file.open("rb") as stream:
        reader = make_reader(stream)
        for _, channel, message in reader.iter_messages():
            given = hashes.setdefault(channel.topic, hashlib.sha256())
            given.update(message.log_time.to_bytes(8, "little") + message.data)
            rows[channel.topic] = rows.get(channel.topic, 0) + 1
            last[channel.topic] = message.data
        for found in reader.iter_metadata():
            about |= found.metadata
    topics = {t: {"rows": rows[t], "digest": hashes[t].hexdigest()[:16], "last": json.loads(last[t])} for t in hashes}
    settings = of_settings(json.loads(about.pop("parameters", "{}")))
    notes = {k: about.pop(k, None) for k in ("parts", "version", "machine", "declared", "started", "choices")}
    return {"topics": topics, "settings": settings, "about": {k: digest(v.encode()) for k, v in about.items()}}, notes


def _recorded(name: str, words: tuple[str, ...], own: Path, folder: Path) -> dict[str, Any]:
    done = call("run", *words, "--no-ideal", "--out", name, "--json", folder=folder)
    return _kept(folder / name / "run.mcap", own / f"{name}.mcap", {"exit": done.code, "json": done.printed}, done.err)


def _lockstep(name: str, scenario: str, own: Path, folder: Path) -> dict[str, Any]:
    for side in ("there", "here"):  # a log that is there is never written over
        shutil.rmtree(folder / f"{name}-{side}", ignore_errors=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    how = ("--lockstep", "--unsigned", "--duration", "2", "--json", "--seed", "4")
    there = ("vehicle", scenario, "--listen", f"udp://127.0.0.1:{port}", *how, "--out", f"{name}-there")
    here = ("fly", scenario, "--link", f"udp://127.0.0.1:{port}", *how, "--out", f"{name}-here")
    one, other = both(there, here, folder=folder, ready="waits on")
    same = {"exit": [one.code, other.code], "vehicle": one.printed, "fly": other.printed}
    file = folder / f"{name}-there" / "vehicle.mcap"
    if file.exists():
        same["vehicle's log"] = contents(file)[0]
    return _kept(folder / f"{name}-here" / "flight.mcap", own / f"{name}.mcap", same, one.err + other.err)


def _scenario_file(own: Path, old: Path, folder: Path) -> dict[str, Any]:
    """What flies in a file that was written before; a note, for such files name modules of the package."""
    written = call(*TUNE, "--json", folder=own)
    done = call("run", f"{old / TUNED}:scenario", "--duration", "3", "--json", folder=folder)
    printed = done.printed or {}
    printed.pop("scenario", None)
    return {"same": {"exit": written.code}, "notes": {"exit": done.code, "json": printed, "said": done.err}}


def _kept(file: Path, kept: Path, same: dict[str, Any], said: str) -> dict[str, Any]:
    """Move a log to where it is kept; what it holds is compared."""
    notes: dict[str, Any] = {"said": said}
    if file.exists():
        file.replace(kept)
        same["log"], notes["log"] = contents(kept)
    if isinstance(same.get("fly"), dict) and same["fly"].get("log"):
        same["fly"]["log"].pop("size", None)  # grows with the names of classes in it
    return {"same": same, "notes": notes}


def _replayed(words: tuple[str, ...], folder: Path) -> dict[str, Any]:
    done = call("replay", *words, "--json", folder=folder)
    return {"same": {"exit": done.code, "json": done.printed}, "notes": done.err}
