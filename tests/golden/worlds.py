"""Group `campaign`: thousands of worlds, row by row, and batches over lanes and threads."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from command import call
from digest import of_array, plain

import trimtab

MASS = {"world.vehicle.mass": "normal(100%, 5%)", "autopilot.law.k2": "uniform(80%, 120%)"}
METRICS = ("settling:yaw_rate", "error_rms:yaw_rate", "overshoot:yaw_rate", "final:yaw_rate", "tail_rms:surge_velocity")
CAMPAIGNS: dict[str, tuple[str, dict[str, Any], str]] = {
    "zero-velocity": ("hovercraft/zero-velocity", {"runs": 1000, "seed": 7, "spread": MASS, "metrics": METRICS}, "c"),
    "zero-velocity sobol": ("hovercraft/zero-velocity", {"runs": 256, "spread": MASS, "sampling": "sobol"}, "c"),
    "zero-velocity jax": ("hovercraft/zero-velocity", {"runs": 64, "seed": 7, "spread": MASS}, "jax"),
    "spin plain": ("hovercraft/spin", {"runs": 1000, "seed": 1}, "c"),
    "forward ins": (
        "hovercraft/forward",
        {
            "runs": 200,
            "settings": {"navigation": "ins", "duration": "5"},
            "spread": {
                "world.vehicle.mass": "truncated(100%, 5%, 90%, 110%)",
                "world.vehicle.inertia": "lognormal(0.096, 0.1)",
            },
            "correlate": {("world.vehicle.mass", "world.vehicle.inertia"): 0.8},
            "faults": ("sensor:imu off @ 2 s for 500 ms",),
            "success": ("error_rms:surge_velocity <= 0.3",),
        },
        "c",
    ),
    "noise": (
        "hypersonic/noise",
        {"runs": 100, "settings": {"duration": "20"}, "spread": {"world.vehicle.modes.w1": "uniform(90%, 110%)"}},
        "c",
    ),
}
"""Name -> scenario, arguments of `Campaign`, backend."""

TOLD = {
    "told met": ("hovercraft/zero-velocity", "--require", "success >= 0.5 @ 95%"),
    "told missed": ("hovercraft/zero-velocity", "--require", "success >= 0.99 @ 95%"),
    "told stopped": ("hovercraft/zero-velocity", "--stop", "width(success) <= 0.2 @ 95%"),
}
"""Name -> words after `trimtab campaign`."""


def campaign(folder: Path, wanted: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Rows by column, success, and what the command line says of them."""
    made: dict[str, Callable[[], dict[str, Any]]] = {n: lambda n=n: _flown(*CAMPAIGNS[n]) for n in CAMPAIGNS}
    made |= {n: lambda n=n: _told(TOLD[n], folder) for n in TOLD}
    made |= {f"batch {backend}": lambda backend=backend: _batch(backend) for backend in ("c", "jax")}
    for name in [n for n in made if wanted in n]:
        yield name, made[name]()


def _flown(scenario: str, arguments: dict[str, Any], backend: str) -> dict[str, Any]:
    found = trimtab.Campaign(scenario, **arguments).run(backend=backend, threads=1)
    success = found.success
    same = {
        "columns": {name: of_array(column) for name, column in found.columns.items()},
        "success": plain([success.share, success.low, success.high, success.level]),
        "flown": getattr(found, "flown_runs", None) or found.flown,
    }
    return {"same": same, "notes": {"identity": found.identity, "order": list(found.columns)}}


def _told(words: tuple[str, ...], folder: Path) -> dict[str, Any]:
    spread = [text for path, drawn in MASS.items() for text in ("--spread", f"{path}={drawn}")]
    more = ("--runs", "1000", "--seed", "3", "--threads", "1", "--json")
    done = call("campaign", *words, *spread, *more, folder=folder)
    return {"same": {"exit": done.code, "json": done.printed}, "notes": done.err}


def _batch(backend: str) -> dict[str, Any]:
    """Enough runs for lanes, with a parameter that differs, and the log of every run."""
    runs = 70
    found = trimtab.simulate_batch(
        trimtab.build("hovercraft/spin"),
        seeds=range(runs),
        spread={"world.vehicle.mass": np.linspace(2.0, 3.2, runs)},
        duration=trimtab.seconds(4),
        log=True,
        backend=backend,
        threads=1,
    )
    kinds = ("log", "least", "most", "mean", "rms", "final")
    same: dict[str, Any] = {k: {p: of_array(v) for p, v in getattr(found, k).items()} for k in kinds}
    return {"same": same | {"ticks": of_array(found.ticks), "backend": found.backend}, "notes": {}}
