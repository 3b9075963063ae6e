"""Build a scenario from user input: a name, settings, imperfections to switch off, and faults to inject."""

import functools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trimtab.core.errors import InputError, argument, argument_name, command, spell_with
from trimtab.core.explain_call import explain_call
from trimtab.core.interfaces import optional_member
from trimtab.core.record import declarations, leaves, replace
from trimtab.core.suggestions import closest
from trimtab.core.time import ms
from trimtab.links.fifo import required_slots
from trimtab.links.latency_trace import LatencyTrace, read_trace
from trimtab.loop import link_latency
from trimtab.loop.calibrated import with_calibration
from trimtab.loop.calibration import Calibration, format_calibration, read_calibration
from trimtab.loop.fault_text import check_fault_times, inject_faults
from trimtab.loop.link_latency import LINKS, with_link_settings
from trimtab.loop.own_code import PARTS
from trimtab.loop.predictor import predictor_for
from trimtab.loop.reference_text import plain_text, with_reference
from trimtab.loop.scenario import Scenario
from trimtab.loop.setpoint_schedule import split_schedules, with_schedules
from trimtab.loop.settings import texts_of, with_parts, with_settings
from trimtab.scenarios import catalogue
from trimtab.scenarios.catalogue import GAIN, TOML
from trimtab.scenarios.toml_file import merge_settings, named_path, read_scenario_file, signal_units, spell_toml

if TYPE_CHECKING:  # a gain's modules import scipy, which takes a second
    from trimtab.design.certificate import Certificate

MISMATCH = "mismatch"
CALIBRATION = "calibration"
REFERENCE = "reference"
PREDICTOR = "predictor"
SPECIAL = (*LINKS, *link_latency.SETTINGS, MISMATCH, CALIBRATION, REFERENCE, PREDICTOR, GAIN)
"""Names of settings of a scenario that are not paths of fields."""
SWITCH = {
    "off": "the law reads the estimate unchanged",
    "on": "a predictor propagates the estimate over the delay of both links, with the commands in transit",
}
"""Choices of the setting ``predictor``, with a description of each choice. Every scenario has this setting."""
NEEDED = {
    "world.vehicle": "Hovercraft",
    "world.actuators": "FanDrive",
    "autopilot.estimator": "Passthrough",
    "autopilot.law": "ZeroVelocity",
    "autopilot.allocation": "ThrustVectorAllocation",
    "initial": "HovercraftState",
}
"""Path of each part that a scenario must have -> example of a class of this part."""


@explain_call({"settings": 'build("SCENARIO", settings={"PATH": VALUE})'})
def build(
    name: str,
    settings: Mapping[str, Any] | None = None,
    without: Iterable[str] = (),
    faults: Iterable[str] = (),
    calibration: Calibration | None = None,
    in_virtual_time: bool = True,
    gain: "Certificate | None" = None,
) -> Scenario:
    """Build the named scenario with the given settings and check it. Its field `choices` records the arguments.

    >>> from trimtab import build
    >>> build("hovercraft/spin", {"links": "measured", "world.vehicle.mass": "3000 g"}).world.vehicle.mass
    3.0

    Args:
        name: a name in the catalogue, or ``file.py:function``, or a scenario file, ``file.toml``
            (`scenarios.toml_file`). `settings` override the settings in a scenario file.
        settings: path of a field -> text or number, as after ``--set``. They override a calibration. A value such as
            ``steps(0 s: 1, 5 s: 2)`` changes in flight (`loop.setpoint_schedule`). These names are not paths of fields:
            "uplink", "downlink": file with a recording of a radio link, which is replayed instead of the simulated
            link. "uplink.delay", "uplink.jitter", "uplink.loss", and the same for "downlink": see `loop.link_latency`.
            "mismatch": vehicle models in the autopilot that may differ from each other (`loop.model_mismatch`).
            "calibration": file written by `trimtab calibrate`. "predictor": "on" or "off" (`loop.predictor`).
            "reference": path that the law follows (`loop.reference_text`). "gain": file of a feedback gain that
            replaces the law (`scenarios.gain_file`).
        without: imperfections to switch off.  faults: faults to inject, in the notation of ``--fault``.
        calibration: calibration, if it is not given as a file.
        in_virtual_time: True if the flight ends after the scenario's duration. A fault after this time is an error.
        gain: feedback gain, if it is not given as a file.

    Raises: InputError for an invalid argument. The message says what to type instead.
    """
    settings = texts_of(settings or {})
    without, faults = ([one] if isinstance(one, str) else list(one) for one in (without, faults))
    if name.endswith(TOML):
        return _build_file(name, settings, without, faults, (calibration, in_virtual_time, gain))
    path = _typed_reference(name, settings)
    scenario, rest = catalogue.load_scenario(
        name, {n: text for n, text in settings.items() if n != REFERENCE or not path}
    )
    scenario = _name_after_file(name, scenario)
    if "navigation" in rest:
        _refuse_navigation(name)
    scenario, own = with_parts(scenario, {path: text for path, text in rest.items() if path not in SPECIAL})
    _refuse_gaps(name, scenario, own)
    if path:
        scenario, rest[REFERENCE] = with_reference(scenario, path), plain_text(path)
    choices: dict[str, Any] = {
        "scenario": name,
        "arguments": {argument: text for argument, text in settings.items() if argument not in rest},
        "settings": rest,
        "without": without,
        "faults": faults,
    }
    scenario = with_link_settings(_replace_links_by_recordings(scenario, rest), rest)
    if MISMATCH in rest:
        scenario = replace(scenario, mismatch=tuple(path.strip() for path in rest[MISMATCH].split(",")))
    if CALIBRATION in rest:
        calibration = read_calibration(rest[CALIBRATION])
    if calibration is not None:
        scenario, choices[CALIBRATION] = _calibrate(scenario, calibration)
    gain = _find_gain(rest, path) or gain
    if gain is not None:
        scenario, choices[GAIN] = _add_gain(name, scenario, gain)
    scenario = _add_predictor(scenario, rest)  # after the links are final, because the predictor uses their latencies
    own, schedules = split_schedules(own)
    _refuse_choices(name, scenario, own)
    scenario = with_schedules(with_settings(scenario, own), schedules)
    _check_gain(gain, scenario)
    for imperfection in without:
        scenario = scenario.without(imperfection)
    if in_virtual_time:
        check_fault_times(scenario, faults)
    scenario = inject_faults(scenario, faults)
    scenario.check()
    return replace(scenario, choices=choices)


def find_scenario(scenario: Scenario | str) -> Scenario:
    """Return the scenario itself, or the scenario that `build` returns for a name.

    Raises: InputError if the argument is neither a scenario nor a known name.
    """
    if isinstance(scenario, Scenario):
        return scenario
    if not isinstance(scenario, str):  # pyright: ignore[reportUnnecessaryIsInstance]
        problem = f"must be a Scenario or a scenario's name, got a {type(scenario).__name__}"
        raise InputError("scenario", problem, fix='use a Scenario or a name such as "hovercraft/spin"')
    return _keep_scenario(scenario) if scenario in catalogue.scenario_names() else build(scenario)


@functools.lru_cache(maxsize=32)
def _keep_scenario(name: str) -> Scenario:
    """Return a scenario of the catalogue. Later calls return the same object, so that a scenario is compiled only
    once."""
    return build(name)


def _build_file(
    name: str,
    settings: Mapping[str, str],
    without: list[str],
    faults: list[str],
    others: "tuple[Calibration | None, bool, Certificate | None]",
) -> Scenario:
    """Return the scenario that a scenario file describes: the base scenario with the settings in the file.

    Logs record the base and the settings. others: arguments of `build` that are passed on unchanged.
    """
    file = read_scenario_file(name)
    build_base = functools.partial(
        build,
        file.base,
        merge_settings(file.settings, settings),
        [*file.without, *without],
        [*file.faults, *faults],
        *others,
    )
    try:
        with spell_with(spell_toml):
            scenario = build_base()
    except InputError as error:
        if named_path(error) in settings:  # not in the file, so the error must use the form that the user typed
            build_base()
        raise file.locate(error) from None
    changes: dict[str, Any] = {"name": file.name} if file.name else {}
    if file.targets:
        changes["targets"] = tuple(file.parse_target(target, signal_units(scenario)) for target in file.targets)
    return replace(scenario, **changes)


def _name_after_file(name: str, scenario: Any) -> Scenario:
    """Return the scenario that a function returned. Without a name of its own, it is named FILE.py:FUNCTION.

    Raise InputError if the function did not return a scenario.
    """
    if not isinstance(scenario, Scenario):
        problem = f"the function must return a Scenario, got {type(scenario).__name__}"
        raise InputError(f"scenario {name!r}", problem, fix="return Scenario(world=…, autopilot=…) from this function")
    if ":" in name and scenario.name == Scenario.__dataclass_fields__["name"].default:
        return replace(scenario, name=Path(name).name)
    return scenario


def _refuse_gaps(name: str, scenario: Scenario, settings: Iterable[str]) -> None:
    """Raise InputError if a scenario lacks a part, or if a setting of a scenario without a base is not a field."""
    if scenario.world.vehicle is None:
        known = declarations(scenario)
        for path in [path for path in settings if path.partition(".")[0] not in known]:
            fix = 'write  base = "hovercraft/spin"  to base the file on a scenario of the catalogue'
            raise InputError(argument_name("settings", path), "unknown setting", choices=["base", *known], fix=fix)
    for path, example in NEEDED.items():
        owner, _, field = path.rpartition(".")
        if getattr(getattr(scenario, owner) if owner else scenario, field) is not None:
            continue
        if ":" in name:
            fix = f"write {field}={PARTS[field]} in {owner.capitalize() or 'Scenario'}(…)"
            raise InputError(f"scenario {name!r}", f"{path} is None", fix=fix)
        fix = f"set the class of the part: {argument('settings', example, path)}"
        raise InputError(argument_name("settings", path), "this part of the scenario is missing", fix=fix)


def _typed_reference(name: str, settings: Mapping[str, str]) -> str:
    """Return the reference path given as text or file name in the setting "reference".

    Return "" if the setting is missing, or is the name of a reference that the scenario defines.
    """
    text = settings.get(REFERENCE, "")
    return "" if text in catalogue.scenario_choices(name).get(REFERENCE, ()) else text


def _replace_links_by_recordings(scenario: Scenario, settings: Mapping[str, str]) -> Scenario:
    """Return the scenario with links that replay the recordings in ``uplink=FILE.csv`` and ``downlink=FILE.csv``.

    Each new link has the sending period of the replaced link. The receiver polls the link every millisecond.

    Raises: InputError for a file that is not the recording of a link.
    """
    world = scenario.world
    for name in LINKS:
        if name in settings:
            file, own = settings[name], getattr(world, name)
            if not file.endswith(".csv"):
                fix = f"{argument('settings', 'FILE.csv', name)}, a file written by  trimtab link-test URI --out DIR"
                raise InputError(argument_name("settings", name), f"{file!r} is not a recording of a link", fix=fix)
            trace, each = read_trace(file), optional_member(own, "send_period") or own.period
            slots = required_slots(float(trace.latency_s.max()), each, ms(1))
            link = LatencyTrace.of(trace, send_period=each, period=ms(1), capacity=max(slots, 64))
            world = replace(world, **{name: link})
    return replace(scenario, world=world)


def _add_predictor(scenario: Scenario, settings: Mapping[str, str]) -> Scenario:
    """Return the scenario with a predictor if ``predictor=on`` is set. It uses the autopilot's vehicle model.

    Raises: InputError for a value other than "on" and "off", or for an uplink with unknown latency.
    """
    chosen = settings.get(PREDICTOR, "off")
    if chosen not in SWITCH:
        problem = f"{chosen!r} is not a valid choice"
        raise InputError(
            argument_name("settings", PREDICTOR), problem, choices=SWITCH, fix=argument("settings", "on", PREDICTOR)
        )
    if chosen == "off":
        return scenario
    made = predictor_for(scenario.world, scenario.autopilot, scenario.initial)
    return replace(scenario, autopilot=replace(scenario.autopilot, predictor=made))


def _find_gain(settings: Mapping[str, str], reference: str) -> "Certificate | None":
    """Return the feedback gain in the file that the setting "gain" names, or None without this setting.

    Raise InputError if a reference path is set as well.
    """
    if GAIN not in settings:
        return None
    if reference:
        fix = f"leave out gain or reference; to change the trim state: {argument('settings', '…', 'autopilot.law.x0')}"
        raise InputError(
            argument_name("settings", REFERENCE),
            "a law with a gain file keeps one trim state and cannot follow a reference path",
            fix=fix,
        )
    from trimtab.scenarios.gain_file import read_gain

    return read_gain(settings[GAIN])


def _add_gain(name: str, scenario: Scenario, gain: "Certificate") -> tuple[Scenario, dict[str, str]]:
    """Return the scenario with a feedback gain as its law, and the log entry that describes the gain."""
    from trimtab.scenarios.gain_file import note_gain, with_gain

    return with_gain(name, scenario, gain), note_gain(gain)


def _check_gain(gain: "Certificate | None", scenario: Scenario) -> None:
    """Raise InputError if the loop with the gain is unstable at the scenario's control period."""
    if gain is not None:
        from trimtab.scenarios.gain_file import refuse_slow_sampling

        refuse_slow_sampling(gain, scenario.autopilot.period)


def _calibrate(scenario: Scenario, calibration: Calibration) -> tuple[Scenario, dict[str, Any]]:
    """Return the scenario with the values of a calibration, and the log entry that describes the calibration."""
    calibrated = with_calibration(scenario, calibration)
    about = {"sha256": calibration.content_hash(), "used": calibrated.used, "unused": list(calibrated.unused)}
    return calibrated.scenario, about | {"content": format_calibration(calibration)}


def _refuse_choices(name: str, scenario: Scenario, rest: Mapping[str, str]) -> None:
    """Raise InputError for the name of a setting that the scenario does not have. The message suggests similar
    names."""
    paths = [path for path, _, _ in leaves(scenario)]
    known = [*catalogue.scenario_choices(name), *SPECIAL, *(p for p in paths if "." not in p)]
    for wrong in [n for n in rest if "." not in n and n not in known]:
        near = closest(wrong, [*known, *paths], 6)
        show = command(f"trimtab list {name}", f'settings("{name}")') + "  shows every setting by its path"
        fix = f"{argument('settings', rest[wrong], near[0])}      {show}" if near else show
        problem = f"unknown setting of scenario {name!r}"
        raise InputError(argument_name("settings", wrong), problem, choices=near or known, fix=fix)


def _refuse_navigation(name: str) -> None:
    chosen = {n: catalogue.scenario_choices(n).get("navigation", ()) for n in catalogue.scenario_names()}
    offer = [n for n, choices in chosen.items() if choices]
    problem = f"scenario {name!r} has only one navigation system; scenarios with a choice: {', '.join(offer)}"
    fix = "leave this setting out; to see the choices of this scenario:  " + command(
        f"trimtab list {name}", f'settings("{name}")'
    )
    raise InputError(argument_name("navigation"), problem, fix=fix)
