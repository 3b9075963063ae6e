"""Common parts of the rig's scenarios: platform, inertial unit, aided inertial navigation.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
6.2.1. Fitted to its figures, as docs Errata says: latencies, tilt.
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
"""Use of the process noise: with consistent units, or as printed."""
Form = Literal["feedforward", "feedback", "direct", "coupled"]
FORMS: dict[str, Any] = {
    "feedforward": AidedInertialFeedforward,
    "feedback": AidedInertialFeedback,
    "direct": AidedInertialDirect,
    "coupled": AidedInertialCoupled,
}
ARM = 0.3048
TILT = 0.49 * DEG
"""Tilt of the spin axis: fitted, one number for two figures. It leans to magnetic north, so that a compass without tilt
compensation has no error; another direction would add a constant to its heading."""
LEAN = math.atan2(COLLEGE_PARK[1], COLLEGE_PARK[0])
FIX_INTERVAL = seconds(1)
"""Time between positions: reconstructed; the thesis's own simulation renews its navigation errors once a second."""
LEAK = (STANDARD * math.sin(TILT)) ** 2 * to_seconds(FIX_INTERVAL) / to_seconds(InertialNoise().tick)
"""Effect of the lean on a level navigation between two positions, as white noise of each force sample (m^2/s^4)."""


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
    """Return a scenario on the rig: sensors of the world by name, and the platform's rotation.

    Args:
        arm: from the axis to the body (m).
        time_constant: of the motor (s); between 0.05 and 0.1, reconstructed.
        intake: samples that the navigation reads.
        noise: noise of a consistent filter besides the printed values; the literal one has only those.
        estimator: function that makes the estimator from the navigation, or None.
    """
    platform = RotatingPlatform(arm=arm, time_constant=time_constant, tilt=TILT, lean=LEAN)
    believed: dict[str, Any] = dict(noise) if noise and covariance == "consistent" else {}
    navigation = FORMS[form](intake=intake, noise=InertialNoise(covariance=covariance, **believed))
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
