"""Digests of arrays, logs and texts, with enough raw numbers beside them to tell what differs."""

import hashlib
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES = 9
"""Values of each signal that are written out: evenly spaced from the first to the last."""
COMMENTS = re.compile(r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
STAMP = "#define BUILD_STAMP "
"""How a line of C begins that says when the firmware was written."""
LONG = 400
"""Characters of a line of text that are written out."""


def digest(data: bytes) -> str:
    """First 16 hexadecimal digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def plain(value: Any) -> Any:
    """As JSON has it; numbers to the bit, by Python's shortest text."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    return [plain(v) for v in value] if isinstance(value, list | tuple) else value


def of_array(values: Any) -> dict[str, Any]:
    """Type, shape, digest of the bytes, and some values, the first and the last among them."""
    array = np.ascontiguousarray(values)
    found: dict[str, Any] = {"dtype": str(array.dtype), "shape": list(array.shape), "digest": digest(array.tobytes())}
    if array.ndim and len(array):
        at = np.unique(np.linspace(0, len(array) - 1, SAMPLES).round().astype(int))
        found["values"] = {f"row {k}": plain(array[k]) for k in at}
    else:
        found["values"] = plain(array)
    return found


def of_log(log: Any) -> dict[str, Any]:
    """A log of `simulate`: instants, every signal by its path, and the last state."""
    return {
        "rows": len(log),
        "ticks": of_array(log.ticks),
        "final": {path: plain(value) for path, value in log.final.items()},
        "signals": {path: of_array(log[path]) | {"unit": log.unit(path)} for path in log.paths},
    }


def of_settings(settings: dict[str, Any]) -> dict[str, Any]:
    """Parameters by path: as they are, long tables by their digest."""
    texts = {path: json.dumps(value) for path, value in settings.items()}
    return {path: settings[path] if len(text) < LONG else digest(text.encode()) for path, text in texts.items()}


def code_of(text: str) -> tuple[list[str], list[str]]:
    """The lines of C without comments and empty lines, and the comments."""
    comments: list[str] = []

    def without(found: "re.Match[str]") -> str:
        if found[0].startswith('"'):
            return found[0]
        comments.append(" ".join(found[0].split()))
        return " "

    lines = [" ".join(line.split()) for line in COMMENTS.sub(without, text).splitlines()]
    return [line for line in lines if line], comments


def of_file(file: Path) -> tuple[Any, Any]:
    """What must be equal in a file that was exported, and what may differ.

    Of C the text without comments must, and comments may; the line that holds the time of writing is left out. Of a
    README all may; a table is its digest and some rows; export.json goes without the number of the version.
    """
    text = file.read_text(encoding="utf-8")
    if file.suffix in (".c", ".h"):
        code, comments = code_of(text)
        return _lines([line for line in code if not line.startswith(STAMP)]), comments
    if file.suffix == ".md":
        return "", text.splitlines()
    if file.suffix == ".json":
        return {k: v for k, v in json.loads(text).items() if k != "version"}, ""
    if file.suffix == ".csv":
        return _table(text), ""
    return _lines(text.splitlines()), ""


def of_folder(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """`of_file` for every file below a folder, by its path in it."""
    same, notes = {}, {}
    for file in sorted(f for f in folder.rglob("*") if f.is_file()):
        same[str(file.relative_to(folder))], notes[str(file.relative_to(folder))] = of_file(file)
    return same, notes


def _lines(lines: list[str]) -> dict[str, Any]:
    return {"digest": digest("\n".join(lines).encode()), "lines": [_short(line) for line in lines]}


def _short(line: str) -> str:
    return line if len(line) <= LONG else f"{line[:LONG]} … {digest(line.encode())}"


def _table(text: str) -> dict[str, Any]:
    """The names of its columns, and numbers of some rows by column."""
    rows = text.splitlines()
    names = rows[0].split(",")
    at = sorted({1 + math.floor(k * (len(rows) - 2) / 4) for k in range(5)}) if len(rows) > 1 else []
    found = {f"row {k}": dict(zip(names, rows[k].split(","), strict=False)) for k in at}
    return {"digest": digest(text.encode()), "rows": len(rows) - 1, "columns": names, "values": found}
