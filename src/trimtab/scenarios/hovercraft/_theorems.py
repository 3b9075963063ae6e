"""Theorems about the hovercraft's control laws, proved for the same code of vehicle and laws that flies.

Each public function returns one theorem. The arguments of a function are the numbers for which the theorem holds. A
theorem without arguments holds for all positive gains, masses and references, which are symbols in it.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections
2.2 and 2.3. The docs page Errata lists corrections to [1].
"""

import math
from fractions import Fraction
from typing import Any

from trimtab.core.errors import InputError
from trimtab.design.gram_search import GramSearch
from trimtab.design.polynomial import Polynomial, as_polynomial, constant, lie_derivative_of, symbol
from trimtab.design.proof import Line, ProofCondition
from trimtab.design.squares import NONNEGATIVE, POSITIVE, Claim, Region, SquaresProof, WeightedSquares
from trimtab.design.theorem import Counterexample, LawTheorem, closed_loop, hurwitz_minors
from trimtab.laws.spin import (
    ConstantSpin,
    limit_point_value,
    lyapunov,
    safe_reference_bound,
    switching_energy,
    switching_energy_sharp,
)
from trimtab.laws.velocity import ForwardMomentum, ForwardMomentumMatched, ReverseMomentum, ZeroVelocity
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

STATES = {"surge_velocity": "u", "sway_velocity": "v", "yaw_rate": "r"}
CRAFT = ("m", "J", "d")
NEARLY = 0.15
"""Largest deviation of the function W from V in `zero_velocity_time`, as a fraction of V."""
NEAR = 1e-9
"""Relative margin for rounding errors at the sharp threshold of the switching energy.

The proof uses a threshold that is lower by this margin. The counterexample uses a threshold that is higher by this
margin.
"""


def zero_velocity() -> LawTheorem:
    """Return the theorem that the craft comes to rest from every initial state with the law ZeroVelocity."""
    law = ZeroVelocity(k1=symbol("k1"), k2=symbol("k2"), model=_symbolic_craft())
    return _global_theorem("zero-velocity", law, ("k1", "k2"))


def zero_velocity_time(
    *,
    level: float = 1.0,
    rate: float = 0.32,
    slip_cross: float = 0.076,
    turn_cross: float = 0.04,
    k1: float = 1.0,
    k2: float = 2.5,
    mass: float = 2.6,
    inertia: float = 0.096,
    arm: float = 0.32,
) -> LawTheorem:
    """Return the theorem that bounds the time in which the law ZeroVelocity brakes the craft.

    A heading law waits for this time in its mode "damp" before a turn.

    The Lyapunov function V does not decrease everywhere, but W = V - slip_cross u (v - d r) r - turn_cross u r^2 does,
    with W' <= -rate V^2. Therefore 1/W grows by at least rate/(1 + NEARLY)^2 per second. `settling_bound` follows from
    this. u, v, r: surge velocity, sway velocity and yaw rate.  d: distance of the rudder pivot from the centre of mass.
    """
    model, craft = _numeric_craft(mass, inertia, arm)
    law = ZeroVelocity(k1=constant(k1), k2=constant(k2), model=model)
    field, V = closed_loop(model, law, HovercraftState(), STATES)
    assert V is not None
    u, v, r, zeros = symbol("u"), symbol("v"), symbol("r"), dict.fromkeys(STATES.values(), constant(0))
    W = V - constant(slip_cross) * u * (v - model.arm * r) * r - constant(turn_cross) * u * r**2
    inside = {"V < c": constant(level) - V}
    falls, low, high = (
        Claim("dW/dt <= -rate V^2", -lie_derivative_of(W, field) - constant(rate) * V * V, inside, NONNEGATIVE),
        Claim("W >= (1 - nearly) V", W - constant(1 - NEARLY) * V, inside, NONNEGATIVE),
        Claim("W <= (1 + nearly) V", constant(1 + NEARLY) * V - W, inside, NONNEGATIVE),
    )
    U, S, R = symbol("U"), symbol("S"), symbol("R")  # surge, slip and turn, each divided by its value at about 1 J
    states = {"u": 0.9 * U, "v": 1.2 * S + model.arm * 2.4 * R, "r": 2.4 * R}
    coordinates = {"U": u / 0.9, "S": (v - model.arm * r) / 1.2, "R": r / 2.4}
    squares = (U * U, U * S, U * R, S * S, S * R, R * R)
    bound = GramSearch(states, coordinates, {"": (U, S, R, *squares), "V < c": (U, S, R)})
    searches = {falls.name: GramSearch(states, coordinates, {"": (U, S, *squares), "V < c": (U, S)})}
    about = {"level": level, "rate": rate, "slip_cross": slip_cross, "turn_cross": turn_cross, "k1": k1, "k2": k2}
    return LawTheorem(
        "hovercraft/zero-velocity-time",
        about | craft,
        "ZeroVelocity: while V <= level, V falls from V0 to V1 within (1.3225/rate) (1/(0.85 V1) - 1/(1.15 V0)) s",
        Region(tuple(STATES.values()), (), zeros),
        claims=(falls, low, high),
        searches=searches | {low.name: bound, high.name: bound},
    )


def settling_bound(theorem: LawTheorem, start: float, end: float) -> float:
    """Return an upper bound (s) of the time in which V (J) falls from `start` to `end`.

    theorem: result of `zero_velocity_time`.
    """
    level, rate = float(theorem.about["level"]), float(theorem.about["rate"])
    if not 0 < end <= start <= level:
        problem = f"must be 0 < end <= start <= {level} J (level of the theorem), got start {start} J and end {end} J"
        raise InputError("settling_bound", problem, fix="choose 0 < end <= start <= level")
    return (1 + NEARLY) ** 2 / rate * (1 / ((1 - NEARLY) * end) - 1 / ((1 + NEARLY) * start))


def forward() -> LawTheorem:
    """Return the theorem that the law ForwardMomentum reaches its momentum reference PXr from every initial state.

    The theorem also holds if the gain k2 is less than PXr/d.
    """
    law = ForwardMomentum(k1=symbol("k1"), k2=symbol("k2"), reference=symbol("PXr"), model=_symbolic_craft())
    return _global_theorem("forward", law, ("k1", "k2", "PXr"))


def forward_matched() -> LawTheorem:
    """Return the theorem that the law ForwardMomentumMatched reaches its momentum reference from every initial
    state."""
    law = ForwardMomentumMatched(k1=symbol("k1"), reference=symbol("PXr"), model=_symbolic_craft())
    return _global_theorem("forward-matched", law, ("k1", "PXr"))


def reverse(
    *,
    k1: float = 1.5,
    k2: float = 1.0,
    theta: float = 1.44,
    reference: float = -1.98,
    mass: float = 2.6,
    inertia: float = 0.096,
    arm: float = 0.32,
) -> LawTheorem:
    """Return the theorem that the law ReverseMomentum reaches its momentum reference from a region of initial states.

    The theorem also states that the linearised loop is stable for all gains above given bounds.
    """
    about = {"k1": k1, "k2": k2, "theta": theta, "reference": reference}
    model, craft = _numeric_craft(mass, inertia, arm)
    law = ReverseMomentum(**{n: constant(v) for n, v in about.items()}, model=model)
    field, _ = closed_loop(model, law, HovercraftState(), STATES)
    ideal = _symbolic_craft()
    theta_above = ideal.inertia / (ideal.arm**2 * ideal.mass) * (1 + symbol("excess"))  # any value above the bound
    gains = {"k1": symbol("k1"), "k2": symbol("k2"), "theta": theta_above, "reference": -symbol("PXr")}
    open_law = ReverseMomentum(**gains, model=ideal)
    open_field, _ = closed_loop(ideal, open_law, HovercraftState(), STATES)
    return LawTheorem(
        "hovercraft/reverse",
        about | craft,
        "ReverseMomentum: the loop comes to rest at its equilibrium from every start with V <= c; the linear loop is "
        "stable for all k1, k2 > 0, PXr < 0, theta > J/(d^2 m)",
        Region(tuple(STATES.values()), (), _rest(law)),
        field,
        hurwitz=hurwitz_minors(open_field, _rest(open_law)),
        hurwitz_positive=(*CRAFT, "k1", "k2", "excess", "PXr"),
    )


def spin() -> LawTheorem:
    """Return the theorem about the law ConstantSpin: W never grows, and every motion ends in one of two limit
    points."""
    law = ConstantSpin(k1=symbol("k1"), k2=symbol("k2"), reference=symbol("ref"), model=_symbolic_craft())
    theorem = _global_theorem("spin", law, ("k1", "k2", "ref"), rest={"r": symbol("ref")})
    bad = {"u": constant(0), "v": -symbol("d") * symbol("ref"), "r": constant(0)}
    value = as_polynomial(limit_point_value(law.model, law.reference))
    assert theorem.lyapunov is not None
    return theorem._replace(
        says="ConstantSpin: W never grows, and motions end at r = ref or at the point that slides without turning; "
        "from W below limit_point_value at r = ref",
        limits=(theorem.region.rest, bad),
        identities={"W at the bad limit point is limit_point_value": theorem.lyapunov.substitute(bad) - value},
    )


def spin_gate(*, mass: float = 2.6, inertia: float = 0.096, arm: float = 0.32) -> LawTheorem:
    """Return the theorem that the law ConstantSpin reaches the yaw rate r = ref if V is below the switching energy.

    V is the kinetic energy at the start of the law. The theorem holds for both switching energies, and for no threshold
    above the sharp switching energy. W_bad in the names of the claims is the value of the Lyapunov function W at the
    undesired limit point (`limit_point_value`).
    """
    model, craft = _numeric_craft(mass, inertia, arm)
    ref, x = symbol("ref"), _state()
    V, margin = ZeroVelocity(model=model).lyapunov(x), _margin_of_spin(model, ref)
    sharp = float(switching_energy_sharp(Hovercraft(mass=mass, inertia=inertia, arm=arm), 1.0))
    J, D = inertia, arm**2 * mass
    thresholds = {  # name -> threshold, and the weight of its hypothesis in the proof
        "V < eps": (as_polynomial(switching_energy(model, ref)), 2 * (J + D) / D),
        "V < eps_sharp": (constant(sharp) * constant(1 - NEAR) * ref**2, 1 + (J + math.sqrt(J**2 + D * J)) / D),
    }
    region = Region(("u", "v", "r"), ("ref",), dict.fromkeys(("u", "v", "r"), constant(0)))
    claims, multipliers = [], {}
    for name, (threshold, weight) in thresholds.items():
        claims.append(Claim(f"{name} implies W < W_bad", margin, {name: threshold - V}, POSITIVE))
        multipliers[claims[-1].name] = {name: constant(weight)}
    fastest = constant(-math.sqrt(2 * sharp / J))
    beyond = Claim("", margin, {"V < a little more": constant(sharp) * constant(1 + NEAR) * ref**2 - V}, POSITIVE)
    worst = {"u": Fraction(0), "v": Fraction(0), "r": fastest.terms[()] * (1 + Fraction(NEAR) / 4), "ref": Fraction(1)}
    return LawTheorem(
        "hovercraft/spin-gate",
        craft,
        "V < switching_energy(ref), and V < switching_energy_sharp(ref), imply W < limit_point_value(ref); no larger "
        "threshold does",
        region,
        claims=tuple(claims),
        counterexamples=(Counterexample("eps_sharp is the largest", beyond, worst),),
        multipliers=multipliers,
    )


def spin_reference(*, mass: float = 2.6, inertia: float = 0.096, arm: float = 0.32) -> LawTheorem:
    """Return the theorem that the law ConstantSpin reaches a new yaw rate reference above `safe_reference_bound`.

    The theorem does not cover a new reference of opposite sign.

    Symbols: a is the old reference, b is the new reference, D = J (g^2 - 1), and h = b (1 + g) - a. If b is above the
    bound, h is above sqrt(2 W/J).
    """
    states, model = ("u", "v", "r"), _symbolic_craft()
    e, g, h, t = (symbol(n) for n in ("e", "g", "h", "t"))
    J, m, r = symbol("J"), symbol("m"), symbol("r")
    fallen = (h + e) / g
    energy = _about(model, fallen + e)
    lower = Claim(
        "a lower reference above the bound is safe",
        _with_ratio(_margin_of_spin(model, fallen), g),
        {"b above the bound": J * h * h / 2 - energy},
        POSITIVE,
    )
    lower_proof = WeightedSquares("", (e * m / 2, e * m / 2, e * J / 2), (symbol("u"), symbol("v"), h - r + fallen + e))
    a, ratio = symbol("a"), 1 + t
    higher = Claim(
        "any higher reference is safe",
        _with_ratio(_margin_of_spin(model, a + e), ratio),
        {"W < W_bad": _with_ratio(_margin_of_spin(model, a), ratio)},
        POSITIVE,
    )
    gain = e * J * a * a * ratio * (t + t * t) + e * J / 2 * a * ratio * (2 * t + t * t) * e
    higher_proof = WeightedSquares(
        "",
        (e * m / 2, e * m / 2, e * J / 2, gain),
        (symbol("u"), symbol("v"), a * ratio + r - a, constant(1)),
    )
    positive = ("J", "m", "e", "g", "h", "t", "a")
    return LawTheorem(
        "hovercraft/spin-reference",
        {"mass": mass, "inertia": inertia, "arm": arm},
        "while W < limit_point_value, a new reference of the same sign above safe_reference_bound keeps W below the "
        "new limit_point_value, and so does any larger one; of the other sign it does not",
        Region(states, positive, dict.fromkeys(states, constant(0))),
        claims=(lower, higher),
        counterexamples=(_sign_flip(Hovercraft(mass=mass, inertia=inertia, arm=arm)),),
        lines=(_bound_line(Hovercraft(mass=mass, inertia=inertia, arm=arm)),),
        proofs={
            lower.name: SquaresProof(h, (_times("b above the bound", h + e), lower_proof)),
            higher.name: SquaresProof(a * ratio, (_times("W < W_bad", a * ratio + e), higher_proof)),
        },
    )


THEOREMS = {
    "hovercraft/zero-velocity": zero_velocity,
    "hovercraft/zero-velocity-time": zero_velocity_time,
    "hovercraft/forward": forward,
    "hovercraft/forward-matched": forward_matched,
    "hovercraft/reverse": reverse,
    "hovercraft/spin": spin,
    "hovercraft/spin-gate": spin_gate,
    "hovercraft/spin-reference": spin_reference,
}
"""Name of a theorem -> function that returns the theorem."""


def _global_theorem(name: str, law: Any, gains: tuple[str, ...], rest: Any = None) -> LawTheorem:
    """Return the theorem that a loop comes to rest at its equilibrium from every state, for all positive parameters.

    gains: names of the law's parameters.  rest: values of states at the equilibrium, if the law does not define them.
    """
    field, value = closed_loop(law.model, law, HovercraftState(), STATES)
    zeros = dict.fromkeys(STATES.values(), constant(0))
    region = Region(tuple(STATES.values()), (*CRAFT, *gains), zeros | rest if rest else _rest(law))
    says = f"{type(law).__name__}: the loop comes to rest at its equilibrium from every start, for all positive "
    return LawTheorem(f"hovercraft/{name}", {}, says + ", ".join(region.positive), region, field, value)


def _rest(law: Any) -> dict[str, Polynomial]:
    point = law.equilibrium()
    return {name: as_polynomial(getattr(point, attribute)) for attribute, name in STATES.items()}


def _state() -> HovercraftState:
    return HovercraftState(surge_velocity=symbol("u"), sway_velocity=symbol("v"), yaw_rate=symbol("r"))


def _symbolic_craft() -> Hovercraft:
    return Hovercraft(mass=symbol("m"), inertia=symbol("J"), arm=symbol("d"))


def _numeric_craft(mass: float, inertia: float, arm: float) -> tuple[Hovercraft, dict[str, float]]:
    numbers = {"mass": mass, "inertia": inertia, "arm": arm}
    return Hovercraft(**{n: constant(v) for n, v in numbers.items()}), numbers


def _margin_of_spin(model: Hovercraft, reference: Any) -> Polynomial:
    """Return limit_point_value - W for a reference. Where this is positive, ConstantSpin reaches r = reference."""
    return as_polynomial(limit_point_value(model, reference)) - _about(model, reference)


def _about(model: Hovercraft, reference: Any) -> Polynomial:
    return as_polynomial(lyapunov(model, _state(), reference))


def _with_ratio(p: Polynomial, g: Polynomial) -> Polynomial:
    """Return the polynomial p with d^2 replaced by J (g^2 - 1)/m, so that D = d^2 m equals J (g^2 - 1)."""
    square = symbol("J") * (g * g - 1) / symbol("m")
    return sum((part * square ** (dict(m).get("d", 0) // 2) for m, part in p.collect(("d",)).items()), constant(0))


def _times(hypothesis: str, weight: Polynomial) -> WeightedSquares:
    return WeightedSquares(hypothesis, (weight,), (constant(1),))


def _bound_line(model: Hovercraft) -> Line:
    """Return the numerical check that b = safe_reference_bound solves b (1 + g) - a = sqrt(2 W/J)."""

    def compare() -> ProofCondition:
        g, off = math.sqrt(1 + model.arm**2 * model.mass / model.inertia), 0.0
        for W, a in ((0.0, 3.0), (0.3, 1.5), (1.6, -3.0), (1e-4, 0.02)):
            b = float(safe_reference_bound(model, W, a))
            off = max(off, abs(b * (1 + g) - abs(a) - math.sqrt(2 * W / model.inertia)) / abs(a))
        why = "" if off < NEAR else "safe_reference_bound differs from the bound of the proof"
        return ProofCondition("", off < NEAR, off, "relative deviation", "floats", why)

    return "safe_reference_bound is the bound of the proof", compare


def _sign_flip(model: Hovercraft) -> Counterexample:
    """Return the counterexample of a new reference of opposite sign, which is not safe even 1 % above the bound.

    In the counterexample, the craft spins steadily at the old reference of 3 rad/s.
    """
    exact_model, _ = _numeric_craft(model.mass, model.inertia, model.arm)
    a, r = constant(3), constant(3)
    turned = -constant(1.01 * float(safe_reference_bound(model, 0.0, 3.0)))
    before = {"W < W_bad": _margin_of_spin(exact_model, a)}
    claim = Claim("", _margin_of_spin(exact_model, turned), before, POSITIVE)
    point = {"u": Fraction(0), "v": Fraction(0), "r": r.terms[()]}
    return Counterexample("a new sign is not covered", claim, point)
