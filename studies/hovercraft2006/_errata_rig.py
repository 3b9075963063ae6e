"""Errata of the source's section 6.2.1: its experiments on a rotating platform.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from studies.erratum import Erratum

INERTIAL = "Inertial navigation"

ENTRIES = (
    Erratum(
        INERTIAL,
        "section 6.2.1, rate error 3.7 deg/s",
        "remark",
        "error of the navigation",
        "mostly noise of the tachometer that it is compared with",
        "The text says itself that the navigation is the less noisy; the filter's own error is about 0.9 deg/s.",
        (
            "sensors.tachometer",
            "studies.hovercraft2006.heading_filter",
        ),
    ),
    Erratum(
        INERTIAL,
        "table 6.6, heading with and without compensation",
        "correction",
        "1.1 and 2.5 deg",
        "0.6 and 0.6 deg: only the direction is tested",
        "With the printed covariances the heading sits on the magnetometer, whatever the gyro does; the "
        "measurement variance would have to be 16 times larger.",
        (
            "estimators.inertial.gyro_compensated",
            "studies.hovercraft2006.gyro_square_wave",
        ),
    ),
    Erratum(
        INERTIAL,
        "section 6.2.1, heading and position from ultrasound",
        "reconstructed",
        "latency not given",
        "87 ms for heading, 120 ms for position",
        "One number fitted to three rms headings (57, 115 and 230 deg/s), one to two figures of position and velocity.",
        (
            "sensors.late_fix",
            "scenarios.navigation.platform_cricket",
        ),
    ),
    Erratum(
        INERTIAL,
        "section 6.2.1, position and velocity on the arm",
        "reconstructed",
        "alignment of the spin axis not given",
        "tilted by 0.49 deg",
        "Without the leak of gravity position and velocity would be four times better than printed; one "
        "number for two figures.",
        ("vehicles.rotating_platform",),
    ),
    Erratum(
        INERTIAL,
        "section 6.2.1, how often positions come",
        "reconstructed",
        "not given for the rig",
        "once a second; headings from ultrasound each 100 ms, from the magnetometer with each inertial sample",
        "The source's simulation renews its navigation errors once a second. With that and the fitted tilt and latency "
        "all four figures of position and velocity are met within 5 %. Between two fixes the lean of the axis goes "
        "unseen, so its effect grows with the square of that time.",
        ("scenarios.navigation.platform_encoder", "scenarios.navigation.platform_cricket"),
    ),
    Erratum(
        INERTIAL,
        "section 6.2.1, place of the second ultrasonic unit",
        "reconstructed",
        "not given",
        "on the arm, 4 in from the axis, 8 in from the first",
        "It gives 27° without and 12° with inertial assistance where about 25° and 10° are printed. With 4 in "
        "between the units it would be 43° and 17°; 8 in further out than the first, the plain heading would be the "
        "better one.",
        ("scenarios.navigation.platform_cricket",),
    ),
    Erratum(
        INERTIAL,
        "table 6.6, square wave",
        "reconstructed",
        "height and cycle not given",
        "±166 deg/s, 2 s, behind a motor's lag of 0.07 s",
        "With 166 deg/s, the rate of the other experiments, both rate errors are met, and their ratio, 0.65, "
        "does not depend on these choices.",
        ("laws.turntable", "scenarios.navigation.platform_square_wave"),
    ),
)
