"""Suggestions after a misspelt name: the nearest scenario, setting, option or file.

Source: docs page, Troubleshooting.
"""

from collections.abc import Iterable

from trimtab.core.errors import InputError, argument, argument_name


def unknown_setting(name: str, path: str, known: Iterable[str]) -> InputError:
    """Problem reported for a path without a setting.

    name: of the argument that has it, e.g. "settings".  known: the paths that there are.
    """
    known = list(known)
    below = [p for p in known if p.startswith(path + ".")]
    near = below[:8] or closest(path, known, 6) or sorted({p.split(".")[0] for p in known})
    fix = (
        argument(name, "…", near[0])
        if below or (near and near[0] in known)
        else "trimtab list SCENARIO  shows every path with its value and unit"
    )
    return InputError(argument_name(name, path), "there is no such setting", choices=near, fix=fix)


def closest(name: str, choices: Iterable[str], n: int = 3) -> list[str]:
    """Return up to n choices that look like name, best first; empty when none does."""
    import difflib  # only after a mistake

    names = list(choices)
    tail = _last_word(name)
    by_tail = [c for c in names if _last_word(c) == tail]
    one_slip, near = (difflib.get_close_matches(name, names, n=n, cutoff=cutoff) for cutoff in (0.85, 0.5))
    return list(dict.fromkeys([*one_slip, *by_tail, *near]))[:n]


def _last_word(name: str) -> str:
    """Return the words of a setting's path or of a scenario's name, in small letters."""
    return name.lower().replace("/", ".").rpartition(".")[2]
