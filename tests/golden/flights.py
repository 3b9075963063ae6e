"""Groups `runs`, `jax` and `variants`: every scenario of the catalogue, flown.

runs: in C, with its imperfections and ideal, seeds 0, 1 and 2, whole logs.
jax: the same on JAX. Durations are cut to SHORT_S where a scenario is in `LONG`.
variants: in C, every choice that is not a scenario's first, one at a time, seed 0; in one scenario of each folder.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command import call
from digest import of_log, of_settings

import trimtab

SEEDS = (0, 1, 2)
SHORT_S = 20
LONG: tuple[str, ...] = ()
"""Scenarios that fly SHORT_S seconds on JAX."""

Entry = tuple[str, dict[str, Any]]


def names(folder: Path) -> list[str]:
    """Every scenario, as `trimtab list` has them."""
    return list(json.loads(call("list", "--json", folder=folder).out)["scenarios"])


def choices(name: str, folder: Path) -> dict[str, list[str]]:
    """What can be chosen in a scenario, the first of each being what it does by itself."""
    return json.loads(call("list", name, "--json", folder=folder).out)["choices"]


def runs(folder: Path, wanted: str) -> Iterator[Entry]:
    """Ideal and real, in C."""
    for name in [n for n in names(folder) if wanted in n]:
        yield name, _flown(name, "c", None)


def jax(folder: Path, wanted: str) -> Iterator[Entry]:
    """Ideal and real, on JAX."""
    for name in [n for n in names(folder) if wanted in n]:
        yield name, _flown(name, "jax", trimtab.seconds(SHORT_S) if name in LONG else None)
        _forget()


def variants(folder: Path, wanted: str) -> Iterator[Entry]:
    """One choice other than usual, in C."""
    flown: set[tuple[str, str, str]] = set()
    for name in names(folder):
        for what, offered in choices(name, folder).items():
            for choice in offered[1:]:
                which = name.partition("/")[0], what, choice
                if which not in flown and wanted in f"{name} {what}={choice}":
                    yield f"{name} {what}={choice}", _chosen(name, {what: choice})
                flown.add(which)
        _forget()


def _forget() -> None:
    """Compiled programs of one scenario are of no use to the next, and take gigabytes in the end."""
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()


def _flown(name: str, backend: str, duration: int | None) -> dict[str, Any]:
    scenario = trimtab.build(name)
    same: dict[str, Any] = {}
    notes: dict[str, Any] = {}
    for kind, flies in (("real", scenario), ("ideal", scenario.ideal())):
        for seed in SEEDS:
            log = trimtab.simulate(flies, seed=seed, duration=duration, backend=backend)
            same[f"{kind} seed {seed}"] = of_log(log)
        same[f"{kind} about"], notes[kind] = _about(log)
    return {"same": same, "notes": notes}


def _about(log: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings, which must be equal; names of classes and the order of the signals, which may differ."""
    of = log.metadata
    same = {"duration_s": of["duration_s"], "backend": of["backend"], "settings": of_settings(of["parameters"])}
    return same, {"parts": of.get("parts"), "order": list(log.paths)}


def _chosen(name: str, settings: dict[str, str]) -> dict[str, Any]:
    try:
        log = trimtab.simulate(trimtab.build(name, settings), backend="c")
    except trimtab.InputError as error:
        return {"same": "refused", "notes": str(error)}
    same, notes = _about(log)
    return {"same": {"seed 0": of_log(log), "about": same}, "notes": notes}
