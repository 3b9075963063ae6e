"""Velocity and position filter on the arm of the rotating platform: encoder and ultrasound.

Accepted bands are around what an independent program of the source's filters gave, see the docs page. Covariances as
printed (`literal`), fixes once a second, medians over 20 seeds.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.
"""

from collections.abc import Iterator
from typing import Any

from studies.hovercraft2006._rig import LITERAL, navigation_errors
from trimtab.study import Row, band, direction, within

SECTION = "6.2.1"
PLACE = "[1] section 6.2.1"
UPRIGHT = (*LITERAL, ("world.vehicle.tilt", "0"))


def rows() -> Iterator[Row]:
    """Encoder with and without the lean of the axis; ultrasound as it was, and with its fixes stamped."""
    leaning, upright = navigation_errors("platform-encoder"), navigation_errors("platform-encoder", UPRIGHT)
    fitted = "One tilt of the axis, 0.49 deg, fitted to position and velocity."
    place: dict[str, Any] = {"unit": "cm"}
    speed: dict[str, Any] = {"unit": "cm/s"}
    name = "encoder, -166 deg/s"
    yield band("encoder/position", f"{name}, position error", 3.4, leaning.position, PLACE, low=3.0, high=3.9, **place)
    what = f"{name}, velocity error"
    yield band("encoder/velocity", what, 7.5, leaning.velocity, PLACE, low=6.5, high=8.3, note=fitted, **speed)
    for key, printed, computed, tolerance, about in (
        ("position", 0.87, upright.position, 0.3, place),
        ("velocity", 1.7, upright.velocity, 0.5, speed),
    ):
        what = f"{name}, axis upright, {key} error"
        yield within(
            f"encoder/{key}-upright", what, printed, computed, PLACE, tolerance=tolerance, basis="reference", **about
        )
    found, name = navigation_errors("platform-cricket", (*LITERAL, ("rate", "-115"))), "ultrasound, -115 deg/s"
    fitted = "A second latency, 120 ms, fitted to position and velocity; the same tilt."
    yield band("cricket/position", f"{name}, position error", 8.1, found.position, PLACE, low=6.0, high=10.5, **place)
    what = f"{name}, velocity error"
    yield band("cricket/velocity", what, 16.8, found.velocity, PLACE, low=12.0, high=21.0, note=fitted, **speed)
    stamped = navigation_errors("platform-cricket", (*LITERAL, ("rate", "-115"), ("stamped", "measurement")))
    yield direction(
        "cricket/stamped",
        "the same with each fix used at its own time, velocity error over that without",
        "fixes are late",
        stamped.velocity / found.velocity,
        PLACE,
        below=0.8,
        note="Not in the source: what its time stamps would have bought.",
    )
