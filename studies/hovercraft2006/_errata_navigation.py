"""Errata of the source's chapters 3, 5 and 6: radio links, navigation and its experiments.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from studies.erratum import Erratum

LINKS, SIMULATION = "Links", "Simulated navigation"
INERTIAL, POSITIONING = "Inertial navigation", "Ultrasonic positioning"

ENTRIES = (
    Erratum(
        LINKS,
        "table 5.1, round trip",
        "remark",
        "a measurement of its own",
        "not the sum of up and down",
        "The differences are +5.4, −1.2, +2.4, +0.2 and +4.2 ms: no test asks for equality.",
        ("links.bluetooth",),
    ),
    Erratum(
        LINKS,
        "section 5.3, latencies",
        "reconstructed",
        "mean, deviation, extremes",
        "a shifted gamma distribution with those moments, beginning 2 ms below the least value",
        "The distribution itself is not printed. Beyond the printed greatest value it leaves 0.0003 to "
        "0.005, as a few hundred samples would.",
        ("links.bluetooth", "links.latency"),
    ),
    Erratum(
        LINKS,
        "section 6.1, delays of the simulation",
        "remark",
        '"nearly 80 ms"',
        "6 × 6 ms down and 2 × 20 ms up: 76 ms, and the wait for the next sample",
        "The two chains are printed; the sum is their total with half a period each.",
        ("links.delay_chain",),
    ),
    Erratum(
        LINKS,
        "section 6.1, sampling",
        "remark",
        "6 ms",
        "6 ms by default, 6.5536 ms is a parameter",
        "The inertial unit's own tick, printed in chapter 5, is 6.5536 ms; chapter 6 rounds it.",
        ("sensors.navigation_errors",),
    ),
    Erratum(
        SIMULATION,
        "section 6.1, errors of the navigation block",
        "reconstructed",
        '"variances" of 2.5 cm/s², 1 deg/s and 0.5 deg/s',
        "variances 0.025 (m/s²)², 0.01745 and 0.00873 (rad/s)² (reading C)",
        "A variance has squared units. Taken as standard deviations (A), or as variances in cm and "
        "degrees (B), the runs meet a third of the axis ends of figs. 6.7–6.10; taken as SI numbers "
        "entered as variances, nearly all. The scale is sharp to about a quarter.",
        ("sensors.navigation_errors",),
    ),
    Erratum(
        SIMULATION,
        "the same, renewal",
        "reconstructed",
        "a pulse each second",
        "biases drawn anew and integrals reset each second; velocity errors added in body axes",
        "What the figure's labels show.",
        ("sensors.navigation_errors",),
    ),
    Erratum(
        INERTIAL,
        "section 3.1, frames",
        "correction",
        "the Earth-centred, Earth-fixed frame is called inertial",
        "the local tangent plane is taken as inertial; the inertial one is Earth-centred and does not "
        "turn with the Earth",
        "The error is the Coriolis term, which the planar navigation neglects in either case.",
        (
            "environment.geodetic",
            "estimators.inertial.mechanisation",
        ),
    ),
    Erratum(
        INERTIAL,
        "eq. 3.4, update of the rotation matrix, first term",
        "misprint",
        "sin(|v|) U / |v|²",
        "sin(|v|) U / |v|",
        "Only that makes the series of the matrix exponential; the second term does have |v|².",
        ("core.rotation",),
    ),
    Erratum(
        INERTIAL,
        "eq. 3.4, order of the update",
        "correction",
        "the update multiplies the rotation",
        "with v = −∫ω dt the factor E propagates the transpose: B(k) = B(k−1) Eᵀ",
        "Multiplied on the other side it is off by 0.15 in a test, on this side by rounding.",
        ("core.rotation",),
    ),
    Erratum(
        INERTIAL,
        "eq. 3.8",
        "correction",
        "d/k is called a bandwidth",
        "it is a time constant",
        "Its unit is the second.",
        (),
    ),
    Erratum(
        INERTIAL,
        "chapters 3 and 5, signs",
        "remark",
        "–",
        "an error is estimate − truth, and the filters are given navigation − measurement",
        "One convention throughout, with which the printed matrices hold as they stand.",
        ("estimators.inertial.dual_filter",),
    ),
    Erratum(
        INERTIAL,
        "section 5.4, process noise Q, Q2",
        "correction",
        "variances of resting sensors, added to heading and velocity at each step",
        "`literal` does that and gives the source's rms numbers; `consistent`, the default, multiplies by"
        " the step squared (biases: by the step)",
        "The printed numbers are in (rad/s)² and (m/s²)². As printed, the heading filter's gain is 0.8 "
        "and it follows the magnetometer: 0.58° instead of 0.13°, and a normalised innovation squared of "
        "0.34 where 1 is expected.",
        ("estimators.inertial.dual_filter",),
    ),
    Erratum(
        INERTIAL,
        "eqs. 3.43, 3.44, magnetometer heading",
        "correction",
        "arc cosine of the product of two directions, sign from their cross product",
        "atan2(cross, product)",
        "The arc cosine loses half the digits next to 0 and π.",
        (
            "environment.magnetic",
            "sensors.heading",
        ),
    ),
    Erratum(
        INERTIAL,
        "section 5.1, gyros",
        "remark",
        "ADXRS150, ±300 deg/s",
        "limit ±300 deg/s",
        "The bare part measures to 150 deg/s; the module around it extends the range.",
        (
            "sensors.imu",
            "estimators.inertial.aided",
        ),
    ),
    Erratum(
        INERTIAL,
        "eq. 6.2, gyro model",
        "remark",
        "constant gain 1.046",
        "divided by it where a gain of 1 is meant",
        "The coefficients come from a fit; the calibration of the sensor has a gain of 1.",
        (
            "sensors.gyro_dynamics",
            "estimators.inertial.gyro_compensated",
        ),
    ),
    Erratum(
        INERTIAL,
        "table 6.5, phase at 10 Hz",
        "remark",
        "−1.05 rad without compensation",
        "about −1.30 rad expected",
        "The other six frequencies lie on one curve, this one does not. With compensation divided by "
        "without it agrees with eq. 6.2 at all seven, so that both phases are off alike.",
        ("studies.hovercraft2006.gyro_compensation",),
    ),
    Erratum(
        INERTIAL,
        "section 6.2.1, phase at 20 Hz",
        "remark",
        "−45 deg in the text",
        "−2.39 rad = −137 deg in table 6.5",
        "The difference is two samples of delay, 94 deg at that frequency, which the text has removed.",
        ("studies.hovercraft2006.gyro_compensation",),
    ),
    Erratum(
        POSITIONING,
        "section 5.5, speed of sound",
        "remark",
        "340.29 m/s",
        "from temperature, humidity and pressure (Cramer 1993)",
        "The printed number belongs to the standard atmosphere at 15 °C; indoors it is 344, and 0.6 m/s "
        "more per degree.",
        ("environment.acoustics",),
    ),
    Erratum(
        POSITIONING,
        "section 5.5.4, cone error",
        "remark",
        "e = 1 + 0.0032 β − 0.038 β² up to 45°",
        "the same, with guards",
        "At 0.003 rad the derivative of the equation that is solved vanishes, and a range shorter than "
        "the height (noise) has no root: the range itself is taken then.",
        (
            "environment.acoustics",
            "estimators.ranging.range_model",
        ),
    ),
    Erratum(
        POSITIONING,
        "fig. 5.8, 0.52 cm",
        "misprint",
        "half of the ranges lie within",
        "half of the positions lie within",
        "It is a circular error of positions; with four beacons it needs ranges good to 0.4 cm.",
        (
            "sensors.time_of_flight",
            "estimators.ranging.position",
        ),
    ),
)
