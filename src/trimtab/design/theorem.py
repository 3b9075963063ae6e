"""Theorems about a closed loop, computed from the code of a law. Stability is proved exactly by a Lyapunov function.

The closed loop is obtained by running the vehicle's and the law's own code on polynomials. The Lyapunov function,
thresholds and equilibria also come from the law, if it has them. A certificate contains the Lyapunov function and sums
of squares. The proof here checks these against the code, without a solver. Where -dV/dt vanishes on more than a point,
LaSalle's largest invariant set is computed.

Source: [1] H. K. Khalil, "Nonlinear Systems", Prentice Hall 2002, theorems 4.2, 4.4 and section 8.2; [2] A. Hurwitz,
Math. Annalen 46 (1895), for the minors.
"""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.signals import Estimate
from trimtab.design.certified_system import Setting
from trimtab.design.gram_search import GramSearch
from trimtab.design.polynomial import Polynomial, as_polynomial, constant, lie_derivative_of, symbol
from trimtab.design.proof import CertificateProof, Line, ProofCondition, evaluate_lines, version_line
from trimtab.design.squares import (
    DEFINITE,
    NONNEGATIVE,
    Claim,
    Region,
    SquaresProof,
    find_fault,
    has_growing_forms,
    is_at_rest,
    unconditional_forms,
)
from trimtab.design.zero_set import ZeroBranch, largest_invariant_set, solve_equations

GROWS, FALLS = "V > 0", "-dV/dt >= 0"
"""Names of the two claims of every theorem about a motion: V is positive, and V never rises."""
INSIDE = "c - V"
"""Name of the hypothesis of a theorem about a region: the Lyapunov function V is below the level c."""
EXACT = "exact, polynomials"


class Counterexample(NamedTuple):
    """Counterexample: a point at which a claim is wrong.

    name: name of the proof condition.  claim: the wrong claim, with hypotheses and conclusion.  point: name -> number.
    """

    name: str
    claim: Claim
    point: Mapping[str, Fraction]


class LawTheorem(NamedTuple):
    """Theorem to be proved, which comes entirely from code.

    name: as in `trimtab design NAME`.  about: settings.  says: the theorem in words.  region: states, positive names
    and equilibrium.  field: derivative of each state; empty for a theorem that is not about a motion.  lyapunov: V of
    the law, or None if V comes from the certificate.  limits: all end points of motions, each as state -> polynomial;
    the proof must find exactly these points.  hurwitz: polynomials that are positive if the linear loop is stable, for
    all positive values of hurwitz_positive.  claims: further claims.  identities: name -> polynomial that must be zero.
    counterexamples: wrong claims, each with a point at which it is wrong.  lines: further conditions.

    Three fields only help to create a certificate, and prove nothing.  multipliers: claim -> hypothesis -> weight of
    the hypothesis.  searches: claim -> setup of the search for Gram matrices.  proofs: claim -> known proof.
    """

    name: str
    about: Mapping[str, Setting]
    says: str
    region: Region
    field: Mapping[str, Polynomial] = {}
    lyapunov: Polynomial | None = None
    limits: tuple[Mapping[str, Polynomial], ...] = ()
    hurwitz: tuple[Polynomial, ...] = ()
    hurwitz_positive: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()
    identities: Mapping[str, Polynomial] = {}
    counterexamples: tuple[Counterexample, ...] = ()
    lines: tuple[Line, ...] = ()
    multipliers: Mapping[str, Mapping[str, Polynomial]] = {}
    searches: Mapping[str, GramSearch] = {}
    proofs: Mapping[str, SquaresProof] = {}


class TheoremCertificate(NamedTuple):
    """Content of a theorem's certificate file.

    theorem: name.  about: settings.  says: the theorem in words.  lyapunov: V, None if the theorem is not about a
    motion.  level: level of V, if the theorem is about a region.  proofs: claim -> proof.  version: package version.
    """

    theorem: str
    about: Mapping[str, Setting]
    says: str
    lyapunov: Polynomial | None
    level: Fraction | None
    proofs: Mapping[str, SquaresProof]
    version: str


def closed_loop(
    vehicle: Any, law: Any, state: Any, names: Mapping[str, str]
) -> tuple[dict[str, Polynomial], Polynomial | None]:
    """Return the state derivatives of a vehicle under a law, and the law's `lyapunov` output or None, as polynomials.

    Args:
        vehicle: vehicle with `dynamics(t, x, u)`; its parameters may be polynomials.
        law: law without internal state, with an output `demand`; its parameters may be polynomials.
        state: a state record; fields that are not in `names` keep their values.
        names: field of the state record -> name in the polynomials.

    Raises: InputError if the code does more than add, multiply, and divide by single terms.
    """
    try:
        x = replace(state, **{attribute: symbol(name) for attribute, name in names.items()})
        _, output = law.step(0, (), Estimate(t=0, age=0.0, fresh=True, valid=True, state=x))
        rate = vehicle.dynamics(0.0, x, output.demand)
        field = {name: as_polynomial(getattr(rate, attribute)) for attribute, name in names.items()}
        value = getattr(output, "lyapunov", None)
        return field, None if value is None else as_polynomial(value)
    except (TypeError, ValueError, ArithmeticError) as error:
        problem = f"its code is not a polynomial of {', '.join(names)}: {error}"
        fix = "use laws that only add, multiply, and divide by single terms"
        raise InputError(type(law).__name__, problem, fix=fix) from error


def motion_claims(theorem: LawTheorem, lyapunov: Polynomial, level: Fraction | None) -> tuple[Claim, ...]:
    """Return the claims V > 0 and -dV/dt >= 0. If a level is given, the second claim is made only where V is below this
    level."""
    inside = {} if level is None else {INSIDE: constant(level) - lyapunov}
    rate = -lie_derivative_of(lyapunov, theorem.field)
    falls = Claim(FALLS, rate, inside, NONNEGATIVE if level is None else DEFINITE)
    return Claim(GROWS, lyapunov, {}, DEFINITE), falls


def hurwitz_minors(field: Mapping[str, Polynomial], rest: Mapping[str, Polynomial]) -> tuple[Polynomial, ...]:
    """Return polynomials that are all positive if and only if the Jacobian at rest (n <= 3) is Hurwitz. Source: [2]."""
    J = [[f.derivative(n).substitute(rest) for n in field] for f in field.values()]
    coefficients, power = [constant(1)], _unit_matrix(len(J))
    for k in range(1, len(J) + 1):  # characteristic polynomial by the method of Faddeev and LeVerrier
        power = _multiply_matrices(J, power)
        c = -sum((power[i][i] for i in range(len(J))), constant(0)) / k
        coefficients.append(c)
        power = [[power[i][j] + (c if i == j else constant(0)) for j in range(len(J))] for i in range(len(J))]
    if len(J) > 3:
        raise InputError(
            "hurwitz",
            f"must have at most 3 states, got {len(J)}",
            fix="use a theorem with a Lyapunov function instead",
        )
    last = (coefficients[1] * coefficients[2] - coefficients[3],) if len(J) == 3 else ()
    return (*coefficients[1:], *last)


def prove_theorem(
    certificate: TheoremCertificate, theorem: LawTheorem, digests: tuple[str, str] | None = None
) -> CertificateProof:
    """Evaluate all conditions of a certificate, even after one has failed.

    Args:
        certificate: a new certificate, or one read from a file.
        theorem: the theorem that the certificate names, built again from code.
        digests: the digest written in the file, and the digest of the file's content.
    """
    lines = list(_data_lines(certificate, theorem))
    if theorem.field:
        lines += _motion_lines(certificate, theorem)
    else:
        empty = certificate.lyapunov is None and certificate.level is None
        lines.append(
            (
                "no V, because the theorem is not about a motion",
                lambda: _verdict(empty, "the file must contain neither V nor a level"),
            )
        )
    lines += [(claim.name, lambda c=claim: _prove_claim(certificate, theorem, c)) for claim in theorem.claims]
    lines += [(name, lambda p=p: _identity(p)) for name, p in theorem.identities.items()]
    lines += [(e.name, lambda e=e: _refute(e)) for e in theorem.counterexamples]
    lines += theorem.lines
    if digests is not None:
        why = "the file was changed after it was written; the other conditions show the effect"
        lines.append(version_line(certificate.version))
        lines.append(
            ("file unchanged since it was written", lambda: _verdict(digests[0] == digests[1], why, how="SHA-256"))
        )
    return evaluate_lines(lines)


def claims_of(theorem: LawTheorem, lyapunov: Polynomial | None, level: Fraction | None) -> tuple[Claim, ...]:
    """Return all claims of a theorem that need a sum of squares."""
    motion = () if lyapunov is None or not theorem.field else motion_claims(theorem, lyapunov, level)
    return (*motion, *theorem.claims)


def _data_lines(c: TheoremCertificate, theorem: LawTheorem) -> Iterator[Line]:
    now, there = dict(theorem.about), dict(c.about)
    apart = [
        f"{n}: {there.get(n)!r}, must be {now.get(n)!r}" for n in sorted({*now, *there}) if now.get(n) != there.get(n)
    ]
    words = c.theorem == theorem.name and c.says == theorem.says
    yield f"theorem is that of {theorem.name}", lambda: _verdict(words, f"the file claims {c.says!r} for {c.theorem!r}")
    yield f"settings are those of {theorem.name}", lambda: _verdict(not apart, "; ".join(apart))
    wanted = {claim.name for claim in claims_of(theorem, c.lyapunov, c.level)}
    unknown = sorted(set(c.proofs) - wanted)
    yield "no other proof in the file", lambda: _verdict(not unknown, "unknown: " + ", ".join(unknown))


def _motion_lines(c: TheoremCertificate, theorem: LawTheorem) -> Iterator[Line]:
    region, V = theorem.region, c.lyapunov
    at_rest = [f.substitute(dict(region.rest)) for f in theorem.field.values()]
    resting = f"the state derivatives at rest are {', '.join(map(str, at_rest))}"
    yield "the law's point of rest is an equilibrium", lambda: _verdict(not any(at_rest), resting)
    yield "points of rest", lambda: _rest_condition(theorem)
    if V is None:
        yield GROWS, lambda: _verdict(False, "the file has no Lyapunov function")
        return
    if theorem.lyapunov is not None:
        yield "V is that of the law", lambda: _identity(V - theorem.lyapunov)
    if (c.level is None) != (theorem.lyapunov is not None):
        yield "level", lambda: _verdict(False, "a level must be given if and only if the law has no Lyapunov function")
    if c.level is not None:
        level = c.level
        yield "level is above 0", lambda: _verdict(level > 0, f"the level is {level}", float(level), "level of V")
    for claim in motion_claims(theorem, V, c.level):
        yield claim.name, lambda k=claim: _prove_claim(c, theorem, k)
    yield "V grows without bound", lambda: _growth_condition(c, region)
    if c.level is None:
        yield "largest invariant set in dV/dt = 0", lambda: _invariant_condition(c, theorem)
    if theorem.hurwitz:
        yield "linear loop at rest is stable", lambda: _hurwitz_condition(theorem)


def _verdict(
    holds: bool, why: str, number: float | None = None, meaning: str = "differences", how: str = EXACT
) -> ProofCondition:
    number = float(not holds) if number is None else number
    return ProofCondition("", holds, number, meaning, how, "" if holds else why)


def _prove_claim(c: TheoremCertificate, theorem: LawTheorem, claim: Claim) -> ProofCondition:
    proof = c.proofs.get(claim.name)
    if proof is None:
        return _verdict(False, "the file has no proof of this claim")
    fault, count = find_fault(claim, proof, theorem.region), sum(len(t.forms) for t in proof.terms)
    where = f"where {', '.join(claim.hypotheses)} > 0" if claim.hypotheses else ""
    condition = _verdict(not fault, fault, float(count), "squares")
    return condition._replace(why=fault or " ".join(filter(None, (claim.says, where))))


def _identity(p: Polynomial) -> ProofCondition:
    return _verdict(not p, f"the difference is {p}", float(len(p.terms)), "terms that differ")


def _growth_condition(c: TheoremCertificate, region: Region) -> ProofCondition:
    proof = c.proofs.get(GROWS)
    return _verdict(
        proof is not None and has_growing_forms(proof, region),
        "the linear forms in the proof of V > 0 also vanish away from rest",
    )


def _rest_condition(theorem: LawTheorem) -> ProofCondition:
    branches = solve_equations(theorem.field.values(), theorem.region.states, theorem.region.positive)
    return _compare_branches(branches, theorem.limits or (theorem.region.rest,), "")


def _invariant_condition(c: TheoremCertificate, theorem: LawTheorem) -> ProofCondition:
    proof = c.proofs.get(FALLS)
    if proof is None:
        return _verdict(False, "the file has no proof of -dV/dt >= 0")
    region, forms = theorem.region, unconditional_forms(proof)
    where = solve_equations(forms, region.states, region.positive)
    M = largest_invariant_set(theorem.field, forms, region.positive)
    steps = "; ".join(dict.fromkeys(step for b in M for step in b.steps))
    kind = {0: "a point", 1: "a line", 2: "a surface"}
    words = "dV/dt = 0 on " + " and on ".join(f"{kind.get(b.dimension, 'a set')} ({b})" for b in where)
    return _compare_branches(
        M, theorem.limits or (region.rest,), words if is_at_rest(where, region) else f"{words}; {steps}"
    )


def _compare_branches(
    branches: Sequence[ZeroBranch], wanted: Sequence[Mapping[str, Polynomial]], words: str
) -> ProofCondition:
    found = {str(b) for b in branches}
    same = found == {str(ZeroBranch(dict(w), ())) for w in wanted}
    text = "; or ".join(sorted(found)) or "nothing"
    condition = _verdict(same, "", float(len(branches)), "pieces")
    return condition._replace(why=f"{words}{'; ' if words else ''}{'it is' if same else 'found'} {text}")


def _hurwitz_condition(theorem: LawTheorem) -> ProofCondition:
    bad = [p for p in theorem.hurwitz if p.sign(theorem.hurwitz_positive) != 1]
    why = "" if not bad else f"the minor {bad[0]} may be negative"
    text = f"for all positive {', '.join(theorem.hurwitz_positive)}" if theorem.hurwitz_positive else ""
    return _verdict(not bad, why, float(len(theorem.hurwitz)), "minors")._replace(why=why or text)


def _refute(e: Counterexample) -> ProofCondition:
    point = {name: constant(value) for name, value in e.point.items()}
    values = {name: _number(h.substitute(point)) for name, h in e.claim.hypotheses.items()}
    value = _number(e.claim.conclusion.substitute(point))
    outside = [f"{name} is {float(v):.4g}" for name, v in values.items() if v <= 0]
    holds = not outside and value <= 0
    why = f"at {', '.join(f'{n} = {float(v):.5g}' for n, v in e.point.items())}"
    return ProofCondition("", holds, float(value), "conclusion at this point", EXACT, "; ".join([why, *outside]))


def _number(p: Polynomial) -> Fraction:
    if p.names:
        raise ArithmeticError(f"{p} is not a number at that point")
    return p.terms.get((), Fraction(0))


def _unit_matrix(n: int) -> list[list[Polynomial]]:
    return [[constant(int(i == j)) for j in range(n)] for i in range(n)]


def _multiply_matrices(a: list[list[Polynomial]], b: list[list[Polynomial]]) -> list[list[Polynomial]]:
    return [
        [sum((x * y for x, y in zip(row, column, strict=True)), constant(0)) for column in zip(*b, strict=True)]
        for row in a
    ]
