"""Errata of the source's model and of its input/output linearisation.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from studies.erratum import Erratum

MODEL, LINEARISATION = "Model", "Input/output linearisation"
CRAFT, MODES, FORCES = "vehicles.hypersonic", "vehicles.hypersonic_modes", "vehicles.hypersonic_aerodynamics"

ENTRIES = (
    Erratum(
        MODEL,
        "list of coefficients; M of the observer",
        "misprint",
        "CM_α among the drag coefficients; a moment without the chord",
        "CM_α in the moment, which is q̄ S c times its coefficient",
        "Units, and the model of Parker et al. from which the curves come.",
        (FORCES,),
    ),
    Erratum(
        MODEL,
        "V' in affine form, coefficient of Φ",
        "misprint",
        "β2 α² in it",
        "β3 α²",
        "β2 multiplies α³ of the thrust without fuel; b21 has β3.",
        (FORCES,),
    ),
    Erratum(
        MODEL,
        "eq. 4, x' = f + g u",
        "correction",
        "affine in both inputs",
        "affine in the fuel ratio only; the elevator is solved for exactly",
        "Drag is quadratic in the elevator, and g(x) hides one elevator in its own coefficient. Frozen there, the "
        "slope is half of what it is: 20.2 instead of 40.3 ft/s² per rad at the trim.",
        ("laws.path_inversion", "design.lie"),
    ),
    Erratum(
        MODEL,
        "b51, b52",
        "misprint",
        "without what the modes' forcing does to pitch",
        "(ψ1 b7x + ψ2 b9x)/Iyy belongs in them, as f5 has (ψ1 f7 + ψ2 f9)/Iyy",
        "As printed the elevator's force on mode 2 never reaches the pitch acceleration.",
        (MODES,),
    ),
    Erratum(
        MODEL,
        "eqs. 1-3, k1 and k2; f7, f9",
        "gap",
        "not defined, absent from eq. 1; the loop of three equations substituted once",
        "k_i = 1 + ψi²/Iyy by default, two other readings at choice; the 3 x 3 system is solved",
        "Substituting once drops (ψ1 ψ2/Iyy)² and each mode's own 1/k_i. Trims do not depend on the reading, and the "
        "loop behaves alike in all three.",
        (MODES,),
    ),
    Erratum(
        MODEL,
        "f9, constant term",
        "misprint",
        "-ψ1 ψ2/(Iyy k1) N2_0",
        "N1_0 in it",
        "It is mode 1 that acts on mode 2 there.",
        (MODES,),
    ),
    Erratum(
        MODEL,
        "modes: frequencies, damping, coupling, forcing",
        "reconstructed",
        "not printed",
        "w = 16.5, 20 rad/s, ζ = 0.02, ψ = 136.82, 329.22, N2_δ = 1246.5, from eight entries of the printed A",
        "With these eight and nothing left to tune 23 other entries come out right in magnitude. The constants of N1 "
        "and N2 stand in none of them: they are from the literature and set the level of the displacements only.",
        (MODES, "vehicles.hypersonic_printed"),
    ),
    Erratum(
        MODEL,
        "gravity",
        "reconstructed",
        "not printed",
        "31.5538 ft/s², the attraction at 85 000 ft",
        "32.174 would leave five entries of the printed A 1.4 to 2.2 % off.",
        (CRAFT,),
    ),
    Erratum(
        MODEL,
        "trim at 85 000 ft, 7702.08 ft/s",
        "correction",
        "as usually quoted: 1.5153 deg, Φ = 0.2514, elevator 11.4635 deg",
        "1.5968 deg, 0.26445, 12.4271 deg",
        "The quoted point balances the vehicle to which the curves were fitted; these curves leave 0.35 ft/s² along, "
        "-2.2 ft/s² across the path and 0.019 rad/s² there.",
        (CRAFT, "design.trim"),
    ),
    Erratum(
        LINEARISATION,
        "Lf² h",
        "misprint",
        "+L0/(m V) in the braces behind -V cos γ",
        "-L0/(m V)",
        "Lift turns the path up; f3 has the right sign.",
        ("design.lie", "laws.path_inversion"),
    ),
    Erratum(
        LINEARISATION,
        "G_ξ; g(x); eq. 4",
        "misprint",
        "g21, g22; g(x) transposed with 8 or 9 columns; θ a state, in ξ it is h'",
        "b21, b22; g is 9 x 2; the change of coordinates is written out",
        "Names that are defined nowhere else; shapes; the coordinates need h' = V sin γ.",
        ("design.normal_form",),
    ),
    Erratum(
        LINEARISATION,
        "equation that is linearised; B_ζ; eq. 10; theorem 1",
        "misprint",
        "(8); dG/dv; e without its subscript; (9) for the tracking system",
        "(7); G_ζ at the trim; e with its subscript; (10)",
        "(7) has the internal dynamics; G does not depend on v; (9) is the observer.",
        ("design.normal_form",),
    ),
    Erratum(
        LINEARISATION,
        "internal dynamics, linear",
        "correction",
        "in the states themselves",
        "in deviations: ζ' = A1 (ξ - ξ0) + A2 (ζ - ζ0) + B v about a true trim",
        "A constant is left otherwise, for no trim is at zero.",
        ("scenarios.hypersonic._level",),
    ),
)
