"""Parameters that outlive a program: a file of settings, written when a ground station asks for it and never else.

    {"scenario": "hovercraft/forward", "parameters": {"world.vehicle.mass": 2.8}}

At the start they are settings like those after --set, which go before them. So the identity of the two ends, the log's
metadata and a replay know of them as of any setting.
Source: docs page, Ground stations.
"""

import json
from collections.abc import Callable
from pathlib import Path

from trimtab.core.errors import InputError
from trimtab.logs.mcap import replace_file
from trimtab.wire.parameters import NO_STORE, ChangedValues

LARGEST_FILE = 1_000_000


def read_parameters(file: Path | None, scenario: str) -> dict[str, str]:
    """The settings in a file, as text by path; none where there is no file yet.

    Raises InputError for a file that is damaged, or of another scenario.
    """
    if file is None or not file.exists():
        return {}
    part = f"parameters '{file}'"
    fix = "give another file, or remove it: the parameters are then those of the scenario"
    try:
        if file.stat().st_size > LARGEST_FILE:
            raise ValueError("it is too large")
        content = json.loads(file.read_text("utf-8"))
        owner, parameters = content["scenario"], dict(content["parameters"])
        settings = {str(path): json.dumps(value) for path, value in parameters.items()}
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(part, f"cannot be read: {error}", fix=fix) from None
    if owner != scenario:
        raise InputError(part, f"are of {owner!r}, not of {scenario!r}", fix="give a file for each scenario")
    return settings


class ParameterStore:
    """The file, while the program runs."""

    def __init__(
        self,
        file: Path | None = None,
        scenario: str = "",
        setting_path: Callable[[str], str | None] = lambda path: path,
    ) -> None:
        """The parameters of a scenario, kept in a file; None: nowhere.

        setting_path: path of a parameter -> that of its setting, None for one that is not kept.
        """
        self._file, self._scenario, self._setting_path = file, scenario, setting_path

    @property
    def is_there(self) -> bool:
        """Whether there is a file to write."""
        return self._file is not None

    def write(self, values: ChangedValues | None) -> str:
        """Keep numbers by path, beside those that the file has; None: none any more. Why not, empty where it did."""
        if self._file is None:
            return NO_STORE
        try:
            kept = {p: json.loads(text) for p, text in read_parameters(self._file, self._scenario).items()}
            for path, numbers in ({} if values is None else values).items():
                setting = self._setting_path(path)
                if setting is not None:
                    kept[setting] = numbers[0] if len(numbers) == 1 else numbers
            content = {"scenario": self._scenario, "parameters": {} if values is None else kept}
            with replace_file(self._file) as stream:
                stream.write(json.dumps(content, indent=1).encode() + b"\n")
        except InputError as error:
            return f"{error.part} {error.problem}"
        return ""
