"""Flight of a scenario with a gain file of ``trimtab design VEHICLE --lqr --out FILE``: setting ``gain=FILE.json``.

The gain replaces the scenario's law, and feeds back deviations from the trim point in the file. The law's vehicle model
is the vehicle for which the gain was designed. The simulated vehicle is still that of the scenario. A gain file is
data: no code that is named in it is run, except the scenarios of the catalogue.

Source: docs page, Gains in flight.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.linalg import expm

from trimtab.actuators.allocation import DirectAllocation
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import children, is_record, replace, to_arrays
from trimtab.core.rng import Key
from trimtab.core.time import format_time, to_seconds
from trimtab.design.certificate import Certificate
from trimtab.design.certificate_file import certificate_digest, certificate_json, read_certificate
from trimtab.laws.state_feedback import StateFeedback
from trimtab.logs.metrics import Target
from trimtab.loop.linear_laws import describe_vehicle, feedback_law, state_numbers
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_parts, with_settings
from trimtab.loop.walk import start
from trimtab.scenarios import catalogue
from trimtab.scenarios.catalogue import GAIN

VEHICLE = "world.vehicle."
BAND = 0.2
"""Tolerance of a target value, as a fraction of the allowed deviation of the state in the gain's design."""
TURNING = "rad/s"
"""Unit of angular rates. A flight with a gain file has no target values for states with this unit."""


def read_gain(file: str) -> Certificate:
    """Read a gain file.

    Raises: InputError for a file that is not a gain file, or that was changed after it was written.
    """
    certificate, digest = read_certificate(Path(file))
    if certificate_digest(certificate) != digest:
        fix = f"write the file again: trimtab design {certificate.system} --lqr … --out {file}"
        raise InputError(
            f"file '{file}'", "was changed after it was written: its digest does not match its content", fix=fix
        )
    return certificate


def note_gain(certificate: Certificate) -> dict[str, str]:
    """Return the log entry of a gain. It contains the complete gain file, because the file may be deleted later."""
    return {"system": certificate.system, "content": certificate_json(certificate)}


def vehicle_settings(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return settings of a vehicle with paths relative to the vehicle: ``mass`` for ``world.vehicle.mass``.

    pairs: path and text of each setting.
    """
    return {path.removeprefix(VEHICLE): text for path, text in pairs}


def with_gain(name: str, scenario: Scenario, certificate: Certificate) -> Scenario:
    """Return the scenario with a feedback gain as its law. The target values of the flight are the trim values.

    Args:
        name: name of the scenario, as the user typed it.
        scenario: scenario with this name.
        certificate: content of the gain file.

    Raises: InputError if the gain is for another vehicle, or feeds back a state that the autopilot does not estimate.
    """
    world, autopilot, x = scenario.world, scenario.autopilot, scenario.initial
    u = world.actuators.neutral().u
    _refuse_other_vehicle(certificate, describe_vehicle(world.vehicle, x, u))
    law = feedback_law(certificate, x, u, _assumed_vehicle(name, certificate))
    key, free = Key(np.uint32(0), np.uint32(0)), replace(autopilot, supervisor=None, monitor=None)
    _, state = jax.eval_shape(lambda: start(to_arrays(world), to_arrays(free), to_arrays(x), key))
    _refuse_unread(law, state.estimate.state, certificate.system)
    if not _are_alike(state.output.demand, u):
        if not _are_alike(state.command.value, u):
            problem = f"the scenario's actuators need a {type(state.command.value).__name__}, not the vehicle's input"
            fix = f"leave {argument_name('settings', GAIN)} out: this scenario cannot fly with a gain"
            raise InputError(argument_name("settings", GAIN), f"{problem}, a {type(u).__name__}", fix=fix)
        autopilot = replace(autopilot, allocation=DirectAllocation())
    autopilot = replace(autopilot, law=law, schedules=())
    return replace(scenario, autopilot=autopilot, targets=_trim_targets(certificate, law, x))


def refuse_slow_sampling(certificate: Certificate, period: int) -> None:
    """Raise InputError if the loop with the gain is unstable when sampled. period: control period (100 ns)."""
    n, m = certificate.B.shape
    size = np.zeros((n + m, n + m))
    size[:n, :n], size[:n, n:] = certificate.A, certificate.B
    held = expm(size * to_seconds(period))
    largest = float(np.abs(np.linalg.eigvals(held[:n, :n] + held[:n, n:] @ certificate.K)).max())
    if largest >= 1:
        fastest = float(np.abs(certificate.poles).max())
        problem = (
            f"the loop is not stable with a control period of {format_time(period)}: the fastest pole of the design is "
            f"{fastest:.3g} 1/s, and the largest pole of the sampled loop is {largest:.4g}, but must be below 1"
        )
        fix = f"design the gain with larger limits of states, or {argument('settings', '1 ms', 'autopilot.period')}"
        raise InputError(argument_name("settings", GAIN), problem, fix=fix)


def _refuse_other_vehicle(certificate: Certificate, own: dict[str, str]) -> None:
    about, anew = certificate.about, "trimtab design SCENARIO --lqr … --out FILE.json"
    if "vehicle" not in about:
        problem = f"the file is a certificate of {certificate.system!r}, not a gain for the states of a vehicle"
        raise InputError(argument_name("settings", GAIN), problem, fix=f"{anew}  (docs page, Gains in flight)")
    if about["vehicle"] != own["vehicle"]:
        problem = (
            f"the gain is for a {about['vehicle']} ({certificate.system}), but the scenario has a {own['vehicle']}"
        )
        raise InputError(argument_name("settings", GAIN), problem, fix=f"{anew}, for this scenario")
    if about.get("units") != own["units"]:
        here, there = (str(text).split("; ") for text in (own["units"], about.get("units", "")))
        apart = [f"{a!r} in the file, {b!r} in this scenario" for a, b in zip(there, here, strict=False) if a != b]
        problem = f"the gain's states or inputs differ from this vehicle's: {(apart or ['their number differs'])[0]}"
        raise InputError(argument_name("settings", GAIN), problem, fix=f"{anew}, for this scenario")


def _refuse_unread(law: StateFeedback, estimate: Any, system: str) -> None:
    given = [n for n, _, _ in children(estimate)] if is_record(estimate) else []
    lacking = [n for n in law.reads if n not in given]
    if lacking:
        problem = f"the gain feeds back {', '.join(lacking)}, which the autopilot of this scenario does not estimate"
        design_command = f"trimtab design {system} --lqr …"
        for name in lacking:
            design_command = f"{design_command} --fast {name}"
        fix = f"{design_command}  designs a gain without feedback of these states, if they settle by themselves"
        raise InputError(argument_name("settings", GAIN), problem, choices=given, fix=fix)


def _assumed_vehicle(name: str, certificate: Certificate) -> Any:
    """Return the vehicle for which a gain was designed, as described in the gain file. name: name of the scenario."""
    about = {n: str(certificate.about.get(n, "")) for n in ("set", "assume")}
    given, assumed = (
        [(path, text) for path, _, text in (word.partition("=") for word in words.split("; ") if word)]
        for words in about.values()
    )
    if "calibration" in dict(given):
        fix = "design the gain without calibration: trimtab design SCENARIO --lqr … --assume NAME=VALUE"
        raise InputError(
            argument_name("settings", GAIN),
            "the gain was designed with a calibration, which the gain file does not contain",
            fix=fix,
        )
    own = certificate.system if certificate.system in catalogue.scenario_names() else name
    scenario, rest = catalogue.load_scenario(own, {**catalogue_choices(own, given)})
    paths = {path: text for path, text in given if f"{path}.".startswith(VEHICLE)}
    scenario, left = with_parts(scenario, rest | paths)
    vehicle = with_settings(scenario.world.vehicle, vehicle_settings(left.items()))
    return with_settings(vehicle, vehicle_settings(assumed))


def catalogue_choices(name: str, pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return those settings in `pairs` that are arguments of a scenario's function, by name."""
    offered = catalogue.scenario_choices(name)
    return {path: text for path, text in pairs if path in offered}


def _are_alike(a: Any, b: Any) -> bool:
    shapes = [[np.shape(v) for v in jax.tree.leaves(tree)] for tree in (a, b)]
    return jax.tree.structure(a) == jax.tree.structure(b) and shapes[0] == shapes[1]


def _trim_targets(certificate: Certificate, law: StateFeedback, x: Any) -> tuple[Target, ...]:
    """Return a target, with the trim value, for each state that is fed back, except attitudes and angular rates.

    The tolerance of a target is BAND times the allowed deviation used in the design.
    """
    sizes = dict(zip(certificate.states, np.asarray(certificate.scale).tolist(), strict=True))
    numbers = state_numbers(law, x)
    return tuple(
        Target(f"truth.{n.path}", n.value, BAND * sizes[n.state])
        for n in numbers
        if n.state in sizes and n.unit != TURNING
    )
