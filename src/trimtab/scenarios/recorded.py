"""The scenario of a log: the one of its name in the catalogue, with every setting as it was recorded."""

import contextlib
import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, leaves, with_leaf
from trimtab.logs.log import Log
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.scenario import Scenario
from trimtab.run.program import part_classes, plain_setting
from trimtab.scenarios import catalogue

COMPARED_PATHS = ("autopilot", "world.sensors")
"""What a replay needs as it was: what flies, and what it is given. The rest of the world is only kept if it fits."""


SETTING = "a setting"


def rebuild_scenario(log: Log, name: str | None = None) -> Scenario:
    """Build a log's scenario again.

    The choices that its function offers are tried until all parts and settings are the recorded ones, or else those of
    autopilot and sensors, as after ``--without``; then each setting gets its recorded value.

    Args:
        log: with the metadata that simulate and fly write.
        name: of the scenario, where it is not the recorded one: ``file.py:function``, or one that was renamed.

    Raises:
        InputError: a log that does not say what flew, or a catalogue that no longer has it.
    """
    chosen = name or log.metadata.get("scenario")
    settings = log.metadata.get("parameters")
    if not isinstance(chosen, str) or not isinstance(settings, Mapping):
        missing = "its scenario" if not isinstance(chosen, str) else "its parameters"
        fix = "give a log of trimtab run or trimtab fly, or name the scenario: --scenario NAME"
        raise InputError("replay", f"the log does not say {missing}", fix=fix)
    parts = log.metadata.get("parts")
    wanted = _setting_classes(settings, parts)
    best: Scenario | None = None
    for found in _add_live_variants(_candidates(chosen, given=name is not None)):
        here = _setting_classes(dict.fromkeys(p for p, _, _ in leaves(found)), part_classes(found) if parts else None)
        if here == wanted:
            return _set_values(found, settings)
        if _keep_compared(here) == _keep_compared(wanted):
            best = best or found
    if best is None:
        raise _difference_error(chosen, wanted, parts)
    return _set_values(best, settings)


def _candidates(name: str, *, given: bool) -> Iterator[Scenario]:
    """The scenario with its defaults, then with every combination of its choices."""
    try:
        offered = catalogue.scenario_choices(name)
    except InputError as error:
        if given:
            raise
        fix = "name the recorded scenario: --scenario file.py:function"
        raise InputError(error.part, error.problem, choices=error.choices, fix=fix) from None
    yield catalogue.load_scenario(name)[0]
    if all(offered.values()):
        for values in itertools.product(*offered.values()):
            with contextlib.suppress(InputError):  # choices that don't go together
                yield catalogue.load_scenario(name, dict(zip(offered, values, strict=True)))[0]


def _add_live_variants(candidates: Iterator[Scenario]) -> Iterator[Scenario]:
    """Each one, and as `fly` has it, which can be asked to hold or to end."""
    for found in candidates:
        yield found
        asked = add_pilot_sensor(found)
        if asked is not found:
            yield asked


def _setting_classes(settings: Mapping[str, Any], parts: Any) -> dict[str, str]:
    """The paths of settings, and the class of each part where it is known."""
    return dict.fromkeys(settings, SETTING) | dict(parts or {})


def _keep_compared(shape: dict[str, str]) -> dict[str, str]:
    return {path: kind for path, kind in shape.items() if path.startswith(COMPARED_PATHS)}


def _set_values(scenario: Scenario, settings: Mapping[str, Any]) -> Scenario:
    """Every setting that there is, as recorded: floats to the bit."""
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


def _difference_error(name: str, wanted: dict[str, str], parts: Any) -> InputError:
    found = catalogue.load_scenario(name)[0]
    here = _keep_compared(
        _setting_classes(dict.fromkeys(p for p, _, _ in leaves(found)), part_classes(found) if parts else None)
    )
    wanted = _keep_compared(wanted)
    apart = min(p for p in {*here, *wanted} if here.get(p) != wanted.get(p))
    was, now = wanted.get(apart, "missing"), here.get(apart, "missing")
    problem = f"the catalogue's {name!r} is built otherwise than the recorded one: {apart} was {was}, is {now}"
    fix = "replay with the version that recorded it, or name a scenario built alike: --scenario file.py:function"
    return InputError("replay", problem, fix=fix)
