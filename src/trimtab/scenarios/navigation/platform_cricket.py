"""Locate the end of a rotating arm by ultrasonic fixes, late and without time stamps. Errors grow with the speed."""

import math
from typing import Literal

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms
from trimtab.estimators.inertial.aided import Intake
from trimtab.laws.turntable import Turntable
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.navigation._platform import FIX_INTERVAL, LEAK, Covariance, Form, rig_scenario
from trimtab.sensors.heading import HeadingSensor
from trimtab.sensors.imu import Imu
from trimtab.sensors.late_fix import LateFix
from trimtab.sensors.position import PositionSensor

Rate = Literal["-115", "-57", "-230"]
StampTime = Literal["arrival", "measurement"]
HEADING_LATENCY, POSITION_LATENCY = 0.087, 0.120
"""Latencies of the measured heading and of the measured position (s), fitted to five figures in the thesis."""
FIX = 0.0044
"""Standard deviation of each coordinate of a position fix (m). Half of the fixes have errors of less than 0.52 cm, as
in fig. 5.8 of the thesis (Kulis 2006)."""
BASE = 0.2032
"""Distance (m) from ultrasonic receiver A, at the end of the arm, to receiver B. We estimate that receiver B is 4
inches from the axis."""
TURN = math.sqrt(2) * FIX / BASE
"""Standard deviation of the heading that is computed from the positions of the two ultrasonic receivers (rad)."""


def scenario(
    rate: Rate = "-115",
    stamped: StampTime = "arrival",
    covariance: Covariance = "consistent",
    form: Form = "feedforward",
) -> Scenario:
    """Return the scenario with ultrasonic ranging of section 6.2.1 in the thesis (Kulis 2006).

    `covariance=literal` selects the filter as published. `stamped=measurement` adds time stamps to the fixes.
    """
    fix = LateFix(latency=POSITION_LATENCY, interval=FIX_INTERVAL, stamped=stamped)
    turned = LateFix(latency=HEADING_LATENCY, interval=ms(100), stamped=stamped)
    first, second = (replace(turned, interval=ms(200), offset=o) for o in (0, ms(100)))
    sensors = {
        "imu": Imu.microstrain_3dm_gx1(),
        "heading": HeadingSensor(noise=TURN, timing=turned),
        "position": PositionSensor(noise=FIX, timing=fix),
        "unit_a": PositionSensor(noise=FIX, timing=first),
        "unit_b": PositionSensor(noise=FIX, timing=second, lever_arm=(0.0, BASE, 0.0)),
    }
    return rig_scenario(
        "navigation/platform-cricket",
        sensors,
        Turntable(rate=float(rate) * DEG),
        intake=Intake(),
        covariance=covariance,
        form=form,
        noise={"forward": LEAK, "starboard": LEAK, "heading": TURN**2, "position": FIX**2},
    )
