"""Files of a store: how they are named, made, and seen onto the disk."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError

DONE = "done"
LOCK = ".lock"
PARTIAL = ".partial"
"""Ends the names under which Zarr writes before it renames."""


def key_of(name: str) -> str:
    """The name of a column's array: slashes of a path of a file would make groups."""
    return name.replace("/", "|")


def begun(folder: Path) -> bool:
    """Whether a store is there, and not only what is left of a process that was killed while it made one.

    Raises: InputError for a folder of something else.
    """
    about = folder / "zarr.json"
    files = [f for f in folder.rglob("*") if f.is_file() and f.name != LOCK and f.suffix != PARTIAL]
    if all(f.name == "zarr.json" for f in files):
        return about.exists() and bool(about.read_text()) and bool(json.loads(about.read_text()).get("attributes"))
    if not about.exists():
        fix = "name another store: --store NAME.zarr"
        raise InputError(f"store {str(folder)!r}", "is a folder with other things in it", fix=fix)
    return True


def made(zarr: Any, folder: Path, columns: Mapping[str, Any], runs: int, block: int) -> Any:
    """The group of a new store, over what a process left that was killed while it made it."""
    from zarr.codecs import ZstdCodec

    group = zarr.open_group(folder, mode="a")
    packed: dict[str, Any] = {"compressors": [ZstdCodec(level=0, checksum=True)], "overwrite": True}
    for name, example in {**columns, DONE: np.zeros(0, bool)}.items():
        kind = np.asarray(example).dtype
        group.create_array(key_of(name), shape=(runs,), chunks=(block,), dtype=kind, fill_value=kind.type(0), **packed)
    return group


def described(folder: Path) -> None:
    """See the descriptions of the group and of its arrays onto the disk."""
    for description in [*folder.glob("*/zarr.json"), folder / "zarr.json"]:
        reach_disk(description)


def reach_disk(file: Path) -> None:
    """Return when a file and its name are on the disk."""
    for place in (file, file.parent):
        handle = os.open(place, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
