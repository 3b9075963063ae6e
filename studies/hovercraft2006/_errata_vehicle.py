"""Errata of the source's chapters 2 and 4: model, laws, actuators.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from studies.erratum import Erratum

MODEL, ACTUATORS = "Model and laws", "Actuators"
VELOCITY, SPIN, HEADING = "laws.velocity", "laws.spin", "laws.heading"

ENTRIES = (
    Erratum(
        MODEL,
        "table 4.1, mass",
        "misprint",
        "1.6 kg",
        "2.6 kg",
        "The text gives 5.7 lb. The reference momenta and the speeds quoted for them give 2.8/1.1 = 2.55 "
        "and 1.98/0.76 = 2.61 kg. θ = 1.44 in table 6.3 is 4J/(d²m) with 2.6 kg, and nothing in "
        "particular with 1.6.",
        ("vehicles.hovercraft",),
    ),
    Erratum(
        MODEL,
        "section 2.2, rest law, proof",
        "correction",
        "V′ = 0 only at rest",
        "V′ = 0 on the line PX = 0, PY = m d Π/J",
        "FY vanishes wherever the rudder pivot does not slip. Stability stands: rest is the largest "
        "invariant set on that line.",
        (VELOCITY,),
    ),
    Erratum(
        MODEL,
        "section 2.2, rest law",
        "remark",
        "–",
        "it never holds a heading",
        "One eigenvalue at rest is zero. The turn dies out like 1/√(2ct), c = m²d²/(k1(J + d²m)), so the "
        "heading drifts without bound, ever more slowly.",
        (VELOCITY,),
    ),
    Erratum(
        MODEL,
        "eq. 2.24, forward law",
        "correction",
        "needs k2 > PXr/d",
        "holds for all k1, k2, PXr > 0",
        "The source's own gains (table 6.2) break its condition: PXr/(k2 d) = 2.19. With the weight of "
        "yaw 1 + PXr/(k2 d) in place of 1 − PXr/(k2 d) the Lyapunov function decreases for every positive"
        " gain.",
        (VELOCITY,),
    ),
    Erratum(
        MODEL,
        "eq. 2.30, reverse law",
        "remark",
        "stable",
        "stable near the equilibrium; globally unproved",
        "Only the linearisation is treated. The equilibrium is unique, and many random starts all "
        "converge: evidence, not proof.",
        (VELOCITY,),
    ),
    Erratum(
        MODEL,
        "eqs. 2.40–2.48, when spinning may begin",
        "gap",
        "lost in print",
        "V < D²Πr²/(8J²(J + D)), D = d²m",
        "Derived again: the energy must keep the spin law's function below its value at the bad limit "
        "point. The source bounds two different roots by one; kept apart they give 1.743 times the "
        "threshold, and that bound is attained.",
        (SPIN,),
    ),
    Erratum(
        MODEL,
        "eqs. 2.62–2.69, smaller reference while spinning",
        "gap",
        "lost in print",
        "|Π*| > (√(2JW) + |Πr|)/(1 + √(1 + D/J))",
        "Derived again; attained at the worst state. Holds for references of the same sign only: with the"
        " sign changed it fails at once, so a change of direction goes through the damping phase.",
        (SPIN, HEADING),
    ),
    Erratum(
        MODEL,
        "section 2.3, proportional heading algorithm, gain",
        "misprint",
        "Πr = −k e",
        "Πr = −J k e",
        "k has the unit 1/s, a rate per angle. Read literally, an error of 5 rad would ask for 52 rad/s.",
        (HEADING,),
    ),
    Erratum(
        MODEL,
        "the same, step 8",
        "correction",
        "the new reference may equal the bound",
        "`literal` does that; `floored`, the default, keeps the reference at 0.8 rad/s or more",
        "The derivation needs strictly more than the bound. Equality, repeated at each step, drives the "
        "state to the bad limit point of a reference that then stands still: the heading keeps an error "
        "and the vehicle slides (fig. 6.12). The source blames the wait in the damping phase; runs do not"
        " end there.",
        (HEADING,),
    ),
    Erratum(
        MODEL,
        "section 2.3.2, Byrnes–Isidori condition",
        "remark",
        "position rates without the rotation B(φ)",
        "with it",
        "At the origin, where the condition is evaluated, it makes no difference.",
        ("design.stabilisability",),
    ),
    Erratum(
        MODEL,
        "fig. 6.11",
        "reconstructed",
        "initial state, gains of the heading runs not given",
        "u 0.4, v 1.2 m/s, r 4.1 rad/s; gains of tables 6.1 and 6.4",
        "Of the gains tried only that pair keeps within the figure's axes. The initial state cannot be "
        "identified: many fit.",
        ("scenarios.hovercraft.heading_bang_bang", "scenarios.hovercraft.heading_proportional"),
    ),
    Erratum(
        MODEL,
        "fig. 6.11, heading error",
        "reconstructed",
        "–",
        "plain difference of a heading in [0, 2π) reproduces it; the shortest way round is the default",
        "The figure turns from 0 to 5 rad the long way. For use, the short way is meant.",
        (HEADING, "sensors.navigation_errors"),
    ),
    Erratum(
        ACTUATORS,
        "fig. 4.2, rudder servo",
        "reconstructed",
        "a plot",
        "35° sin(72° x)/sin(72°), x = (pulse − 1.5 ms)/0.5 ms, at 21 points",
        "The number of points and their spacing are printed, the values are not. Odd and monotone, as a "
        "servo's horn makes it.",
        ("actuators.rudder",),
    ),
    Erratum(
        ACTUATORS,
        "section 4.2, rudder limits",
        "reconstructed",
        "a plot",
        "−35° … 30°",
        "The axis of fig. 4.3 and the ticks of fig. 4.5 allow about 5° either way.",
        ("actuators.rudder", "actuators.lookup"),
    ),
    Erratum(
        ACTUATORS,
        "fig. 4.5, thrust",
        "reconstructed",
        "a plot",
        "c n², c = 1.6/144 N per krpm², less with rudder",
        "Quadratic in speed is printed. The size is weakly known: a greatest thrust of 1.1 to 2.0 N fits "
        "the published runs about equally.",
        ("actuators.thruster",),
    ),
    Erratum(
        ACTUATORS,
        "eq. 4.4, reverse thrust ratio",
        "correction",
        "a cubic in speed",
        "the cubic from 6 krpm on, its value at 6 krpm below",
        "It becomes negative below 4.17 krpm: outside the range in which it was fitted.",
        ("actuators.thruster",),
    ),
    Erratum(
        ACTUATORS,
        "section 6.1, sign and dead zone of the force",
        "reconstructed",
        "not said",
        "sign of FX decides reverse; dead zone ±0.05 N on the magnitude",
        "Dead zones on each component change the runs little.",
        ("actuators.allocation",),
    ),
    Erratum(
        ACTUATORS,
        "table 4.2, moment of inertia",
        "remark",
        "0.0952, 0.0967 kg m²",
        "0.096 kg m², the rounded mean",
        "Both values follow only from FY rounded to two digits; unrounded they are 0.0943 and 0.0979.",
        ("identify.inertia", "vehicles.hovercraft"),
    ),
    Erratum(
        ACTUATORS,
        "section 6.2.2, real vehicle spins slower than simulated",
        "gap",
        "unmodelled friction",
        "optional `Friction`, off",
        "It would explain slow spin, sideways bias and early stop together, but friction of that size "
        "contradicts the way J was measured. Open.",
        ("vehicles.hovercraft",),
    ),
)
