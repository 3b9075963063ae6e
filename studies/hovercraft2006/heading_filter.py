"""Heading filter on the rotating platform: magnetometer and ultrasound.

The filters use the covariances printed in the thesis (`literal`). Each row has its own tolerance for the printed
error. Results are medians over 20 seeds.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.hovercraft2006._rig import (
    LITERAL,
    draw_rig,
    fly_rig,
    navigation_errors,
    network_errors,
    two_unit_errors,
)
from trimtab.study import Row, band, within

SECTION = "6.2.1"
PLACE = "[1] section 6.2.1"
CRICKET = {"-57": 5.0, "-115": 9.8, "-230": 20.0}
"""Rate (deg/s) -> printed heading error (deg)."""
RATE = (
    "The computed error is relative to the true rate. The printed error is relative to a tachometer, whose noise is "
    "not printed. A noise of 3.5 deg/s would explain the difference, but there is no evidence for it."
)


def rows() -> Iterator[Row]:
    """Yield heading and rate with the magnetometer, heading with ultrasound at three rates, and from two
    ultrasonic units."""
    errors = navigation_errors("platform-magnetometer")
    yield band(
        "heading/magnetometer",
        "magnetometer, -166 deg/s, heading error",
        0.5,
        errors.heading,
        PLACE,
        low=0.4,
        high=0.6,
        unit="deg",
        note="No parameter is fitted: the magnetometer's noise is the printed R1.",
    )
    yield within(
        "rate/magnetometer",
        "magnetometer, -166 deg/s, rate error",
        3.7,
        errors.yaw_rate,
        PLACE,
        tolerance=0.2,
        unit="deg/s",
        must_hold=False,
        note=RATE,
    )
    for rate, printed in CRICKET.items():
        errors = navigation_errors("platform-cricket", (*LITERAL, ("rate", rate)))
        given = rate == "-115"
        note = "One latency, 87 ms, was fitted to the headings at three rates. At this rate it is an input."
        yield within(
            f"heading/cricket{rate}",
            f"ultrasound, {rate} deg/s, heading error",
            printed,
            errors.heading,
            PLACE,
            relative=0.1,
            unit="deg",
            basis="input" if given else "text",
            note=note if given else "Computed with the fitted latency of 87 ms.",
        )
    rate = navigation_errors("platform-cricket", (*LITERAL, ("rate", "-115"))).yaw_rate
    yield within(
        "rate/cricket",
        "ultrasound, -115 deg/s, rate error",
        4.1,
        rate,
        "[1] table 6.7",
        tolerance=0.2,
        unit="deg/s",
        must_hold=False,
        note=RATE,
    )
    yield from _two_unit_rows()


def _two_unit_rows() -> Iterator[Row]:
    raw, helped = two_unit_errors((*LITERAL, ("rate", "-115")))
    yield band(
        "two-units/raw",
        "two ultrasonic units with fixes 100 ms apart, -115 deg/s, heading error",
        25.0,
        raw,
        PLACE,
        low=20.0,
        high=30.0,
        unit="deg",
        basis="text",
        note="The position of ultrasonic unit B is our estimate: on the arm, 4 inches from the axis.",
    )
    yield band(
        "two-units/assisted",
        "two ultrasonic units, -115 deg/s, with inertial assistance, heading error",
        10.0,
        helped,
        PLACE,
        low=8.0,
        high=12.0,
        unit="deg",
        basis="text",
        note="Nearly all of this error is due to latency. Without the latency of the fixes it would be 2.3°.",
    )
    _, error = network_errors("-115")
    yield band(
        "network/raw",
        "two units of the simulated ultrasonic network, -115 deg/s, heading error",
        25.0,
        error,
        PLACE,
        low=20.0,
        high=30.0,
        unit="deg",
        basis="text",
        note="Ranges, replies and their collisions simulated: no latency is fitted.",
    )


def figures(folder: Path) -> Iterator[Path]:
    """Plot errors of the heading filter, for figures 6.13 to 6.20."""
    runs = {"magnetometer, -166 deg/s": fly_rig("platform-magnetometer")}
    yield draw_rig(folder / "rig-magnetometer.png", "[1] section 6.2.1: heading by magnetometer", runs)
    runs = {f"{rate} deg/s": fly_rig("platform-cricket", (*LITERAL, ("rate", rate))) for rate in CRICKET}
    yield draw_rig(folder / "rig-ultrasound.png", "[1] section 6.2.1: navigation by ultrasound", runs)
