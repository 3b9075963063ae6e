"""Errata of the source's error model, law, robust terms and certificates.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from studies.erratum import Erratum

LAW, ROBUST, PROOF = "Law and internal dynamics", "Robust terms", "Certificates"
INVERSION, ADAPTIVE, COMPOSITE = "laws.stable_inversion", "laws.adaptive_robust", "design.composite"
STUDY = "studies.hypersonic2022"

ENTRIES = (
    Erratum(
        LAW,
        "ideal internal dynamics, method",
        "misprint",
        "attributed to [12]",
        "it is in [17]; here that of Devasia, Chen and Paden",
        "[12] is about sliding-mode observers, and [17] is not to be had.",
        ("design.stable_inversion", "scenarios.hypersonic._internal"),
    ),
    Erratum(
        LAW,
        "ideal internal dynamics, linear",
        "correction",
        "linearised at the trim",
        "the bounded solution of the exact equations",
        "On the climb by 5000 ft the linear form leaves 11 ft at the end, the exact one less than 0.001 ft: the "
        "vanishing errors of the text need the exact one.",
        ("scenarios.hypersonic._internal", f"{STUDY}.internal_dynamics"),
    ),
    Erratum(
        LAW,
        "after eq. 13, M_F",
        "correction",
        "without -K e''; ΔF behind the robust terms",
        "M_F = ΔF + ΔG G⁻¹ (-F + K e' + yd^(r)) - K e''; the robust terms enter times (I + ΔG G⁻¹)",
        "The error of the estimate reaches the loop by the gain, with exact parameters by nothing else.",
        (COMPOSITE,),
    ),
    Erratum(
        LAW,
        "eq. 13, v = +K e",
        "misprint",
        "printed K with the other sign",
        "v = +K e with a gain of that sign",
        "The rigid part of the printed K is stabilising as v = -K e only.",
        (INVERSION, "vehicles.hypersonic_printed"),
    ),
    Erratum(
        ROBUST,
        "eq. 16, u_h",
        "correction",
        "+R⁻¹ B'P e'/2",
        "off by default; minus at choice",
        "R⁻¹ B'P e' is -K e' for a regulator's gain: the printed sign makes K/2 of K (rightmost pole -0.125 1/s), "
        "minus 1.5 K (-0.236). On a plant that is not the model the error grows from 7.4 to 12.6 ft or falls to 5.7.",
        (ADAPTIVE, f"{STUDY}.gains", f"{STUDY}.closed_loop_mismatch"),
    ),
    Erratum(
        ROBUST,
        "assumption 2",
        "correction",
        "a bound times |B'P e'|",
        "|M_F| ≤ ρ0 + ρ1 |e'|",
        "The proof uses it without that factor; with it nothing that is there at e' = 0 would be bounded.",
        (ADAPTIVE,),
    ),
    Erratum(
        ROBUST,
        "eq. 18",
        "correction",
        "|e|; bounds that only grow; sgn of B'P e' in the law, of B'P e in the proof",
        "|e'|, sized; a cap, a leak at choice, standing still while a limit holds the input; smoothed sgn",
        "e contains modes that nothing measures. Its plain length is the altitude's alone. With sgn and a large q0 "
        "and no cap the loop diverges.",
        (ADAPTIVE, f"{STUDY}.closed_loop_mismatch"),
    ),
    Erratum(
        PROOF,
        "eq. 15",
        "correction",
        "-R_e⁻¹; sqrt(Q_e Π) of 9 x 9 times 4 x 4",
        "z(λ) = [Q_e, W E/2; E'W/2, λ Π] > 0",
        "By Schur's complement the block is -R_e. The product does not exist, and would not be symmetric.",
        (COMPOSITE,),
    ),
    Erratum(
        PROOF,
        "Lyapunov function, weight of the estimate's part",
        "correction",
        "1",
        "λ above λ*, the largest eigenvalue of E'W Q_e⁻¹ W E/4 against Π",
        "With weight 1 the mended (15) fails: λ* is 2.8 to 4.3 for the gains and filters here. A finite one always "
        "exists. The printed form is satisfied all the same, so it proves nothing.",
        (COMPOSITE, "design.certificate", f"{STUDY}.gains"),
    ),
    Erratum(
        PROOF,
        "derivative of e_η' P_η⁻¹ e_η",
        "correction",
        "without the derivative of P_η⁻¹",
        "-e_η' Π e_η, exactly, with the Riccati equation",
        "P_η moves; what is left out takes the terms with A_η away.",
        (COMPOSITE,),
    ),
    Erratum(
        PROOF,
        "what is proved",
        "remark",
        "stability of the linear error model",
        "the same, said to be local, for continuous time and for inputs inside their limits",
        "The internal dynamics are linearised; from 1000 ft below its path the vehicle is lost in its limits.",
        ("design.certificate_check", f"{STUDY}.closed_loop"),
    ),
)
