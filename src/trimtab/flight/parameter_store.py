"""File of parameters for the next start of a program. The file is written only if a ground station requests it.

    {"scenario": "hovercraft/forward", "parameters": {"world.vehicle.mass": 2.8}}

When the program starts, these parameters act like settings given by --set. An actual --set overrides a stored
parameter. The comparison of vehicle and autopilot, the log's metadata and a replay treat stored parameters like other
settings.
Source: docs page, Ground stations.
"""

import json
from collections.abc import Callable
from pathlib import Path

from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text
from trimtab.flight.station.parameters import NO_STORE, ChangedValues
from trimtab.logs.mcap import replace_file

LARGEST_FILE = 1_000_000


def read_parameters(file: Path | None, scenario: str) -> dict[str, str]:
    """Return the text of each setting in a file, by path. The result is empty if the file does not exist yet.

    Raises InputError if the file is damaged or belongs to another scenario.
    """
    if file is None or not file.exists():
        return {}
    part = f"parameters '{file}'"
    fix = "use another file, or remove the file to start with the scenario's parameters"
    try:
        content = json.loads(read_user_text(file, largest=LARGEST_FILE))
        owner, parameters = content["scenario"], dict(content["parameters"])
        settings = {str(path): json.dumps(value) for path, value in parameters.items()}
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(part, f"the file cannot be read: {error}", fix=fix) from None
    if owner != scenario:
        raise InputError(
            part,
            f"the parameters in the file belong to the scenario {owner!r}, not to {scenario!r}",
            fix="use one file per scenario",
        )
    return settings


class ParameterStore:
    """Writer of changed parameters into a file."""

    def __init__(
        self,
        file: Path | None = None,
        scenario: str = "",
        setting_path: Callable[[str], str | None] = lambda path: path,
    ) -> None:
        """Prepare to store the parameters of a scenario in a file. file: path of the file, or None to store no
        parameters.

        setting_path: function from the path of a parameter to the path of its setting. If the result is None, the
        parameter is not stored.
        """
        self._file, self._scenario, self._setting_path = file, scenario, setting_path

    @property
    def is_there(self) -> bool:
        """True if there is a file in which to store parameters."""
        return self._file is not None

    def write(self, values: ChangedValues | None) -> str:
        """Add values, given by path, to the file. None removes all values from the file. Return the reason if the file
        cannot be written, or ""."""
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
