"""Parts that all scenarios on the rotating platform share: platform, inertial unit and aided inertial navigation.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
6.2.1. The latencies and the tilt are fitted to the figures in [1] (docs, Errata).
"""

import math
from collections.abc import Mapping
from typing import Any, Literal

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.rotation import DEG
from trimtab.core.time import seconds, to_seconds
from trimtab.environment.geodetic import STANDARD
from trimtab.environment.magnetic import COLLEGE_PARK
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.direct import AidedInertialDirect
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.laws.turntable import Turntable
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.vehicles.rotating_platform import PlatformDrive, RotatingPlatform

Covariance = Literal["consistent", "literal"]
"""Use of the process noise in the filter. consistent: with consistent units. literal: as printed in [1]."""
Form = Literal["feedforward", "feedback", "direct", "coupled"]
FORMS: dict[str, Any] = {
    "feedforward": AidedInertialFeedforward,
    "feedback": AidedInertialFeedback,
    "direct": AidedInertialDirect,
    "coupled": AidedInertialCoupled,
}
ARM = 0.3048
TILT = 0.49 * DEG
"""Tilt of the platform's axis of rotation (rad), fitted to two figures in [1].

The axis is tilted towards magnetic north. In this direction the tilt causes no error of a compass without tilt
compensation. In any other direction, it would cause a constant error.
"""
LEAN = math.atan2(COLLEGE_PARK[1], COLLEGE_PARK[0])
FIX_INTERVAL = seconds(1)
"""Time between position fixes. It is our choice: the simulation of [1] draws new navigation errors once a second."""
LEAK = (STANDARD * math.sin(TILT)) ** 2 * to_seconds(FIX_INTERVAL) / to_seconds(InertialNoise().tick)
"""Variance of the specific force noise (m^2/s^4) that covers the effect of the unknown tilt between two fixes."""


def rig_scenario(
    name: str,
    sensors: dict[str, Any],
    law: Turntable,
    *,
    arm: float = ARM,
    time_constant: float = 0.1,
    intake: Intake,
    covariance: Covariance = "consistent",
    form: Form = "feedforward",
    noise: Mapping[str, float] | None = None,
    estimator: Any = None,
) -> Scenario:
    """Return a scenario on the rotating platform.

    Args:
        name: name of the scenario in the catalogue.
        sensors: sensors of the world, by name.
        law: law of the platform's rotation.
        arm: distance from the axis to the inertial unit (m).
        time_constant: time constant of the motor (s). We estimate a value between 0.05 and 0.1.
        intake: selection of the samples that the navigation filter uses.
        covariance: use of the process noise in the filter.
        form: class of the aided inertial navigation filter.
        noise: noise values to use instead of those printed in [1]. With covariance "literal", they are not used.
        estimator: function that returns the estimator for a navigation filter. None: the filter is the estimator.
    """
    platform = RotatingPlatform(arm=arm, time_constant=time_constant, tilt=TILT, lean=LEAN)
    assumed: dict[str, Any] = dict(noise) if noise and covariance == "consistent" else {}
    navigation = FORMS[form](intake=intake, noise=InertialNoise(covariance=covariance, **assumed))
    if estimator is not None:
        navigation = estimator(navigation)
    world = World(
        vehicle=platform,
        sensors=sensors,
        downlink=Wire(),
        uplink=Wire(),
        actuators=DirectActuation(neutral_input=PlatformDrive(rate=0.0)),
    )
    autopilot = Autopilot(estimator=navigation, law=law, allocation=DirectAllocation())
    targets = (Target("truth.yaw_rate", law.rate, 0.02),) if law.waveform == "constant" else ()
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=platform.rest_state(),
        duration=seconds(30),
        targets=targets,
        name=name,
    )
