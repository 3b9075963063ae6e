"""Scenario files: TOML files that name the parts of a scenario and set their fields. They contain no program code.

    base = "hovercraft/spin"      # scenario of the catalogue, or another file; without base, the file names all parts
    duration = "20 s"

    [choices]                     # arguments of the base, and settings of --set that are not paths
    links = "measured"

    [world.vehicle]
    mass = "3 kg"

    [autopilot.law]
    part = "ConstantSpin"         # class of the new part; a part of this class that the base already has is kept

Tables and keys are the paths that `trimtab list SCENARIO` shows. An entry of the file acts like a setting of the base
scenario after ``--set``. Logs record the entries as settings, so a replay does not need the file.

Source: docs page, Scenario files.
"""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.core.errors import InputError, Spelling, spell_python
from trimtab.core.quantity import Quantity, leaves
from trimtab.core.units import find_unit, parse_amount
from trimtab.core.user_file import open_user_file
from trimtab.logs.metrics import Target, full_path
from trimtab.scenarios.catalogue import BARE, TOML

PART = "part"
"""Key, in the table of a part, whose value is the class of the part."""
OWN = ("base", "name", "without", "faults", "targets", "choices")
"""Top-level keys of a scenario file that are not paths of settings."""
FILES = ("uplink", "downlink", "calibration", "reference")
"""Keys of the table [choices] whose value may be a file name, relative to the folder of the scenario file."""
TARGET_KEYS = ("signal", "value", "band")
FIX = "trimtab list hovercraft/spin --toml  shows a complete file, and  trimtab list --schema  the schema"
_HEADER = re.compile(r"\s*\[\[?([^\[\]]+)\]\]?\s*(#.*)?")
_KEY = re.compile(r"\s*((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=")
_NO_BRACKETS = re.compile(r"\"(?:\\.|[^\"\\])*\"|'[^']*'|#.*")


class ScenarioFile(NamedTuple):
    """Contents of a scenario file, combined with the scenario files on which it is based.

    base: name of a scenario in the catalogue, or BARE.  settings: path -> text.  targets: tables [[targets]] of the
    file, not parsed yet.  places: key -> file, line and column, both counted from 1.
    """

    file: str
    base: str
    name: str
    settings: dict[str, str]
    without: tuple[str, ...]
    faults: tuple[str, ...]
    targets: tuple[Mapping[str, Any], ...]
    places: Mapping[str, tuple[str, int, int]]

    def find_place(self, path: str) -> str:
        """Return "file:line:column" of the entry that sets a path, or the path of a part that contains it.

        Return the name of the file if no such entry exists.
        """
        for key in (f"choices.{path}", f"{path}.{PART}", *_and_above(path)):
            if key in self.places:
                return ":".join(map(str, self.places[key]))
        return self.file

    def locate(self, error: InputError) -> InputError:
        """Return an error with the line of the scenario file that caused the error added."""
        path = named_path(error)
        if path == "scenario":
            path = "without" if "imperfection" in error.problem else "base"
        elif path == "fault":
            path = "faults"
        part = f"{self.find_place(path)}: {error.part}"
        return InputError(part, error.problem, choices=error.choices, fix=error.fix)

    def parse_target(self, target: Mapping[str, Any], units: Mapping[str, str]) -> Target:
        """Return the Target that a table [[targets]] of the file describes. units: path of a signal -> unit, if
        known."""
        where = f"{self.find_place('targets')}: targets"
        for key in (*TARGET_KEYS, *target):
            if key not in target or key not in TARGET_KEYS:
                problem = f"{key!r} is {'not a valid key' if key in target else 'missing'}"
                fix = 'signal = "truth.yaw_rate", value = "3 rad/s", band = "0.15 rad/s"'
                raise InputError(where, problem, choices=TARGET_KEYS, fix=fix)
        path = full_path(str(target["signal"]))
        value, band = (_parse_size(f"{where}.{key}", str(target[key]), units.get(path)) for key in ("value", "band"))
        return Target(path, value, band)


def named_path(error: InputError) -> str:
    """Return the name of the setting or argument that an error is about, or "" if it names none.

    error: error that was raised while `spell_toml` was active.
    """
    match = re.match(r"[A-Za-z_][\w.-]*", error.part)
    return match[0] if match else ""


def spell_toml(outer: Spelling, name: str, value: Any, path: str | None) -> str:
    """Return the text of an argument for error messages: settings as in a scenario file, others as in Python."""
    if name == "settings" and path is not None:
        return path if value is None else _setting_line(path, str(value))
    return spell_python(name, value, path)


def signal_units(scenario: Any) -> dict[str, str]:
    """Return the path of each signal of the true state -> unit."""
    return {f"truth.{path}": d.unit for path, _, d in leaves(scenario.initial) if isinstance(d, Quantity)}


def read_scenario_file(name: str, chain: tuple[str, ...] = ()) -> ScenarioFile:
    """Return the contents of a scenario file, combined with the scenario files on which it is based.

    chain: files that are based on this file, directly or indirectly, to detect a cycle.

    Raises: InputError with file, line and column for invalid TOML, an unknown key, or an invalid value.
    """
    content, places = _read(name), {}
    text = Path(name).read_text(encoding="utf-8")
    places = {key: (name, *place) for key, place in find_places(text).items()}
    where = _Places(name, places)
    settings: dict[str, str] = {}
    choices = _expect(content.get("choices", {}), Mapping, where("choices"), "a table", '[choices], links = "measured"')
    for choice, value in choices.items():
        settings[choice] = _from_folder(name, choice, _as_text(where(f"choices.{choice}"), value))
    tree = {key: value for key, value in content.items() if key not in OWN}
    for path, value in _flatten(tree):
        settings[path] = _as_text(where(path), value)
    file = ScenarioFile(
        file=name,
        base=_expect(content.get("base", BARE), str, where("base"), "a name", 'base = "hovercraft/spin"'),
        name=_expect(content.get("name", ""), str, where("name"), "a name", 'name = "my-boat"'),
        settings=settings,
        without=_texts(content, where, "without", '["navigation-error"]'),
        faults=_texts(content, where, "faults", '["downlink off @ 2 s for 1 s"]'),
        targets=_tables(content, where),
        places=places,
    )
    return _on_base(file, where("base"), (*chain, str(Path(name).resolve())))


def _on_base(file: ScenarioFile, where: str, chain: tuple[str, ...]) -> ScenarioFile:
    """Return a scenario file combined with its base if the base is a scenario file too, else the file unchanged."""
    if ":" in file.base or file.base.endswith(".py"):
        problem = f"must not be a Python file ({file.base!r}), because a scenario file must not run code"
        raise InputError(where, problem, fix='base = "hovercraft/spin", or another file, "NAME.toml"')
    if not file.base.endswith(TOML):
        return file
    below_name = str(Path(file.file).parent / file.base)
    if str(Path(below_name).resolve()) in chain:
        raise InputError(
            where, f"{file.base!r} is itself based on this file", fix="set base to a scenario of the catalogue"
        )
    below = read_scenario_file(below_name, chain)
    return file._replace(
        base=below.base,
        name=file.name or below.name,
        settings=merge_settings(below.settings, file.settings),
        without=(*below.without, *file.without),
        faults=(*below.faults, *file.faults),
        targets=file.targets or below.targets,
        places={**below.places, **file.places},
    )


def merge_settings(below: Mapping[str, str], own: Mapping[str, str]) -> dict[str, str]:
    """Return the settings of a base file, `below`, overridden by the settings `own` of the file that is based on it.

    If `own` replaces a part, the settings of the old part are dropped.
    """
    replaced = tuple(f"{path}." for path, text in own.items() if path in below and below[path] != text)
    return {path: text for path, text in below.items() if not path.startswith(replaced)} | dict(own)


def find_places(text: str) -> dict[str, tuple[int, int]]:
    """Return each key and table header in a TOML text -> line and column, counted from 1."""
    places: dict[str, tuple[int, int]] = {}
    table, depth, in_text = "", 0, False
    for number, line in enumerate(text.splitlines(), 1):
        if depth == 0 and not in_text:
            header, key = _HEADER.fullmatch(line), _KEY.match(line)
            if header:
                table = _plain_key(header[1])
                places.setdefault(table, (number, line.index("[") + 1))
            elif key:
                path = ".".join(filter(None, (table, _plain_key(key[1]))))
                places.setdefault(path, (number, key.start(1) + 1))
        if (line.count('"""') + line.count("'''")) % 2:
            in_text = not in_text
        if not in_text and not _HEADER.fullmatch(line):
            rest = _NO_BRACKETS.sub("", line)
            depth = max(0, depth + sum(map(rest.count, "[{")) - sum(map(rest.count, "]}")))
    return places


class _Places(NamedTuple):
    """Callable that returns the position of a key for error messages, as "file:line:column: key"."""

    file: str
    places: Mapping[str, tuple[str, int, int]]

    def __call__(self, key: str) -> str:
        place = next((self.places[k] for k in (key, *_and_above(key)) if k in self.places), (self.file,))
        return f"{':'.join(map(str, place))}: {key}"


def _and_above(path: str) -> Iterator[str]:
    while path:
        yield path
        path = path.rpartition(".")[0]


def _plain_key(text: str) -> str:
    return ".".join(word.strip().strip("\"'") for word in text.split("."))


def _read(name: str) -> dict[str, Any]:
    try:
        with open_user_file(name) as stream:
            return tomllib.load(stream)
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
        raise InputError(f"scenario file {name!r}", problem, fix="give the path of a .toml file") from None
    except UnicodeDecodeError:
        raise InputError(f"scenario file {name!r}", "is not UTF-8 text", fix="save the file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        problem, match = str(error), re.search(r"\s*\(at line (\d+), column (\d+)\)", str(error))
        lines = Path(name).read_text(encoding="utf-8").splitlines() or [""]
        line, column = (match[1], match[2]) if match else (len(lines), len(lines[-1]) + 1)
        place, problem = f"{name}:{line}:{column}", re.sub(r"\s*\(at .*\)$", "", problem)
        raise InputError(place, problem, fix=f"write  key = value, with texts in quotes; {FIX}") from None


def _flatten(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and value of each key in nested tables. The path of a key `part` is that of the table that contains
    it."""
    for key, value in tree.items():
        path = f"{above}.{key}" if above else key
        if key == PART and above:
            yield above, value
        elif isinstance(value, Mapping):
            below: Mapping[str, Any] = value  # pyright: ignore[reportUnknownVariableType]
            yield from _flatten(below, path)
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):  # pyright: ignore[reportUnknownVariableType]
            rows: list[Any] = value  # pyright: ignore[reportUnknownVariableType]
            yield from _flatten({str(i): row for i, row in enumerate(rows)}, path)
        else:
            yield path, value


def _as_text(where: str, value: Any) -> str:
    """Return the text of a value in the notation of ``--set``."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int | float):
        return str(value).lower() if isinstance(value, bool) else repr(value)
    if isinstance(value, list):
        return json.dumps(value, default=lambda v: _refuse(where, v))
    return _refuse(where, value)


def _refuse(where: str, value: Any) -> Any:
    fix = 'write a number, a text such as "3 kg", true, false, or a list of such values'
    raise InputError(where, f"{value} is a {type(value).__name__}, which is not valid for a setting", fix=fix)


def _expect(value: Any, kind: Any, where: str, what: str, fix: str) -> Any:
    if not isinstance(value, kind):
        raise InputError(where, f"{value!r} is not {what}", fix=fix)
    return value


def _texts(content: Mapping[str, Any], where: _Places, key: str, example: str) -> tuple[str, ...]:
    several = _expect(content.get(key, []), list, where(key), "a list of texts", f"{key} = {example}")
    return tuple(_expect(text, str, where(key), "a text", f"{key} = {example}") for text in several)


def _tables(content: Mapping[str, Any], where: _Places) -> tuple[Mapping[str, Any], ...]:
    fix = '[[targets]], with signal = "truth.yaw_rate", value = "3 rad/s", band = "0.15 rad/s"'
    several = _expect(content.get("targets", []), list, where("targets"), "a list of tables", fix)
    return tuple(_expect(one, Mapping, where("targets"), "a table", fix) for one in several)


def _from_folder(name: str, choice: str, text: str) -> str:
    is_file = choice in FILES and text.endswith((".csv", TOML))
    return str(Path(name).parent / text) if is_file else text


def _parse_size(where: str, text: str, unit: str | None) -> float:
    if unit is not None:
        return parse_amount(where, text, unit)
    number, _, own = text.strip().partition(" ")
    return parse_amount(where, number, "1") * (find_unit(where, own).scale if own else 1.0)


def _setting_line(path: str, value: str) -> str:
    """Return the text of a setting as it is written in a scenario file."""
    table, _, key = path.rpartition(".")
    if re.fullmatch(r"[A-Z]\w*(\.\w+)?", value) and not value.isupper():
        table, key = path, PART
    plain = re.fullmatch(r"[-+\d.e]+|true|false|\[.*\]", value)
    return (f"[{table}] " if table else "") + f"{key} = {value if plain else json.dumps(value, ensure_ascii=False)}"
