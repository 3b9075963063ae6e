"""Table of a scenario's settings for programs and notebooks, with the same content as ``trimtab list SCENARIO``."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.html_table import html_table
from trimtab.core.quantity import Option, leaves
from trimtab.core.suggestions import closest
from trimtab.core.time import format_time
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import find_scenario

TICK = "100 ns"
SHOWN = 40
"""Maximum number of settings that are printed. The table itself contains all settings."""


class Setting(NamedTuple):
    """Setting of a scenario: value, unit and meaning.

    unit: "1" for a dimensionless number, "" for a choice, "100 ns" for a period.  doc: meaning.  choices: valid values,
    if the setting is a choice.
    """

    value: Any
    unit: str
    doc: str
    choices: tuple[Any, ...] = ()

    def __str__(self) -> str:
        if self.unit == TICK and not np.ndim(self.value):
            return format_time(int(self.value))
        if not self.unit:
            return str(self.value)
        if np.ndim(self.value):
            few = np.ndim(self.value) == 1 and np.size(self.value) <= 4
            shape = "x".join(map(str, np.shape(self.value)))
            text = f"[{', '.join(f'{v:.4g}' for v in np.asarray(self.value))}]" if few else f"{shape} numbers"
        else:
            text = f"{float(self.value):.6g}"
        return text if self.unit == "1" else f"{text} {self.unit}"


class SettingsTable(Mapping[str, Setting]):
    """Settings of a scenario by path. For the path of a part, ``table["world.vehicle"]`` is the table of its
    settings."""

    def __init__(self, name: str, settings: Mapping[str, Setting]) -> None:
        self.name, self._settings = name, dict(settings)

    def __getitem__(self, path: str) -> Any:
        if path in self._settings:
            return self._settings[path]
        below = {p: s for p, s in self._settings.items() if p.startswith(f"{path}.")}
        if not below:
            near = closest(path, self._settings, 6)
            fix = f"settings[{near[0]!r}]" if near else "print(settings) shows every path"
            raise InputError(f"settings[{path!r}]", "unknown setting", choices=near, fix=fix)
        return SettingsTable(f"{self.name}, {path}", below)

    def __iter__(self) -> Iterator[str]:
        return iter(self._settings)

    def __len__(self) -> int:
        return len(self._settings)

    def __repr__(self) -> str:
        rows = [(path, str(s), s.doc) for path, s in self._settings.items()][:SHOWN]
        wide = [max((len(row[k]) for row in rows), default=0) for k in (0, 1)]
        lines = [f"{self.name}: {len(self)} settings", *(f"  {p:<{wide[0]}}  {v:<{wide[1]}}  {d}" for p, v, d in rows)]
        if len(self) > SHOWN:
            lines.append(f'  … {len(self) - SHOWN} more; to show the settings of one part: settings["world.vehicle"]')
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = [(path, str(s), s.doc) for path, s in self._settings.items()]
        return html_table(self.name, ("setting", "value", "meaning"), rows)


def settings(scenario: Scenario | str) -> SettingsTable:
    """Return the table of all settings of a scenario, with path, value, unit and meaning.

    >>> from trimtab import settings
    >>> settings("hovercraft/spin")["world.vehicle.mass"]
    Setting(value=2.6, unit='kg', doc='Total mass with batteries.', choices=())

    Args:
        scenario: scenario, or name of a scenario.

    Raises: InputError for an unknown name.
    """
    scenario = find_scenario(scenario)
    rows: dict[str, Setting] = {}
    for path, value, declared in leaves(scenario):
        if isinstance(declared, Option):
            unit = TICK if declared.kind == "period" else ""
            rows[path] = Setting(value, unit, declared.doc, declared.choices)
        else:
            rows[path] = Setting(value, declared.unit, declared.doc)
    return SettingsTable(scenario.name, rows)
