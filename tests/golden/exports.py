"""Group `export`: autopilots, whole loops and a vehicle's firmware as C, text by text."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command import call
from digest import of_folder

EXPORTS = {
    "spin double": ("hovercraft/spin",),
    "spin single": ("hovercraft/spin", "--float", "single"),
    "spin loop": ("hovercraft/spin", "--part", "loop", "--steps", "500"),
    "zero-velocity double": ("hovercraft/zero-velocity", "--seed", "3"),
    "zero-velocity single": ("hovercraft/zero-velocity", "--float", "single"),
    "noise double": ("hypersonic/noise",),
    "noise single": ("hypersonic/noise", "--float", "single"),
    "noise loop": ("hypersonic/noise", "--part", "loop", "--steps", "200"),
    "forward coupled": ("hovercraft/forward", "--set", "navigation=ins-coupled", "--steps", "500"),
    "forward supervised": ("hovercraft/forward", "--set", "supervisor=automatic", "--steps", "500"),
    "bang-bang cortex-m4": ("hovercraft/heading-bang-bang", "--target", "cortex-m4", "--fly", "--steps", "200"),
}
PASSPHRASE = "0123456789abcdef0123456789abcdef"
"""Of the line that the firmware is for; it stands in the text."""


def export(folder: Path, wanted: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every export: the exit code, what was printed, and the files."""
    for name, words in EXPORTS.items():
        if wanted in name:
            out = name.replace(" ", "-")
            yield name, _written(("export", *words, "--out", out, "--json"), out, folder)
    if wanted in "firmware":
        folder.mkdir(parents=True, exist_ok=True)
        key = folder / "line.key"
        key.touch(mode=0o600)
        key.write_text(PASSPHRASE + "\n")
        words = ("firmware", "hovercraft/forward", "--out", "board", "--key", key.name, "--json")
        yield "firmware", _written(words, "board", folder)


def _written(words: tuple[str, ...], out: str, folder: Path) -> dict[str, Any]:
    done = call(*words, folder=folder)
    same, notes = of_folder(folder / out)
    printed = {"exit": done.code, "json": done.printed}
    return {"same": printed | {"files": same}, "notes": {"files": notes, "said": done.err}}
