"""Heading filter on the rotating platform: magnetometer and ultrasound.

Accepted bands are around what an independent program of the source's filters gave, see the docs page. The filters have
the source's covariances as printed (`literal`). Medians over 20 seeds.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.
"""

from collections.abc import Iterator

from studies.hovercraft2006._rig import LITERAL, navigation_errors, network_errors, two_unit_errors
from trimtab.study import Row, band, within

SECTION = "6.2.1"
PLACE = "[1] section 6.2.1"
CRICKET = {"-57": (5.0, 4.5, 6.0), "-115": (9.8, 9.0, 11.0), "-230": (20.0, 18.0, 22.0)}
"""Rate (deg/s) -> printed heading error and the accepted band (deg)."""
RATE = (
    "The filter's own error. The source's is over a tachometer's rate, whose noise is not printed: 3.5 deg/s of it "
    "would make up the difference, which is no evidence."
)


def rows() -> Iterator[Row]:
    """Heading and rate with the magnetometer, heading with ultrasound at three rates, and from two units."""
    found = navigation_errors("platform-magnetometer")
    yield band(
        "heading/magnetometer",
        "magnetometer, -166 deg/s, heading error",
        0.5,
        found.heading,
        PLACE,
        low=0.45,
        high=0.70,
        unit="deg",
        note="Nothing fitted: the magnetometer's noise is the printed R1.",
    )
    yield within(
        "rate/magnetometer",
        "the same, rate error",
        3.7,
        found.yaw_rate,
        PLACE,
        tolerance=0.2,
        unit="deg/s",
        must_hold=False,
        note=RATE,
    )
    yield within(
        "heading/consistent",
        "the same with the units of the covariance mended, heading error",
        0.13,
        navigation_errors("platform-magnetometer", (("covariance", "consistent"),)).heading,
        PLACE,
        tolerance=0.03,
        unit="deg",
        basis="reference",
    )
    for rate, (printed, low, high) in CRICKET.items():
        yield band(
            f"heading/cricket{rate}",
            f"ultrasound, {rate} deg/s, heading error",
            printed,
            navigation_errors("platform-cricket", (*LITERAL, ("rate", rate))).heading,
            PLACE,
            low=low,
            high=high,
            unit="deg",
            note="One latency, 87 ms, fitted to the three.",
        )
    yield from _two_unit_rows()


def _two_unit_rows() -> Iterator[Row]:
    raw, helped = two_unit_errors((*LITERAL, ("rate", "-115")))
    yield band(
        "two-units/raw",
        "two units located 100 ms apart, -115 deg/s, heading error",
        25.0,
        raw,
        PLACE,
        low=22.0,
        high=30.0,
        unit="deg",
        basis="text",
        note="Unit B's place is reconstructed: on the arm, 4 in from the axis.",
    )
    yield band(
        "two-units/assisted",
        "the same with inertial assistance",
        10.0,
        helped,
        PLACE,
        low=8.0,
        high=13.0,
        unit="deg",
        basis="text",
        note="What is left is mostly the latency.",
    )
    late, error = network_errors("-115")
    yield band(
        "network/raw",
        "two units of the simulated ultrasonic network, -115 deg/s, heading error",
        25.0,
        error,
        PLACE,
        low=22.0,
        high=30.0,
        unit="deg",
        basis="text",
        note="Ranges, replies and their collisions simulated: no latency is fitted.",
    )
    yield within(
        "network/latency",
        "the network's latency, from ping to last reply",
        87.0,
        1e3 * late,
        PLACE,
        tolerance=20.0,
        unit="ms",
        basis="reference",
        note="Beside the latency fitted to the headings above; that of the positions, 120 ms, is longer than the "
        "protocol explains.",
    )
