"""Names that were typed, looked at before a verb is imported: of the scenario, and of the settings.

A verb and all that it needs take a second or more to import; a typo is answered without. The paths of a scenario's
settings are known here once they were read, by `trimtab list`, by completion or after a wrong one; till then only the
first word of a path is looked at. What isn't sure is left to the verb, which says the same.
"""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from trimtab.core.cache_folder import cache_folder, package_stamp
from trimtab.core.errors import InputError, closest, unknown_setting
from trimtab.scenarios import catalogue

TAKES_SCENARIO = frozenset(
    (
        *("list", "run", "budget", "campaign", "falsify", "rare", "map", "tune", "trim", "linearise", "zeros"),
        *("identify", "vehicle", "fly", "console", "inject", "export", "firmware"),
    )
)
"""Verbs whose first word is a scenario."""
PATHS = {"--set": "settings", "--spread": "spread", "--gain": "gains"}
"""Options that begin with a setting's path -> the argument in Python."""
ROOTS = (
    "world",
    "autopilot",
    "initial",
    "limits",
    "failsafe",
    "truth_sensor",
    "uplink",
    "downlink",
    "duration",
    "name",
)
"""First words of the paths of a catalogue scenario."""
RESHAPING = ("--navigation", "--calibration", "--reference")
"""Options by which a scenario gets other parts, and so other paths."""
FOLDER = "setting-paths"


def check_names(words: Sequence[str]) -> None:
    """Refuse a scenario that is in no catalogue, and a setting that is in no scenario.

    words: as they were typed, from the verb on.

    Raises: InputError with what is near.
    """
    verb, *rest = words
    scenario = rest[0] if rest else ""
    if verb not in TAKES_SCENARIO or not re.fullmatch(r"[\w-]+/[\w-]+", scenario) or Path(scenario).exists():
        return
    catalogue.check_name(scenario, verb)
    typed = list(_iter_paths(rest))
    for option, path, _ in typed:
        root = path.partition(".")[0]
        if "." in path and root not in ROOTS:
            raise unknown_setting(PATHS[option], path, read_paths(scenario) or _near_roots(path))
    known = read_paths(scenario)
    if not known or any(word.partition("=")[0] in RESHAPING for word in rest):
        return
    if any(option == "--set" and ("." not in path or value[:1].isupper()) for option, path, value in typed):
        return  # a choice, or the class of a part, which may bring other paths
    links = ("uplink.", "downlink.")
    for option, path, _ in typed:
        plain = re.sub(r"\[.*", "", path)
        if option != "--set" or "." not in plain or plain.startswith(links):
            continue
        if plain not in known:
            raise unknown_setting(PATHS[option], path, known)


def _near_roots(path: str) -> list[str]:
    """The path with each first word that there is in the place of its own, the likeliest first."""
    root, _, rest = path.partition(".")
    return [f"{near}.{rest}" for near in closest(root, ROOTS, 1) or ROOTS[:2]]


def _iter_paths(words: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Option, path and value of each setting that was typed."""
    for i, word in enumerate(words):
        option, equals, text = word.partition("=")
        if word in PATHS and i + 1 < len(words):
            option, text = word, words[i + 1]
        elif option not in PATHS or not equals:
            continue
        path, equals, value = text.partition("=")
        if equals:
            yield option, path.strip(), value.strip()


def read_paths(scenario: str) -> list[str]:
    """Paths of a scenario's settings; none where they weren't read yet, or the package has changed since."""
    with suppress(OSError, UnicodeError):
        stamp, *paths = (cache_folder(FOLDER) / _file_name(scenario)).read_text("utf-8").split("\n")
        return paths if stamp == package_stamp() else []
    return []


def keep_paths(scenario: str, paths: Iterable[str]) -> None:
    """Keep the paths of a scenario of the catalogue for the next time."""
    if scenario in catalogue.scenario_files():
        with suppress(OSError):
            text = "\n".join((package_stamp(), *paths))
            (cache_folder(FOLDER) / _file_name(scenario)).write_text(text, "utf-8")


def learn_paths(words: Sequence[str]) -> None:
    """After a wrong path: keep those of the scenario that was typed, so that the next one is answered at once."""
    if "jax" in sys.modules and len(words) > 1 and words[1] in catalogue.scenario_files():
        from trimtab.loop.settings import setting_paths

        with suppress(InputError):
            keep_paths(words[1], setting_paths(catalogue.load_scenario(words[1])[0]))


def _file_name(scenario: str) -> str:
    return scenario.replace("/", "--") + ".txt"
