"""Check of the typed names of a scenario and its settings, before the module of the typed subcommand is imported.

The import takes a second or more. With this check, a typo is reported without that delay. The paths of a scenario's
settings are cached when `trimtab list`, `trimtab run` or shell completion runs, and after a wrong path. Until then,
only a slip in the first word of a path is found. Names that cannot be checked here are checked by the subcommand, which
gives the same message.
"""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from trimtab.core.cache_folder import cache_folder, package_stamp
from trimtab.core.errors import InputError
from trimtab.core.suggestions import unknown_setting
from trimtab.scenarios import catalogue

TAKES_SCENARIO = frozenset(
    (
        *("list", "run", "budget", "campaign", "falsify", "rare", "map", "tune", "trim", "linearise", "zeros"),
        *("identify", "vehicle", "fly", "console", "inject", "export", "firmware"),
    )
)
"""Subcommands whose first argument is a scenario."""
TAKES_VEHICLE = frozenset(("trim", "linearise", "zeros", "export", "console"))
"""Subcommands whose first argument may be a scenario, but also a vehicle, a function in a file, or a log."""
PATHS = {"--set": "settings", "--spread": "spread", "--gain": "gains"}
"""Option whose value begins with the path of a setting -> name of the Python argument for this option."""
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
"""First words that a path of a setting can have in scenarios of the catalogue."""
RESHAPING = ("--navigation", "--calibration", "--reference")
"""Options that replace parts of a scenario, and thereby change the paths of the scenario's settings."""
FOLDER = "setting-paths"


def check_names(words: Sequence[str], plain: Sequence[str] | None) -> None:
    """Check the scenario and the settings of a command line.

    Args:
        words: words as typed, beginning with the subcommand.
        plain: words after the subcommand that are not options; None if unknown.

    Raises: InputError with the nearest names, for an unknown scenario or setting.
    """
    verb, *rest = words
    scenario = next(iter(rest if plain is None else plain), "")
    may_be_vehicle = verb in TAKES_VEHICLE and "/" not in scenario
    is_name = re.fullmatch(r"(?!-)[\w-]+(/[\w-]+|\.py)?", scenario) and not may_be_vehicle
    if verb not in TAKES_SCENARIO or not is_name or (Path(scenario).exists() and not scenario.endswith(".py")):
        return
    catalogue.check_name(scenario, verb)
    typed, known = list(_iter_paths(rest)), read_paths(scenario)
    for option, path, _ in typed:
        root = path.partition(".")[0]
        if "." in path and root not in ROOTS and (paths := known or _near_roots(path)):
            raise unknown_setting(PATHS[option], path, paths)
    if not known or any(word.partition("=")[0] in RESHAPING for word in rest):
        return
    if any(option == "--set" and ("." not in path or value[:1].isupper()) for option, path, value in typed):
        return  # another choice or class of a part may add paths
    links = ("uplink.", "downlink.")
    for option, path, _ in typed:
        plain = re.sub(r"\[.*", "", path)
        if option != "--set" or "." not in plain or plain.startswith(links):
            continue
        if plain not in known:
            raise unknown_setting(PATHS[option], path, known)


def _near_roots(path: str) -> list[str]:
    """Return the path with the correct first word, or an empty list if the first word is not just misspelt."""
    import difflib  # imported here: only needed after a mistake

    root, _, rest = path.partition(".")
    return [f"{near}.{rest}" for near in difflib.get_close_matches(root, ROOTS, 1, cutoff=0.75)]


def _iter_paths(words: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield option, path and value of each setting on the command line."""
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
    """Return the cached paths of a scenario's settings; an empty list if not cached, or if the package has changed."""
    with suppress(OSError, UnicodeError):
        stamp, *paths = (cache_folder(FOLDER) / _file_name(scenario)).read_text("utf-8").split("\n")
        return paths if stamp == package_stamp() else []
    return []


def keep_paths(scenario: str, paths: Iterable[str]) -> None:
    """Cache the paths of the settings of a scenario of the catalogue."""
    if scenario in catalogue.scenario_files():
        with suppress(OSError):
            text = "\n".join((package_stamp(), *paths))
            (cache_folder(FOLDER) / _file_name(scenario)).write_text(text, "utf-8")


def learn_paths(words: Sequence[str]) -> None:
    """After a wrong path was typed, cache the paths of the scenario, so that the next wrong path is reported fast."""
    if "jax" in sys.modules and len(words) > 1 and words[1] in catalogue.scenario_files():
        from trimtab.loop.settings import setting_paths

        with suppress(InputError):
            keep_paths(words[1], setting_paths(catalogue.load_scenario(words[1])[0]))


def _file_name(scenario: str) -> str:
    return scenario.replace("/", "--") + ".txt"
