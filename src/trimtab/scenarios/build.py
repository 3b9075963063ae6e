"""Build a scenario from user input: a name, settings, imperfections to switch off, and faults to inject."""

import functools
from collections.abc import Iterable, Mapping
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
"""Names of settings that are not paths in the scenario."""
SWITCH = {
    "off": "the law reads the estimate unchanged",
    "on": "a predictor propagates the estimate over the delay of both links, with the commands in transit",
}
"""Choices of the setting ``predictor``, which every scenario has."""
NEEDED = {
    "world.vehicle": "Hovercraft",
    "world.actuators": "FanDrive",
    "autopilot.estimator": "Passthrough",
    "autopilot.law": "ZeroVelocity",
    "autopilot.allocation": "ThrustVectorAllocation",
    "initial": "HovercraftState",
}
"""Parts that every scenario must have, by path, each with an example."""


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
    """Build the named scenario with these settings and check it. Its field `choices` records the arguments.

    >>> from trimtab import build
    >>> build("hovercraft/spin", {"links": "measured", "world.vehicle.mass": "3000 g"}).world.vehicle.mass
    3.0

    Args:
        name: a name in the catalogue, or ``file.py:function``, or a scenario file, ``file.toml``
            (`scenarios.toml_file`). `settings` override the settings in a file.
        settings: text or number by path, in the notation of ``--set``. These names are not paths: "uplink" or
            "downlink" gives the file of a recording that the link repeats; "uplink.delay", "uplink.jitter",
            "uplink.loss" and the same for the downlink set the latency (`loop.link_latency`); "mismatch" names vehicle
            models in the autopilot that may differ from each other (`loop.model_mismatch`); "calibration" gives a file
            of `trimtab calibrate`; "predictor" is "on" or "off" (`loop.predictor`); "reference" is the path that the
            law follows (`loop.reference_text`); "gain" gives a file of a gain that replaces the law
            (`scenarios.gain_file`). A value such as ``steps(0 s: 1, 5 s: 2)`` changes in flight
            (`loop.setpoint_schedule`). Settings override a calibration.
        without: imperfections to switch off.  faults: faults to inject, in the notation of ``--fault``.
        calibration: a calibration that is not in a file.
        in_virtual_time: True if the flight ends after the scenario's duration, so that a later fault is an error.
        gain: a gain that is not in a file.

    Raises: InputError with the text to type instead.
    """
    settings = texts_of(settings or {})
    without, faults = ([one] if isinstance(one, str) else list(one) for one in (without, faults))
    if name.endswith(TOML):
        return _build_file(name, settings, without, faults, (calibration, in_virtual_time, gain))
    path = _typed_reference(name, settings)
    scenario, rest = catalogue.load_scenario(
        name, {n: text for n, text in settings.items() if n != REFERENCE or not path}
    )
    if not isinstance(scenario, Scenario):
        problem = f"the function must return a Scenario, got {type(scenario).__name__}"
        raise InputError(f"scenario {name!r}", problem, fix="return Scenario(world=…, autopilot=…)")
    if "navigation" in rest:
        _refuse_navigation(name)
    scenario, own = with_parts(scenario, {path: text for path, text in rest.items() if path not in SPECIAL})
    _refuse_gaps(scenario, own)
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
        problem = f"a {type(scenario).__name__} is not a scenario"
        raise InputError("scenario", problem, fix='give a Scenario or a name, "hovercraft/spin"')
    return _keep_scenario(scenario) if scenario in catalogue.scenario_names() else build(scenario)


@functools.lru_cache(maxsize=32)
def _keep_scenario(name: str) -> Scenario:
    """Return a scenario of the catalogue. Later calls return the same object, so that it is compiled only once."""
    return build(name)


def _build_file(
    name: str,
    settings: Mapping[str, str],
    without: list[str],
    faults: list[str],
    others: "tuple[Calibration | None, bool, Certificate | None]",
) -> Scenario:
    """Return the scenario of a file: its base scenario with the file's settings. Logs record the base and the settings.

    others: further arguments of `build`, passed on unchanged.
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


def _refuse_gaps(scenario: Scenario, settings: Iterable[str]) -> None:
    """Raise InputError if a scenario without a base lacks a part, or if a setting is not a field of a scenario."""
    if scenario.world.vehicle is None:
        known = declarations(scenario)
        for path in [path for path in settings if path.partition(".")[0] not in known]:
            fix = 'base = "hovercraft/spin"  names the scenario that a file starts from'
            raise InputError(
                argument_name("settings", path), "there is no such setting", choices=["base", *known], fix=fix
            )
    for path, example in NEEDED.items():
        owner, _, field = path.rpartition(".")
        if getattr(getattr(scenario, owner) if owner else scenario, field) is None:
            raise InputError(
                argument_name("settings", path),
                "the part is missing",
                fix=f"name a part: {argument('settings', example, path)}",
            )


def _typed_reference(name: str, settings: Mapping[str, str]) -> str:
    """Return the setting "reference", or "" if it is missing or names one of the scenario's own references."""
    text = settings.get(REFERENCE, "")
    return "" if text in catalogue.scenario_choices(name).get(REFERENCE, ()) else text


def _replace_links_by_recordings(scenario: Scenario, settings: Mapping[str, str]) -> Scenario:
    """Return the scenario with links that repeat the recordings of ``uplink=FILE.csv`` and ``downlink=FILE.csv``.

    Each new link sends with the period of the link that it replaces. Its receiver polls every millisecond.

    Raises: InputError for a file that is not a recording.
    """
    world = scenario.world
    for name in LINKS:
        if name in settings:
            file, own = settings[name], getattr(world, name)
            if not file.endswith(".csv"):
                fix = f"{argument('settings', 'FILE.csv', name)}, as  trimtab link-test URI --out DIR  writes it"
                raise InputError(argument_name("settings", name), f"{file!r} is not a recording of a link", fix=fix)
            trace, each = read_trace(file), optional_member(own, "send_period") or own.period
            slots = required_slots(float(trace.latency_s.max()), each, ms(1))
            link = LatencyTrace.of(trace, send_period=each, period=ms(1), capacity=max(slots, 64))
            world = replace(world, **{name: link})
    return replace(scenario, world=world)


def _add_predictor(scenario: Scenario, settings: Mapping[str, str]) -> Scenario:
    """Return the scenario with a predictor that uses the autopilot's vehicle model, if ``predictor=on`` is set.

    Raises: InputError for another choice, or an uplink with unknown latency.
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
    """Return the gain in the file of the setting "gain", or None. Raise InputError if a reference is given as well."""
    if GAIN not in settings:
        return None
    if reference:
        fix = f"leave gain or reference out; to move the gain's trim: {argument('settings', '…', 'autopilot.law.x0')}"
        raise InputError(
            argument_name("settings", REFERENCE), "a gain keeps one trim state and cannot follow a reference", fix=fix
        )
    from trimtab.scenarios.gain_file import read_gain

    return read_gain(settings[GAIN])


def _add_gain(name: str, scenario: Scenario, gain: "Certificate") -> tuple[Scenario, dict[str, str]]:
    """Return the scenario with a gain as its law, and the entry that describes the gain in logs."""
    from trimtab.scenarios.gain_file import note_gain, with_gain

    return with_gain(name, scenario, gain), note_gain(gain)


def _check_gain(gain: "Certificate | None", scenario: Scenario) -> None:
    """Raise InputError if the gain needs a shorter control period than the scenario has."""
    if gain is not None:
        from trimtab.scenarios.gain_file import refuse_slow_sampling

        refuse_slow_sampling(gain, scenario.autopilot.period)


def _calibrate(scenario: Scenario, calibration: Calibration) -> tuple[Scenario, dict[str, Any]]:
    """Return the scenario with the values of a calibration, and the entry that describes the calibration in logs."""
    calibrated = with_calibration(scenario, calibration)
    about = {"sha256": calibration.content_hash(), "used": calibrated.used, "unused": list(calibrated.unused)}
    return calibrated.scenario, about | {"content": format_calibration(calibration)}


def _refuse_choices(name: str, scenario: Scenario, rest: Mapping[str, str]) -> None:
    """Raise InputError, with similar names, for a name that is neither a choice nor a setting of the scenario."""
    paths = [path for path, _, _ in leaves(scenario)]
    known = [*catalogue.scenario_choices(name), *SPECIAL, *(p for p in paths if "." not in p)]
    for wrong in [n for n in rest if "." not in n and n not in known]:
        near = closest(wrong, [*known, *paths], 6)
        show = command(f"trimtab list {name}", f'settings("{name}")') + "  shows every setting by its path"
        fix = f"{argument('settings', '…', near[0])}      {show}" if near else show
        problem = f"scenario {name!r} has no choice and no setting of this name"
        raise InputError(argument_name("settings", wrong), problem, choices=near or known, fix=fix)


def _refuse_navigation(name: str) -> None:
    chosen = {n: catalogue.scenario_choices(n).get("navigation", ()) for n in catalogue.scenario_names()}
    offer = [n for n, choices in chosen.items() if choices]
    problem = f"scenario {name!r} has only one navigation; these scenarios offer a choice: {', '.join(offer)}"
    fix = "leave it out; to see the choices here:  " + command(f"trimtab list {name}", f'settings("{name}")')
    raise InputError(argument_name("navigation"), problem, fix=fix)
