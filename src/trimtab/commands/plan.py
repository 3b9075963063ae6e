"""Plans: what a compiled run needs, kept on disk, so that the same run again starts without importing JAX.

A plan is found again only where everything it was made from is unchanged: the request, the interpreter, the packages
installed beside it, every file of trimtab, and the user's own files by their contents. What a scenario takes from the
clock, the network or the environment's variables is not seen. Nothing here raises: trouble means that there is no plan.

Importing this brings neither JAX nor numpy along. Import it, and ask, before a scenario is loaded: a file that was
changed later than that may be newer than what was loaded from it, and then the plan is not kept.
"""

import functools
import hashlib
import json
import os
import stat
import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.commands.sources import SITES, fingerprint, is_settled, list_package_files, sha256
from trimtab.core.cache_folder import cache_folder, is_owned_by_user

FORMAT = b"trimtab plan 1\n"
"""First line of a file; a plan of another format is treated as absent."""
SUFFIX, PARTIAL_SUFFIX = ".plan", ".part"
MOST = 200
"""How many plans are kept; beyond, the oldest go."""
_search_paths: dict[str, list[Any]] = {}
"""Where the process was when it asked for a plan: before it loaded anything that may change that."""


class CachedRun(NamedTuple):
    """A compiled run. content: plain JSON (text keys, lists, no tuples); arrays: numpy arrays of numbers, by name."""

    content: dict[str, Any]
    arrays: dict[str, Any]


def find_run(request_key: Mapping[str, Any]) -> CachedRun | None:
    """The plan kept for a request, or None where there is none, or what it was made from has changed.

    Args:
        request_key: plain JSON that decides the program: scenario, settings, duration, kind of CPU, …; what only
            changes its inputs (the seed) or what is done with the result stays out.
    """
    with suppress(Exception):
        name = _cache_name(request_key)
        _search_paths[name] = _search_path()
        about, plan = _unpack_run(_read_bytes(cache_folder("plans") / (name + SUFFIX)))
        if about["key"] == name and _is_unchanged(about, _search_paths[name]):
            return plan
    return None


def keep_run(request_key: Mapping[str, Any], plan: CachedRun, files: Iterable[str | os.PathLike[str]]) -> bool:
    """Keep a plan for a request that `find_run` was asked for before; whether that was done.

    Args:
        request_key: as for `find_run`.
        plan: what to keep.
        files: the user's files that it was made from: `sources.loaded_files()`, and what `sources.files_read()` saw.
    """
    with suppress(Exception):
        folder, name = cache_folder("plans"), _cache_name(request_key)
        paths = sorted({os.path.abspath(file) for file in files})
        if name not in _search_paths or not all(map(is_settled, [*list_package_files(), *paths])):
            return False
        about = {"key": name, "files": {p: sha256(p) for p in paths}, "place": _search_paths[name]}
        _write_private(folder / (name + SUFFIX), _pack_run(about, plan))
        _prune_cache(folder)
        return True
    return False


@functools.cache
def _environment() -> tuple[str, ...]:
    """The interpreter, what is installed (name, version, time of installation), and trimtab's contents.

    For numpy and JAX it says what importlib.metadata would, whose import alone takes 20 ms; and it takes in whatever
    else the user's files may import, also when it was installed again under the same version.
    """
    sites = [p for p in sys.path if os.path.basename(p) in SITES and os.path.isdir(p)]
    inside = [f for site in sites for f in os.scandir(site) if f.name.endswith((".dist-info", ".egg-info", ".pth"))]
    installed = sorted(f"{f.name} {f.stat().st_mtime_ns}" for f in inside)
    return sys.version, *installed, fingerprint(list_package_files())


def _cache_name(request_key: Mapping[str, Any]) -> str:
    """The name under which a request's plan is kept."""
    text = json.dumps([request_key, _environment()], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _search_path() -> list[Any]:
    """Where a name such as ``boat.py:scenario`` is looked for."""
    return [os.getcwd(), *sys.path]


def _is_unchanged(about: Mapping[str, Any], place: list[Any]) -> bool:
    """Whether the user's files are as they were, and would be found at the same place again."""
    files = about["files"]
    return not files or (about["place"] == place and all(sha256(p) == files[p] for p in files))


def _read_bytes(path: Path) -> bytes:
    with open(path, "rb") as stream:
        about = os.fstat(stream.fileno())
        return stream.read() if is_owned_by_user(about) and stat.S_ISREG(about.st_mode) else b""


def _write_private(path: Path, data: bytes) -> None:
    """A file that appears whole or not at all, and that nobody else can read."""
    beside = path.with_suffix(f".{os.urandom(8).hex()}{PARTIAL_SUFFIX}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    try:
        with os.fdopen(os.open(beside, flags, 0o600), "wb") as stream:
            stream.write(data)
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def _prune_cache(folder: Path) -> None:
    """Remove the oldest plans beyond the limit, and what a killed program left behind an hour ago."""
    ages = sorted((f.stat().st_mtime, f) for f in folder.iterdir() if f.suffix in (SUFFIX, PARTIAL_SUFFIX))
    plans = [f for _, f in ages if f.suffix == SUFFIX]
    left = [f for age, f in ages if f.suffix == PARTIAL_SUFFIX and age < time.time() - 3600]
    for file in [*plans[: max(0, len(plans) - MOST)], *left]:
        file.unlink(missing_ok=True)


def _pack_run(about: Mapping[str, Any], plan: CachedRun) -> bytes:
    """Format, SHA-256 of the rest, length of the JSON text, the text, and the arrays one after the other as .npy."""
    import numpy as np

    held = {**about, "content": plan.content, "arrays": list(plan.arrays)}
    text = json.dumps(held).encode()
    if repr(json.loads(text)) != repr(held):
        raise TypeError("would come back changed: tuples, keys that are no text, numbers of numpy's types")
    stream = BytesIO()
    stream.write(len(text).to_bytes(8, "little") + text)
    for array in plan.arrays.values():
        np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)
    body = stream.getvalue()
    return FORMAT + hashlib.sha256(body).digest() + body


def _unpack_run(data: bytes) -> tuple[dict[str, Any], CachedRun]:
    """What was packed; raises ValueError, KeyError or TypeError for anything else."""
    start = len(FORMAT) + 32
    if data[: len(FORMAT)] != FORMAT or hashlib.sha256(data[start:]).digest() != data[len(FORMAT) : start]:
        raise ValueError("not a whole plan of this format")
    import numpy as np

    stream = BytesIO(data[start:])
    about = json.loads(stream.read(int.from_bytes(stream.read(8), "little")))
    arrays = {name: np.lib.format.read_array(stream, allow_pickle=False) for name in about["arrays"]}
    if stream.read(1):
        raise ValueError("more than a plan")
    return about, CachedRun(about["content"], arrays)
