"""Parts that all scenarios of the hypersonic vehicle share: plant, measurements, filter of the bending modes, and law.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206. The paper does not print commands, filters, noise and limits, so their values are
our choice, explained on the docs page.
"""

from typing import Any, Literal

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.estimators.flexible.adaptive import AdaptiveFlexibleModeFilter
from trimtab.estimators.flexible.discrete import FlexibleModeFilter
from trimtab.laws.adaptive_robust import AdaptiveRobust
from trimtab.laws.internal_states import QuasiStaticInternal
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.stable_inversion import StableInversion
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.scenarios.hypersonic._design import NOMINAL, error_model, feedback_gain
from trimtab.scenarios.hypersonic._internal import (
    level_trim,
    linear_table,
    noncausal_table,
    preview_internal,
    sylvester_internal,
)
from trimtab.scenarios.hypersonic._plane import plane_truth
from trimtab.sensors.angular_accelerometer import AngularAccelerometer
from trimtab.sensors.flight_state import ActingInput, FlexibleTruth, FlightStateSensor
from trimtab.vehicles.hypersonic import Hypersonic

Filter = Literal["tuned", "equal", "accurate", "printed", "none", "adaptive"]
"""Settings of the filter that estimates the bending modes.

tuned: settings for flight. equal: equal process noise for both modes. accurate: settings for an exact model. printed:
settings of [1]. none: observer that uses no measurements. adaptive: filter that also estimates the modal frequencies.
"""
Internal = Literal["noncausal", "preview", "quasi-static", "sylvester", "linear"]
"""Method by which the desired internal states (angle of attack, pitch rate, bending) are computed from the command.

noncausal: table of the exact bounded solution. preview: computed in flight from the future command. quasi-static:
equilibrium at each instant. sylvester: causal linear solution. linear: table of the linear bounded solution, as in [1].
"""
Noise = Literal["off", "on"]
Integral = Literal["on", "off"]
"""Feedback of the integrals of the errors of altitude h and speed V. [1] has no integral feedback."""
Robust = Literal["off", "published", "minus", "smooth", "sign"]
"""Adaptive robust terms of the law.

off: no robust terms. published: damping term u_h with the sign printed in [1]. minus: damping term with the opposite
sign. smooth: switching term u_s with a smoothed sign function. sign: switching term with the exact sign function.
"""
Truth = Literal["paper", "plane"]
"""World model. paper: as in [1]. plane: with lags of engine and elevator, turbulence and accelerometer errors."""
TICK = ms(5)
"""Control period. [1] does not state a control period."""


def hypersonic_scenario(
    name: str,
    climb: FilteredClimb,
    duration_s: float,
    *,
    plant: Hypersonic | None = None,
    assumed: Hypersonic = NOMINAL,
    filter: Filter = "tuned",
    internal: Internal = "noncausal",
    noise: Noise = "off",
    integral: Integral = "on",
    robust: Robust = "off",
    truth: Truth = "paper",
    K: Any = None,
) -> Scenario:
    """Return a scenario that starts in level trimmed flight of the vehicle model, with the plant's modes at rest.

    Args:
        name: name of the scenario in the catalogue.
        climb: command of altitude and speed.
        duration_s: duration of the flight (s).
        plant: simulated vehicle. Default: `assumed`.
        assumed: vehicle model for law, gain, filter and the table of internal states.
        filter: settings of the filter that estimates the bending modes.
        internal: method by which the desired internal states are computed.
        noise: "on" adds noise to the angular accelerometer, with a standard deviation of 0.01 rad/s^2 per sample.
        integral: "on" feeds back the integrals of the errors of h and V.
        robust: adaptive robust terms of the law.
        truth: world model, "paper" or "plane".
        K: feedback gain (2, 9) to use instead of the designed gain. With K, the integrals are not fed back.
    """
    flown = plant or assumed
    start = level_trim(assumed, climb.h0, climb.V0)
    size = 0.01 if noise == "on" else 0.0
    sensors = {
        "flight": FlightStateSensor(period=TICK),
        "angular-accelerometer": AngularAccelerometer(period=TICK, noise=size),
        "actuators": ActingInput(period=TICK),
    }
    world = World(
        vehicle=flown,
        sensors=sensors,
        downlink=Wire(period=TICK),
        uplink=Wire(period=TICK),
        actuators=DirectActuation(neutral_input=start.u, period=TICK),
        max_step=TICK,
    )
    if truth == "plane":
        world = plane_truth(world, size)
    tracking = StableInversion(
        internal=_make_internal(internal, assumed, climb, duration_s),
        craft=assumed,
        command=climb,
        **_gain_settings(integral, K, assumed),
    )
    tracking = replace(tracking, robust=_choose_robust_terms(robust, tracking.robust))
    autopilot = Autopilot(
        estimator=_make_filter(filter, assumed), law=tracking, allocation=DirectAllocation(), period=TICK
    )
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=flown.level_state(climb.h0, climb.V0, float(start.zeta[0]), start.u.delta_e),
        duration=seconds(duration_s),
        targets=(Target("law.h_error", 0.0, 0.05), Target("law.V_error", 0.0, 0.01)),
        truth_sensor=FlexibleTruth(period=TICK),
        name=name,
    )


def _make_filter(name: Filter, assumed: Hypersonic) -> Any:
    filters: dict[str, Any] = {
        "tuned": FlexibleModeFilter(),
        "equal": FlexibleModeFilter.with_equal_noise(),
        "accurate": FlexibleModeFilter.for_exact_model(),
        "printed": FlexibleModeFilter.from_publication(),
        "none": FlexibleModeFilter(corrects=False),
        "adaptive": AdaptiveFlexibleModeFilter(),
    }
    return replace(filters[name], craft=assumed, period=TICK)


def _make_internal(form: Internal, assumed: Hypersonic, climb: FilteredClimb, duration_s: float) -> Any:
    if form == "quasi-static":
        return QuasiStaticInternal(craft=assumed)
    if form == "preview":
        return preview_internal(assumed, level_trim(assumed, climb.h0, climb.V0))
    if form == "sylvester":
        return sylvester_internal(assumed, climb)
    make = noncausal_table if form == "noncausal" else linear_table
    return make(assumed, climb, duration_s)[0]


def _gain_settings(integral: Integral, K: Any, assumed: Hypersonic) -> dict[str, Any]:
    """Return the law's settings for the given gain K or, if K is None, for the gain designed for the vehicle model.

    For the nominal vehicle without integrals, return no settings, because the law has this gain by default.
    """
    if K is not None:
        return {"K": K}
    if integral == "off" and assumed is NOMINAL:
        return {}
    gain = feedback_gain(error_model(assumed)[0], integral=integral == "on").K
    return {"K": gain[:, :9], "Ki": gain[:, 9:]} if integral == "on" else {"K": gain}


def _choose_robust_terms(name: Robust, terms: AdaptiveRobust) -> AdaptiveRobust:
    if name in ("smooth", "sign"):
        return replace(terms, switching=name)
    return replace(terms, damping=name)
