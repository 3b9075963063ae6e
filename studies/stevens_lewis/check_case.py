"""Check case of the F-16's program: thirteen derivatives at an extreme flight condition.

[1] prints them to seven figures, for the centre of mass at 0.4 chords. Its program computes angular
accelerations with nine inertia constants rounded to four figures, so the rows use these with the computed moments.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.study import Row, within
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import F16FlatEarth, F16State
from trimtab.vehicles.imperial import FOOT, POUND_FORCE

SECTION = "table 3.5-2"
STATE = F16State(
    speed=500 * FOOT,
    alpha=0.5,
    beta=-0.2,
    roll=-1.0,
    pitch=1.0,
    yaw=-1.0,
    roll_rate=0.7,
    pitch_rate=-0.8,
    yaw_rate=0.9,
    north=1000 * FOOT,
    east=900 * FOOT,
    altitude=10_000 * FOOT,
    power=0.9,
)
CONTROLS = F16Controls(elevator=20 * DEG, aileron=-15 * DEG, rudder=-20 * DEG, throttle=0.9)
PRINTED = {
    "speed": (-75.23724, FOOT, "ft/s^2"),
    "alpha": (-0.8813491, 1.0, "rad/s"),
    "beta": (-0.4759990, 1.0, "rad/s"),
    "roll": (2.505734, 1.0, "rad/s"),
    "pitch": (0.3250820, 1.0, "rad/s"),
    "yaw": (2.145926, 1.0, "rad/s"),
    "roll_rate": (12.62679, 1.0, "rad/s^2"),
    "pitch_rate": (0.9649671, 1.0, "rad/s^2"),
    "yaw_rate": (0.5809759, 1.0, "rad/s^2"),
    "north": (342.4439, FOOT, "ft/s"),
    "east": (-266.7707, FOOT, "ft/s"),
    "altitude": (248.1241, FOOT, "ft/s"),
    "power": (-58.68999, 0.01, "%/s"),
}
"""Derivative -> printed number, factor to SI units, printed unit."""
C1, C2, C3, C4, C5, C6, C7, C8, C9 = -0.770, 0.02755, 1.055e-4, 1.642e-6, 0.9604, 1.759e-2, 1.792e-5, -0.7336, 1.587e-5
"""Inertia constants of the program, in slugs and feet."""
MOMENTUM = 160.0
"""Angular momentum of the engine (slug ft²/s)."""
RELATIVE_ERROR_MAX = 1e-5
"""Relative tolerance: the program uses 57.3 degrees per radian in one place."""
LESS = 1.3825e-4
"""Decrease of the rolling moment's coefficient with which both failing rows would hold."""
WHY = f"A Cl that is {LESS:.2e} smaller explains both p' and r'. No single table entry, given in thousandths, does."


def turn_by_constants(craft: F16FlatEarth) -> Any:
    """Return the angular acceleration (3,) due to the computed moments, with the program's constants."""
    roll, pitch, yaw = np.asarray(craft.loads(STATE, CONTROLS).wrench.moment) / (POUND_FORCE * FOOT)
    p, q, r = STATE.roll_rate, STATE.pitch_rate, STATE.yaw_rate
    return np.array(
        [
            (C2 * p + C1 * r + C4 * MOMENTUM) * q + C3 * roll + C4 * yaw,
            (C5 * p - C7 * MOMENTUM) * r + C6 * (r * r - p * p) + C7 * pitch,
            (C8 * p - C2 * r + C9 * MOMENTUM) * q + C4 * roll + C9 * yaw,
        ]
    )


def rows() -> Iterator[Row]:
    """Yield each derivative. Those of the rates use the program's constants."""
    craft = replace(F16FlatEarth(), centre=0.4)
    rate = craft.dynamics(0.0, STATE, CONTROLS)
    names = [name for name in PRINTED if name.endswith("_rate")]
    turn = dict(zip(names, turn_by_constants(craft), strict=True))
    for name, (printed, size, unit) in PRINTED.items():
        computed = turn.get(name, float(getattr(rate, name)) / size)
        of_roll = name in ("roll_rate", "yaw_rate")
        yield within(
            name,
            f"{name.replace('_', ' ')}'",
            printed,
            computed,
            "[1] table 3.5-2",
            relative=RELATIVE_ERROR_MAX,
            unit=unit,
            must_hold=not of_roll,
            note=WHY if of_roll else "",
        )
