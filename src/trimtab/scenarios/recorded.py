"""Rebuild the scenario of a log from the recorded arguments of `build` and the recorded value of every setting."""

import contextlib
import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.quantity import part_classes, plain_setting
from trimtab.core.record import Quantity, leaves, with_leaf
from trimtab.design.certificate_file import parse_certificate
from trimtab.logs.log import Log
from trimtab.loop.calibration import parse_calibration
from trimtab.loop.fault_text import add_dormant_faults
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import add_stick_sensor
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import CALIBRATION, build
from trimtab.scenarios.catalogue import BARE, GAIN
from trimtab.scenarios.recorded_choices import FILE_ARGUMENTS, check_recorded_choices

COMPARED_PATHS = ("autopilot", "world.sensors")
"""Paths of the parts that must have the same fields and classes as in the log, because a replay runs these parts.
Differences in other parts of the scenario are accepted."""
SETTING = "a setting"


def rebuild_scenario(log: Log, name: str | None = None) -> Scenario:
    """Return the scenario of a log, with each setting at its recorded value.

    Args:
        log: log with the metadata that `simulate` and `fly` write. If the metadata has no choices, because the scenario
            was not built by `build`, every combination of the scenario's arguments is tried.
        name: name of the scenario, if it differs from the recorded name: ``file.py:function``, or a new name.

    Raises:
        InputError: the log does not name its scenario, or names a scenario that is not in the catalogue.
    """
    check_recorded_choices(log)
    choices = log.metadata.get("choices") or {}
    own_name, settings = choices.get("scenario") or log.metadata.get("scenario"), log.metadata.get("parameters")
    if name is None and isinstance(own_name, str):
        name = _check_catalogue(own_name)
    if name is None or not isinstance(settings, Mapping):
        missing = "its scenario" if name is None else "its parameters"
        fix = f"use a log of trimtab run or trimtab fly, or name the scenario: {argument('scenario', 'NAME')}"
        raise InputError("log", f"the log does not contain {missing}", fix=fix)
    parts = log.metadata.get("parts")
    recorded = _recorded_classes(settings, parts)
    compared = _keep_compared(recorded)
    alike: Scenario | None = None
    for scenario in _add_live_variants(_build_candidates(name, choices), log.metadata.get("side")):
        classes = _setting_classes(scenario, parts)
        if classes == recorded:
            return _set_values(scenario, settings)
        if alike is None and _keep_compared(classes) == compared:
            alike = scenario
    if alike is None:
        first = next(_build_candidates(name, choices))
        raise _difference_error(name, _keep_compared(_setting_classes(first, parts)), compared)
    return _set_values(alike, settings)


def _check_catalogue(name: str) -> str:
    """Return the scenario name in a log if it is in the catalogue, else raise InputError.

    A name outside the catalogue is not accepted, because reading a log must not run a file that the log names.
    """
    known = {**catalogue.scenario_names(), BARE: ""}
    if name not in known:
        is_file = ":" in name
        problem = (
            f"the log names the scenario {name!r}, which is not in the catalogue; a file is not run only because a log "
            "names it"
        )
        fix = f"if you trust the file, type its name: {argument('scenario', name if is_file else 'file.py:function')}"
        raise InputError("log", problem, choices=() if is_file else known, fix=fix)
    return name


def _build_candidates(name: str, choices: Mapping[str, Any]) -> Iterator[Scenario]:
    """Yield the scenario with the recorded choices or, for a log without choices, with every combination of
    arguments."""
    if choices:
        settings = {
            p: text for p, text in choices["settings"].items() if p not in FILE_ARGUMENTS
        }  # the files may have changed, so the copies in the log are used
        content = choices.get(CALIBRATION)
        calibration = None if content is None else parse_calibration("the log's calibration", content["content"])
        noted = choices.get(GAIN)
        gain = None if noted is None else parse_certificate(noted["content"], "the log's gain")[0]
        what = (choices["arguments"] | settings, choices["without"], choices["faults"], calibration)
        scenario = build(name, *what, in_virtual_time=False, gain=gain)
        yield scenario.ideal() if choices.get("ideal") else scenario
        return
    yield catalogue.load_scenario(name)[0]
    offered = catalogue.scenario_choices(name)
    if all(offered.values()):
        for values in itertools.product(*offered.values()):
            with contextlib.suppress(InputError):  # choices that cannot be combined
                yield catalogue.load_scenario(name, dict(zip(offered, values, strict=True)))[0]


def _add_live_variants(candidates: Iterator[Scenario], side: Any) -> Iterator[Scenario]:
    """Yield each candidate scenario, then the variant of the candidate that a live flight uses.

    `trimtab fly` adds sensors for the pilot's requests and the stick. `trimtab vehicle` adds an inactive fault to every
    part.

    side: end of the radio link that wrote the log, "vehicle" or the autopilot's end.
    """
    for scenario in candidates:
        yield scenario
        if side == "vehicle":
            yield add_dormant_faults(scenario)
            continue
        variant = add_stick_sensor(add_pilot_sensor(scenario))
        if variant is not scenario:
            yield variant


def _recorded_classes(settings: Mapping[str, Any], parts: Any) -> dict[str, str]:
    """Return each path in the log -> "a setting" for a setting, or the class name for a part."""
    return dict.fromkeys(settings, SETTING) | dict(parts or {})


def _setting_classes(scenario: Scenario, parts: Any) -> dict[str, str]:
    """Return each path of a scenario -> "a setting" for a setting, or the class name for a part."""
    return dict.fromkeys((p for p, _, _ in leaves(scenario)), SETTING) | (part_classes(scenario) if parts else {})


def _keep_compared(classes: dict[str, str]) -> dict[str, str]:
    return {path: name for path, name in classes.items() if path.startswith(COMPARED_PATHS)}


def _set_values(scenario: Scenario, settings: Mapping[str, Any]) -> Scenario:
    """Return the scenario with each setting at its recorded value. Floats are restored exactly, bit for bit."""
    for path, old, declared in list(leaves(scenario)):
        if path not in settings or plain_setting(old) == settings[path]:
            continue
        value = settings[path]
        if isinstance(declared, Quantity):
            value = np.asarray(value, declared.dtype()) if isinstance(value, list) else value
        elif isinstance(old, tuple):
            value = _lists_to_tuples(value)
        scenario = with_leaf(scenario, path, lambda _old, _declared, value=value: value)
    return scenario


def _lists_to_tuples(value: Any) -> Any:
    return tuple(_lists_to_tuples(v) for v in value) if isinstance(value, list) else value


def _difference_error(name: str, classes: dict[str, str], recorded: dict[str, str]) -> InputError:
    path = min(p for p in {*classes, *recorded} if classes.get(p) != recorded.get(p))
    was, now = recorded.get(path, "missing"), classes.get(path, "missing")
    problem = f"{name!r} differs from the recorded scenario: {path} was {was}, but now is {now}"
    fix = "use the version of trimtab and of the file that recorded the log, or name a scenario with the same parts: "
    fix += argument("scenario", "file.py:function")
    return InputError("log", problem, fix=fix)
