"""A scenario from what is typed: its name, settings, and what is left out of it or broken in it."""

from collections.abc import Iterable, Mapping

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import leaves, replace
from trimtab.core.time import ms
from trimtab.links.fifo import required_slots
from trimtab.links.latency_trace import LatencyTrace, read_trace
from trimtab.loop.fault_text import inject_faults
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.scenarios import catalogue

LINKS = ("uplink", "downlink")
MISMATCH = "mismatch"


def build(
    name: str, settings: Mapping[str, str] | None = None, without: Iterable[str] = (), faults: Iterable[str] = ()
) -> Scenario:
    """The scenario of a name with its settings, checked; it notes in `choices` what it was built from.

    Args:
        name: in the catalogue, or ``file.py:function``.
        settings: text by path, as after ``--set``; a file for "uplink" or "downlink" makes the link repeat a recording,
            "mismatch" names copies of the vehicle that are meant to differ (`loop.beliefs`).
        without: imperfections to switch off.
        faults: to inject, as after ``--fault``.

    Raises: InputError with what to type instead.
    """
    settings, without, faults = settings or {}, list(without), list(faults)
    scenario, rest = catalogue.load_scenario(name, settings)
    if not isinstance(scenario, Scenario):
        problem = f"the function gives {type(scenario).__name__}, not a Scenario"
        raise InputError(f"scenario {name!r}", problem, fix="return Scenario(world=…, autopilot=…)")
    if "navigation" in rest:
        _refuse_navigation(name)
    choices = {
        "scenario": name,
        "arguments": {argument: text for argument, text in settings.items() if argument not in rest},
        "settings": rest,
        "without": without,
        "faults": faults,
    }
    scenario = _replace_links_by_recordings(scenario, rest)
    if MISMATCH in rest:
        scenario = replace(scenario, mismatch=tuple(path.strip() for path in rest[MISMATCH].split(",")))
    own = {path: text for path, text in rest.items() if path not in (*LINKS, MISMATCH)}
    _refuse_choices(name, scenario, own)
    scenario = with_settings(scenario, own)
    for imperfection in without:
        scenario = scenario.without(imperfection)
    scenario = inject_faults(scenario, faults)
    scenario.check()
    return replace(scenario, choices=choices)


def _replace_links_by_recordings(scenario: Scenario, settings: Mapping[str, str]) -> Scenario:
    """The scenario over the recordings that ``uplink=FILE.csv`` and ``downlink=FILE.csv`` among the settings name.

    Packets leave as often as those of the link whose place it takes, and the far end looks each millisecond.

    Raises: InputError for a file that is no recording.
    """
    world = scenario.world
    for name in LINKS:
        if name in settings:
            file, own = settings[name], getattr(world, name)
            if not file.endswith(".csv"):
                fix = f"--set {name}=FILE.csv, as  trimtab link-test URI --out DIR  writes it"
                raise InputError(f"--set {name}", f"{file!r} is no recording", fix=fix)
            trace, each = read_trace(file), optional_member(own, "send_period") or own.period
            slots = required_slots(float(trace.latency_s.max()), each, ms(1))
            link = LatencyTrace.of(trace, send_period=each, period=ms(1), capacity=max(slots, 64))
            world = replace(world, **{name: link})
    return replace(scenario, world=world)


def _refuse_choices(name: str, scenario: Scenario, rest: Mapping[str, str]) -> None:
    """Refuse a name that is neither a choice of the scenario nor a setting of its own; both are shown."""
    settings, choices = (
        [p for p, _, _ in leaves(scenario) if "." not in p],
        [*catalogue.scenario_choices(name), *LINKS, MISMATCH],
    )
    for wrong in [n for n in rest if "." not in n and n not in settings]:
        problem = f"scenario {name!r} has no such choice and no such setting"
        fix = f"trimtab list {name}  shows every setting by its path"
        raise InputError(f"--set {wrong}", problem, choices=[*choices, *settings], fix=fix)


def _refuse_navigation(name: str) -> None:
    chosen = {n: catalogue.scenario_choices(n).get("navigation", ()) for n in catalogue.scenario_names()}
    offer = [n for n, choices in chosen.items() if choices]
    problem = f"scenario {name!r} has one navigation only; there is a choice in {', '.join(offer)}"
    fix = f"leave it out; what can be chosen here:  trimtab list {name}"
    raise InputError("--navigation", problem, fix=fix)
