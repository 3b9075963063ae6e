"""Errata of the source's printed numbers, settings that it does not print, and figures that were read wrongly since.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, numbers of its simulation.
"""

from studies.erratum import Erratum

PRINTED, MISSING, REFERENCE = "Printed matrices and gain", "Settings that are not printed", "Figures held against"
MATRICES, STUDY = "vehicles.hypersonic_printed", "studies.hypersonic2022"
FLIGHT = "scenarios.hypersonic._flight"

ENTRIES = (
    Erratum(
        PRINTED,
        "A and B, row of α",
        "misprint",
        "numbers that follow with b31 in the place of b32",
        "e_Q and (-1/V, 0)",
        "α' is Q less the turn of the path, which v fixes: true of any linearisation at level flight.",
        (MATRICES, f"{STUDY}.exact_linearisation"),
    ),
    Erratum(
        PRINTED,
        "A and B, rows of the modes",
        "misprint",
        "ψi/Iyy where eq. 1 has ψi; B's row of η1'' not multiplied by G⁻¹",
        "ψi; G⁻¹ in every row",
        "With both repeated, 32 of 34 numbers come out in magnitude. The coupling of the modes is 0.09, not 1.8e-7.",
        (MATRICES, f"{STUDY}.printed_matrices"),
    ),
    Erratum(
        PRINTED,
        "A, damping of both modes, and eight more signs",
        "misprint",
        "+0.66, +0.8: modes that grow",
        "-0.66, -0.8, as eq. 1 has it",
        "Growing modes contradict observer errors that converge; no choice of signs of ψ gives all that is printed.",
        (MATRICES,),
    ),
    Erratum(
        PRINTED,
        "B, row of η2''",
        "gap",
        "18.0596, -1.24",
        "nothing gives them; the emulation has 14.35, -0.38, the exact model 15.65, -1.75",
        "Raw and transposed G, a factor of 2 and ψ in place of ψ/Iyy were tried.",
        (MATRICES,),
    ),
    Erratum(
        PRINTED,
        "K",
        "correction",
        "stabilises the errors",
        "a regulator for the exact matrices",
        "Neither A + B K nor A - B K is Hurwitz, with the printed matrices or the exact ones; either sign loses the "
        "vehicle within 8 s. A - B K decays once damping has its sign and the modes are taken out of Q'.",
        (MATRICES, "scenarios.hypersonic.printed_gains", f"{STUDY}.printed_gain"),
    ),
    Erratum(
        MISSING,
        "R_e, Q_e",
        "gap",
        "not printed",
        "diag(1/10², 1/5²); diag of 1/(100, 20, 10, 0.05, 0.1, 1e3, 1e3, 1e3, 1e3)²",
        "Chosen: errors and accelerations that count as much.",
        ("scenarios.hypersonic._design",),
    ),
    Erratum(
        MISSING,
        "q0, q1, κ_G",
        "gap",
        "not printed",
        "10, 0.01, 0",
        "Chosen. κ_G is 0 with exact parameters, for F and G do not depend on the modes; of a declared plant it is "
        "computed over the envelope.",
        ("laws.adaptive_robust", "scenarios.hypersonic._envelope"),
    ),
    Erratum(
        MISSING,
        "noise, control period",
        "gap",
        "not printed",
        "0.01 rad/s² a sample, 5 ms",
        "Chosen: some percent of the signal; 60 periods in an oscillation of the modes.",
        (FLIGHT, "sensors.angular_accelerometer"),
    ),
    Erratum(
        MISSING,
        "commands and their filters",
        "gap",
        "in [17], which is not to be had",
        "four equal lags for altitude, three for speed, 0.06 rad/s; climbs of 1000 to 10 000 ft",
        "Chosen so that the wanted accelerations do not jump and no limit holds the input.",
        ("laws.path_command",),
    ),
    Erratum(
        MISSING,
        "limits of the inputs",
        "gap",
        "not printed",
        "fuel ratio 0.02 to 1.5, elevator -20 to 25.8 deg",
        "Chosen.",
        ("laws.path_inversion",),
    ),
    Erratum(
        REFERENCE,
        "eq. 15 as printed, largest eigenvalue",
        "remark",
        "-1.4e-3, with no filter to it",
        "-1.168e-3 for R = 10 and -1.747e-3 for 5e-7",
        "It would need R of about 1.3e-6, which nothing here has.",
        (f"{STUDY}.gains",),
    ),
    Erratum(
        REFERENCE,
        "elevator under noise, 0.42 and 0.36 deg",
        "remark",
        "as though of the noise",
        "0.40 and 0.34 deg over 20-60 s, of which the manoeuvre is 0.34; the noise alone 0.21 and 0.04 deg",
        "The difference of two flights of one seed, with noise and without; a covariance analysis agrees.",
        (f"{STUDY}.closed_loop_noise",),
    ),
    Erratum(
        REFERENCE,
        "errors of the estimate at 9-10 s without measurement",
        "remark",
        "3 to 5 % above those of the modes alone",
        "the same, in the closed loop at a cruise",
        "The feedback moves the vehicle while the observer holds what it knew of it for 5 ms; with the input held the "
        "errors are exp(A t) times the first one.",
        (f"{STUDY}.filter",),
    ),
    Erratum(
        REFERENCE,
        "condition 666 of the Gramian",
        "remark",
        "as though a measure of observability",
        "below 2 with each state in its own size",
        "It is the ratio of the units of displacement and rate.",
        (f"{STUDY}.filter", "design.observability"),
    ),
    Erratum(
        REFERENCE,
        "modes 10 % slow, Qacc = 1: marginal",
        "remark",
        "error of altitude 0.05 to 0.31 ft",
        "unstable: so after 60 s, but growing by 0.075 each second until a limit holds the input at 80 s",
        "The flights had ended. The shipped setting holds for either sign of the error.",
        (f"{STUDY}.closed_loop_noise",),
    ),
    Erratum(
        REFERENCE,
        "smoothed u_s with a leak of 0.02: 7.2 ft",
        "remark",
        "as though with eps = 0.01",
        "that is with eps = 1; with 0.01 it is 4.8 ft",
        "Without the leak 2.7 ft, without u_s 7.4 ft.",
        (f"{STUDY}.closed_loop_mismatch", "laws.adaptive_robust"),
    ),
    Erratum(
        REFERENCE,
        "sgn with q0 = 100: 1e3 ft",
        "remark",
        "diverges",
        "diverges, to 66 ft after 200 s",
        "The bounds stand still here while a limit holds the input.",
        (f"{STUDY}.closed_loop_mismatch",),
    ),
)
