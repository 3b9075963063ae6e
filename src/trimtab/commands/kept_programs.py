"""Cache of compiled programs: a catalogue scenario that was flown before starts without importing JAX.

The data that a flight in C needs besides its library is stored under the SHA-256 of the request, the package's files,
the interpreter, the installed packages and the CPU, so a program is found again only if all of these are unchanged. A
user's own scenario, or a setting that names a file, is never cached, because a file name does not identify the file's
content. Nothing here raises: without a cache folder nothing is stored, and every run compiles again.
"""

import dataclasses
import functools
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import trimtab
from trimtab.compiler.native.cache import find_library, read_private_file, write_atomically
from trimtab.compiler.native.compiler import cpu_identity
from trimtab.core.cache_folder import cache_folder
from trimtab.core.quantity import Quantity
from trimtab.logs.log import to_plain
from trimtab.logs.metrics import Target
from trimtab.run.program import Column, Program

FOLDER = "programs"
LIMIT = 200
"""Maximum number of cached runs; beyond it, the oldest are deleted."""


class RunPrograms(NamedTuple):
    """Data of `trimtab run`: the scenario's name, the real and the ideal program, and the targets."""

    name: str
    real: Program
    ideal: Program | None
    targets: tuple[Target, ...]


def program_key(
    scenario: str, settings: Mapping[str, str], without: Iterable[str], faults: Iterable[str], ideal: bool
) -> str | None:
    """Return the cache key of a run's programs; None if its scenario or a setting is a user's file."""
    if ":" in scenario or scenario.endswith(".fmu") or any(os.path.exists(value) for value in settings.values()):
        return None
    request = [scenario, dict(settings), list(without), list(faults), ideal]
    text = json.dumps([request, *describe_installation(), cpu_identity()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def load_programs(key: str) -> RunPrograms | None:
    """Return the programs of this key, or None if they are missing or a library is missing or damaged."""
    try:
        data = read_private_file(cache_folder(FOLDER) / f"{key}.json") or b""
    except OSError:
        return None
    checksum, _, text = data.partition(b"\n")
    if checksum.decode("ascii", "replace") != hashlib.sha256(text).hexdigest():
        return None
    content = json.loads(text)
    real, ideal = _program_from_json(content["real"]), _program_from_json(content["ideal"])
    if real is None or (ideal is None and content["ideal"] is not None):
        return None
    return RunPrograms(content["name"], real, ideal, tuple(Target(*target) for target in content["targets"]))


def store_programs(key: str, programs: RunPrograms) -> None:
    """Store the programs of a run for the next time."""
    content = {
        "name": programs.name,
        "real": _program_json(programs.real),
        "ideal": None if programs.ideal is None else _program_json(programs.ideal),
        "targets": [[t.path, float(t.value), float(t.band)] for t in programs.targets],
    }
    text = json.dumps(content)
    with suppress(OSError):
        folder = cache_folder(FOLDER)
        write_atomically(folder / f"{key}.json", f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")
        for old in sorted(folder.glob("*.json"), key=lambda file: file.stat().st_mtime)[:-LIMIT]:
            old.unlink(missing_ok=True)


def enable_cache() -> None:
    """Enable JAX's compilation cache in the cache's folder `jax`; do nothing if the folder is not writable."""
    import jax

    try:
        folder = cache_folder("jax")
    except OSError:
        return
    if not os.access(folder, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


@functools.cache
def describe_installation() -> tuple[str, list[str], str]:
    """Return the interpreter, the installed packages with versions, and a SHA-256 of all files of trimtab."""
    folders = [folder for folder in sys.path if os.path.isdir(folder)]
    names = [name for folder in folders for name in os.listdir(folder) if name.endswith((".dist-info", ".egg-info"))]
    package, digest = Path(trimtab.__file__).parent, hashlib.sha256()
    for file in sorted(package.rglob("[!.]*")):
        if file.suffix != ".pyc" and file.is_file():
            digest.update(f"{file.relative_to(package)} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return sys.version, sorted(names), digest.hexdigest()


def _program_json(program: Program) -> dict[str, Any]:
    about = program._asdict() | {
        "library": program.library.stem,
        "shared_inputs": np.asarray(program.shared_inputs, np.float64).tobytes().hex(),
        "columns": [_column_json(column) for column in program.columns],
        "final": [_column_json(column) for column in program.final],
    }
    return to_plain("program", about)


def _column_json(column: Column) -> list[Any]:
    declared = None if column.declaration is None else dataclasses.asdict(column.declaration)
    return [column.path, column.shape, column.dtype, declared]


def _program_from_json(content: dict[str, Any] | None) -> Program | None:
    library = None if content is None else find_library(content["library"])
    if content is None or library is None:
        return None
    fields = content | {
        "library": library,
        "shared_inputs": np.frombuffer(bytes.fromhex(content["shared_inputs"])),
        "words": tuple(content["words"]),
        "periods": tuple(content["periods"]),
        "noise": tuple(content["noise"]),
        "columns": [_column_from_json(*column) for column in content["columns"]],
        "final": [_column_from_json(*column) for column in content["final"]],
    }
    return Program(**fields)


def _column_from_json(path: str, shape: list[int], dtype: str, declared: dict[str, Any] | None) -> Column:
    if declared is None:
        return Column(path, tuple(shape), dtype)
    declared |= {"modes": tuple(declared["modes"]), "shape": tuple(declared["shape"])}
    return Column(path, tuple(shape), dtype, Quantity(**declared))
