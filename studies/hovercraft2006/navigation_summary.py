"""Summary of the navigation's accuracy on the rotating platform, table 6.7.

The same flights as in the groups of the two filters; how much of each figure was fitted stands there.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.
"""

from collections.abc import Iterator

from studies.hovercraft2006._rig import LITERAL, navigation_errors
from studies.hovercraft2006.heading_filter import RATE
from trimtab.study import Row, band

SECTION = "6.2.1.2"
PLACE = "[1] table 6.7"
BANDS = {
    "magnetometer and encoder, -166 deg/s": {
        "rate": (3.7, 3.5, 3.9, "deg/s"),
        "heading": (0.5, 0.45, 0.70, "deg"),
        "velocity": (7.5, 6.5, 8.3, "cm/s"),
        "position": (3.4, 3.0, 3.9, "cm"),
    },
    "ultrasound, -115 deg/s": {
        "rate": (4.1, 3.7, 4.5, "deg/s"),
        "heading": (9.8, 9.0, 11.0, "deg"),
        "velocity": (16.8, 12.0, 21.0, "cm/s"),
        "position": (8.1, 6.0, 10.5, "cm"),
    },
}
"""Experiment -> error -> printed, accepted band, unit."""


def rows() -> Iterator[Row]:
    """Eight errors, two experiments."""
    flights = navigation_errors("platform-encoder"), navigation_errors("platform-cricket", (*LITERAL, ("rate", "-115")))
    for (name, printed), found in zip(BANDS.items(), flights, strict=True):
        computed = found._asdict() | {"rate": found.yaw_rate}
        for what, (value, low, high, unit) in printed.items():
            note = RATE if what == "rate" else ""
            key = f"table-6.7/{name.split()[0]}/{what}"
            words = f"{name}, {what} error"
            about = {"unit": unit, "must_hold": what != "rate", "note": note}
            yield band(key, words, value, computed[what], PLACE, low=low, high=high, **about)
