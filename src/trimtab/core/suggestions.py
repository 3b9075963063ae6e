"""Suggestions after a misspelt name: the nearest scenario, setting, option, member or file.

Source: docs page, Troubleshooting.
"""

from collections.abc import Iterable
from typing import Any

from trimtab.core.errors import InputError, argument, argument_name, command


def missing_member(owner: Any, name: str, write: str) -> AttributeError:
    """Return the error for a missing attribute of an object. write: text to write instead, or ""."""
    if name.startswith("_"):
        return AttributeError(f"{type(owner).__name__!r} object has no attribute {name!r}", name=name, obj=owner)
    near = closest(name, [n for n in dir(owner) if not n.startswith("_")], 1)
    instead = f"; write  {write or near[0]}" if write or near else ""
    return AttributeError(f"a {type(owner).__name__} has no {name!r}{instead}", name=name, obj=owner)


def unknown_setting(name: str, path: str, known: Iterable[str]) -> InputError:
    """Return the error for a path that is not a setting. name: argument that contains the path. known: valid paths."""
    known = list(known)
    below = [p for p in known if p.startswith(path + ".")]
    near = below[:8] or closest(path, known, 6) or _near_ends(path, known) or sorted({p.split(".")[0] for p in known})
    fix = (
        argument(name, "…", near[0])
        if below or (near and near[0] in known)
        else command("trimtab list SCENARIO", "settings(SCENARIO)") + "  shows every path with its value and unit"
    )
    return InputError(argument_name(name, path), "unknown setting", choices=near, fix=fix)


def _near_ends(path: str, known: Iterable[str]) -> list[str]:
    """Return the known paths whose last words are similar to a path without its first words, e.g. law.k9."""
    import difflib  # imported here: only needed after a mistake

    count = path.count(".") + 1
    ends = {".".join(p.split(".")[-count:]): p for p in known}
    return [ends[end] for end in difflib.get_close_matches(path, ends, 6, cutoff=0.75)]


def closest(name: str, choices: Iterable[str], n: int = 3) -> list[str]:
    """Return up to n choices similar to a name, the most similar first."""
    import difflib  # imported here: only needed after a mistake

    names = list(choices)
    tail = _last_word(name)
    by_tail = [c for c in names if _last_word(c) == tail]
    one_slip, near = (difflib.get_close_matches(name, names, n=n, cutoff=cutoff) for cutoff in (0.85, 0.5))
    return list(dict.fromkeys([*one_slip, *by_tail, *near]))[:n]


def _last_word(name: str) -> str:
    """Return the last part of the path of a setting, or of the name of a scenario, in lower case."""
    return name.lower().replace("/", ".").rpartition(".")[2]
