"""The source's navigation filters with the units of their covariances mended, on the rotating platform.

Not the source's filters: what they would have given, beside its numbers. Medians over 20 seeds.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.
"""

from collections.abc import Iterator

from studies.hovercraft2006._rig import LITERAL, navigation_errors
from trimtab.study import Row, band, direction

SECTION = "6.2.1"
PLACE = "[1] section 6.2.1"
MENDED = (("covariance", "consistent"),)
ARM = (("rate", "-115"),)
STAMPED = (*ARM, ("stamped", "measurement"))
UNITS = {"heading": "deg", "position": "cm", "velocity": "cm/s"}
ENCODER = {"position": (3.4, 3.0, 3.9), "velocity": (7.5, 6.5, 8.3)}
CRICKET = {"heading": (9.8, 9.0, 11.0), "position": (8.1, 6.0, 10.5), "velocity": (16.8, 12.0, 21.0)}
"""Error -> printed, and the band that the printed covariances are held to."""
LEAN = "The source flew the covariances as printed. Mended, the filter trusts itself more, and nothing models the lean."
LATE = "Late fixes are what these errors are made of, whatever the covariances."


def rows() -> Iterator[Row]:
    """Encoder and ultrasound, and ultrasound with each fix used at its own time."""
    late = {"literal": navigation_errors("platform-cricket", (*LITERAL, *ARM))}
    late["consistent"] = navigation_errors("platform-cricket", (*MENDED, *ARM))
    for name, key, printed, found, note in (
        ("encoder, -166 deg/s", "encoder", ENCODER, navigation_errors("platform-encoder", MENDED), LEAN),
        ("ultrasound, -115 deg/s", "cricket", CRICKET, late["consistent"], LATE),
    ):
        for what, (value, low, high) in printed.items():
            words, unit = f"{name}, covariances mended, {what} error", UNITS[what]
            about = {"low": low, "high": high, "unit": unit, "must_hold": key == "cricket", "note": note}
            yield band(f"{key}/{what}-consistent", words, value, getattr(found, what), PLACE, **about)
    for covariance, settings in (("literal", LITERAL), ("consistent", MENDED)):
        found = navigation_errors("platform-cricket", (*settings, *STAMPED))
        for what, unit in UNITS.items():
            yield direction(
                f"cricket-stamped/{what}-{covariance}",
                f"ultrasound, each fix at its own time, covariances {covariance}, {what} error",
                "less than late",
                getattr(found, what),
                PLACE,
                below=getattr(late[covariance], what),
                unit=unit,
                note="Not in the source: what its time stamps would have bought.",
            )
