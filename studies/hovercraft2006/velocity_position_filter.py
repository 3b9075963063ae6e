"""Velocity and position filter on the arm of the rotating platform: encoder and ultrasound.

Covariances as printed (`literal`), fixes once a second, medians over 20 seeds. Of each pair of errors one number, the
lean of the axis or the latency of positions, was fitted to the position.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from studies.hovercraft2006._rig import LITERAL, draw_rig, fly_rig, navigation_errors
from trimtab.study import Row, within

SECTION = "6.2.1"
PLACE = "[1] section 6.2.1, table 6.7"
UPRIGHT = (*LITERAL, ("world.vehicle.tilt", "0"))


def rows() -> Iterator[Row]:
    """Encoder with and without the lean of the axis; ultrasound."""
    leaning, upright = navigation_errors("platform-encoder"), navigation_errors("platform-encoder", UPRIGHT)
    ultrasound = navigation_errors("platform-cricket", (*LITERAL, ("rate", "-115")))
    cm: dict[str, Any] = {"unit": "cm", "relative": 0.2, "basis": "input"}
    speed: dict[str, Any] = {"unit": "cm/s", "relative": 0.2}
    note = "One tilt of the axis, 0.49 deg, was fitted to it."
    name = "encoder, -166 deg/s"
    yield within("encoder/position", f"{name}, position error", 3.4, leaning.position, PLACE, note=note, **cm)
    note = "The same tilt."
    yield within("encoder/velocity", f"{name}, velocity error", 7.5, leaning.velocity, PLACE, note=note, **speed)
    yield within(
        "encoder/velocity-upright",
        f"{name}, axis upright, velocity error",
        7.5,
        upright.velocity,
        PLACE,
        must_hold=False,
        note="Without a lean both errors are four times smaller than printed.",
        **speed,
    )
    note = "A second latency, 120 ms, was fitted to it."
    name = "ultrasound, -115 deg/s"
    yield within("cricket/position", f"{name}, position error", 8.1, ultrasound.position, PLACE, note=note, **cm)
    note = "The same latency, and the same tilt."
    yield within("cricket/velocity", f"{name}, velocity error", 16.8, ultrasound.velocity, PLACE, note=note, **speed)


def figures(folder: Path) -> Iterator[Path]:
    """Errors on the arm with the encoder, of those in figures 6.13 to 6.20."""
    runs = {"axis leans 0.49 deg": fly_rig("platform-encoder"), "upright": fly_rig("platform-encoder", UPRIGHT)}
    yield draw_rig(folder / "rig-encoder.png", "[1] section 6.2.1: encoder, -166 deg/s", runs)
