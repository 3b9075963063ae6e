"""Errata of the source's filter of the bending modes.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 9 and below.
"""

from studies.erratum import Erratum

SECTION = "Filter of the modes"
FILTER, MODEL = "estimators.flexible.discrete", "estimators.flexible.model"
CONTINUOUS = "estimators.flexible.continuous"

ENTRIES = (
    Erratum(
        SECTION,
        "eq. 9",
        "correction",
        "contains the noises themselves, and none of the forces and moments; B_η = dG_η/dη",
        "no noise; the known forcing b(χ, u); the input enters by G_η",
        "An observer cannot know the noise. G_η does not depend on η, so the printed B_η is zero.",
        (MODEL, FILTER),
    ),
    Erratum(
        SECTION,
        "eq. 9, innovation",
        "correction",
        "η_y - C η̂",
        "η_y - C η̂ - d(χ, u)",
        "At the trim η_y is 0 and C η is -0.212 rad/s². Without d the rates are off by -0.174 and -0.491, R = 1e-4.",
        (MODEL, FILTER),
    ),
    Erratum(
        SECTION,
        "gain and Riccati equation",
        "misprint",
        "L = P C R⁻¹; one R⁻¹ too many; algebraic",
        "L = P C' R⁻¹; P' = A P + P A' + Q - P C' R⁻¹ C P",
        "Shapes; and P(0) is given a meaning only by the differential equation.",
        (CONTINUOUS,),
    ),
    Erratum(
        SECTION,
        "R_η(0) = diag(10, 10)",
        "misprint",
        "two by two, without unit or sampling",
        "the scalar 10, as a density in the continuous filter, of a sample in the discrete one",
        "There is one measurement. Its signal is about 0.3 rad/s², so either reading is far above it.",
        (CONTINUOUS, FILTER),
    ),
    Erratum(
        SECTION,
        "errors of the estimate, converged in about 10 s",
        "remark",
        "shown for the filter",
        "shown beside an observer without any measurement, which converges as fast",
        "With the printed Q and R the slowest time constant is that of the modes' own damping, 3.27 s, to 0.1 %. The "
        "shipped setting uses its measurement.",
        (FILTER, "studies.hypersonic2022.filter"),
    ),
    Erratum(
        SECTION,
        "extended Kalman filter",
        "remark",
        "Jacobians at the estimate",
        "constant A_η and C, a linear filter with known forcing",
        "The modes enter pitch and their own equations linearly.",
        (MODEL,),
    ),
    Erratum(
        SECTION,
        "Q_η = 1e-5 I",
        "remark",
        "noise on displacements and rates alike",
        "kept for comparison; the shipped one has its noise on the accelerations",
        "A displacement is the integral of its rate: no noise acts there. With the printed Q and R modes 2 % off drive "
        "the loop into its limits, 10 % off lose the vehicle.",
        (FILTER, "studies.hypersonic2022.closed_loop_noise"),
    ),
    Erratum(
        SECTION,
        "P(0)",
        "gap",
        "not printed",
        "I for the printed Q and R, diag(1, 100, 1, 100) for the shipped ones",
        "Of the size of the first errors: 0.6 in displacement, which swings to 10 in rate.",
        (FILTER,),
    ),
    Erratum(
        SECTION,
        "η̂(0) = (1.5122, 0, 1.122, 0)",
        "remark",
        "first estimate",
        "kept: a first error of 0.608 and 0.367",
        "1.122 may be a misprint of 1.2114; nothing depends on it.",
        (FILTER,),
    ),
)
