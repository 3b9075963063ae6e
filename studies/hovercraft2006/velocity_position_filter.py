"""Velocity and position filter on the arm of the rotating platform: encoder and ultrasound.

Covariances are as printed (`literal`), with one fix per second. Results are medians over 20 seeds. One parameter per
sensor, the tilt of the axis or the latency of positions, was fitted to the position error.
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
    """Yield the errors with the encoder, with and without tilt of the axis, and with ultrasound."""
    leaning, upright = navigation_errors("platform-encoder"), navigation_errors("platform-encoder", UPRIGHT)
    ultrasound = navigation_errors("platform-cricket", (*LITERAL, ("rate", "-115")))
    cm: dict[str, Any] = {"unit": "cm", "relative": 0.2, "basis": "input"}
    speed: dict[str, Any] = {"unit": "cm/s", "relative": 0.2}
    note = "The tilt of the axis, 0.49 deg, was fitted to this error."
    name = "encoder, -166 deg/s"
    yield within("encoder/position", f"{name}, position error", 3.4, leaning.position, PLACE, note=note, **cm)
    note = "Computed with the same tilt of the axis, 0.49 deg."
    yield within("encoder/velocity", f"{name}, velocity error", 7.5, leaning.velocity, PLACE, note=note, **speed)
    yield within(
        "encoder/velocity-upright",
        f"{name}, axis upright, velocity error",
        7.5,
        upright.velocity,
        PLACE,
        must_hold=False,
        note="Without tilt of the axis, both errors are four times smaller than printed.",
        **speed,
    )
    note = "The latency of positions, 120 ms, was fitted to this error."
    name = "ultrasound, -115 deg/s"
    yield within("cricket/position", f"{name}, position error", 8.1, ultrasound.position, PLACE, note=note, **cm)
    note = "Computed with the same latency of positions, 120 ms, and tilt of the axis, 0.49 deg."
    yield within("cricket/velocity", f"{name}, velocity error", 16.8, ultrasound.velocity, PLACE, note=note, **speed)


def figures(folder: Path) -> Iterator[Path]:
    """Plot the errors on the arm with the encoder, for figures 6.13 to 6.20."""
    runs = {"axis tilted by 0.49 deg": fly_rig("platform-encoder"), "upright": fly_rig("platform-encoder", UPRIGHT)}
    yield draw_rig(folder / "rig-encoder.png", "[1] section 6.2.1: encoder, -166 deg/s", runs)
