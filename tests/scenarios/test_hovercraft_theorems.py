"""Theorems about the hovercraft's laws: proved for the shipped code, and not for code with a mistake.

Numbers: Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 2.2.
"""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import trimtab.laws.spin as spin_laws
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.core.time import ms
from trimtab.design.polynomial import constant, lie_derivative_of, symbol
from trimtab.design.theorem import FALLS, GROWS, prove_theorem
from trimtab.design.theorem_file import design_theorem, parse_theorem, theorem_digest
from trimtab.laws.velocity import ForwardMomentum, ForwardMomentumMatched, ReverseMomentum, VelocityOutput, ZeroVelocity
from trimtab.logs.robustness import VERDICTS, VIOLATED
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build
from trimtab.scenarios.hovercraft import _theorems
from trimtab.scenarios.hovercraft._theorems import THEOREMS, settling_bound
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

FILES = Path(__file__).parents[2] / "examples" / "certificates"
DWELLS = {"proved": 21, "hasty": 0.2}
"""By name of a formula: how long braking may take (s)."""
LAWS = {
    "zero-velocity": ZeroVelocity,
    "forward": ForwardMomentum,
    "forward-matched": ForwardMomentumMatched,
    "reverse": ReverseMomentum,
    "spin": spin_laws.ConstantSpin,
}
INVARIANT = "largest invariant set in dV/dt = 0"


def read(name):
    file = FILES / f"{name}.json"
    return parse_theorem(file.read_text(encoding="utf-8"), file.name)


def prove(name, **changes):
    """Prove a theorem about the current code with its shipped certificate."""
    certificate, written = read(name)
    theorem = THEOREMS[f"hovercraft/{name}"](**dict(certificate.about))._replace(**changes)
    return prove_theorem(certificate, theorem, (written, theorem_digest(certificate)))


def fails(proof):
    return {c.name: c.why for c in proof.conditions if not c.holds}


def lines(proof):
    return {c.name: c for c in proof.conditions}


@pytest.mark.parametrize("name", [name.partition("/")[2] for name in THEOREMS])
def test_shipped_certificates_are_proved(name):
    assert fails(prove(name)) == {}


def test_zero_velocity_invariant_set_is_the_origin():
    """dV/dt vanishes on a line, not only at the point as in the thesis; LaSalle's invariant set in it is computed."""
    c = lines(prove("zero-velocity"))[INVARIANT]
    assert c.why.startswith("dV/dt = 0 on a line (r = v/d, u = 0)")
    assert c.why.endswith("it is r = 0, u = 0, v = 0")
    assert "d(u)/dt is v^2/d on this branch" in c.why


def test_forward_decrease_is_a_sum_of_squares():
    certificate, _ = read("forward")
    k1, k2, m, d, PXr, u, v, r = (symbol(n) for n in ("k1", "k2", "m", "d", "PXr", "u", "v", "r"))
    (term,) = certificate.proofs[FALLS].terms
    assert term.value() == k1 * (u - PXr / m) ** 2 + k2 * (v - d * r) ** 2 + PXr * d * r**2


def test_published_lyapunov_function_is_not_proved_for_all_gains():
    """lambda = 1 - kappa: the form is not positive for all gains, and of the source's own (table 6.2) it is not."""
    theorem = THEOREMS["hovercraft/forward"]()
    J, d, k2, PXr, r = (symbol(n) for n in ("J", "d", "k2", "PXr", "r"))
    printed = theorem.lyapunov - J * PXr * r**2 / (d * k2)  # 1 + kappa becomes 1 - kappa
    proof = prove_theorem(design_theorem(theorem, printed), theorem._replace(lyapunov=printed))
    assert "V > 0" in fails(proof)
    assert FALLS in fails(proof)
    kappa = 2.8 / (4.0 * 0.32)
    assert np.linalg.eigvalsh(4.0 * np.array([[1, -0.32], [-0.32, (1 + kappa) * 0.1024]])).min() > 0


def test_spin_has_two_limit_points_including_the_threshold():
    proof = lines(prove("spin"))
    assert proof[INVARIANT].number == 2
    assert "r = 0, u = 0, v = -d*ref; or r = ref, u = 0, v = 0" in proof[INVARIANT].why
    assert proof["W at the bad limit point is limit_point_value"].holds


def test_spin_gate_energies_match_published_values():
    """eps = 0.220142 J and W_bad = 1.63008 J at 3 rad/s; the sharp eps is 1.74321 times as large."""
    theorem = THEOREMS["hovercraft/spin-gate"]()
    published, sharp = (next(iter(c.hypotheses.values())) for c in theorem.claims)
    at = {n: constant(0) for n in "uvr"} | {"ref": constant(3)}
    eps = float(published.substitute(at).terms[()])
    assert eps == pytest.approx(0.220142, abs=1e-6)
    assert float(sharp.substitute(at).terms[()]) / eps == pytest.approx(1.74321, abs=1e-5)
    W_bad = theorem.claims[0].conclusion.substitute(at | {"r": constant(3)})
    assert float(W_bad.terms[()]) == pytest.approx(1.63008, abs=1e-5)


# mutated laws


def mutate(law, FX=lambda f, s, law: f, FY=lambda f, s, law: f):
    """Return a law whose demand is changed by functions of the demand, the state and the law."""

    class Mutant:
        def __init__(self, **settings):
            self.law, self.model = law(**settings), settings.get("model")
            self.__dict__.update(settings)

        def step(self, t, state, estimate):
            _, out = self.law.step(t, state, estimate)
            s = estimate.state
            demand = PlanarForce(FX(out.demand.FX, s, self), FY(out.demand.FY, s, self))
            return (), VelocityOutput(demand, out.lyapunov)

        def equilibrium(self):
            return self.law.equilibrium()

    return Mutant


MUTANTS = {
    "surge drives away": {"FX": lambda f, s, law: -f},
    "sway drives away": {"FY": lambda f, s, law: -f},
    "the pivot's slip with the other sign": {"FY": lambda f, s, law: f - 2 * law.model.arm * s.yaw_rate},
    "no sway": {"FY": lambda f, s, law: 0 * f},
    "no surge": {"FX": lambda f, s, law: 0 * f},
    "an offset": {"FX": lambda f, s, law: f + 1},
    "sway alone": {"FY": lambda f, s, law: -2.5 * s.sway_velocity},
    "a cubic": {"FY": lambda f, s, law: f + s.yaw_rate**3},
    "yaw turned into surge": {"FX": lambda f, s, law: f + s.yaw_rate},
}


@pytest.mark.parametrize("change", MUTANTS)
@pytest.mark.parametrize("name", LAWS)
def test_mutated_law_is_not_proved(name, change, monkeypatch):
    """The mutant is proved neither by the shipped certificate nor by a new one, where one can be designed."""
    monkeypatch.setattr(_theorems, LAWS[name].__name__, mutate(LAWS[name], **MUTANTS[change]))
    proof = prove(name)
    assert not proof.holds
    if name != "reverse":
        theorem = THEOREMS[f"hovercraft/{name}"]()
        assert not prove_theorem(design_theorem(theorem), theorem).holds


def with_equilibrium(law, **point):
    class Mutant(mutate(law)):
        def equilibrium(self):
            return replace(super().equilibrium(), **point)

    return Mutant


@pytest.mark.parametrize("name", ["zero-velocity", "forward", "forward-matched", "reverse"])
@pytest.mark.parametrize("state", ["surge_velocity", "sway_velocity", "yaw_rate"])
def test_wrong_equilibrium_is_not_proved(name, state, monkeypatch):
    monkeypatch.setattr(_theorems, LAWS[name].__name__, with_equilibrium(LAWS[name], **{state: constant(2)}))
    assert "the law's point of rest is an equilibrium" in fails(prove(name))


def test_wrong_spin_limit_points_are_not_proved():
    limits = THEOREMS["hovercraft/spin"]().limits
    for wrong in (limits[:1], limits[1:], (*limits, {n: constant(1) for n in "uvr"})):
        assert {"points of rest", INVARIANT} <= set(fails(prove("spin", limits=wrong)))


def test_reverse_is_proved_only_above_its_bound(monkeypatch):
    """theta = (1 - excess) J/(d^2 m), below the bound: the minors are not positive, and no region is computed."""

    class Below(ReverseMomentum):
        def step(self, t, state, estimate):
            J, d, m = self.model.inertia, self.model.arm, self.model.mass
            return super(Below, replace(self, theta=2 * J / (d**2 * m) - self.theta)).step(t, state, estimate)

    monkeypatch.setattr(_theorems, "ReverseMomentum", Below)
    assert "linear loop at rest is stable" in fails(prove("reverse"))
    monkeypatch.undo()
    from trimtab.design.attraction import find_region

    with pytest.raises(InputError, match="not stable"):
        find_region(THEOREMS["hovercraft/reverse"](theta=0.36))


@pytest.mark.parametrize("name", ["switching_energy", "limit_point_value", "lyapunov", "safe_reference_bound"])
@pytest.mark.parametrize("theorem", ["spin-gate", "spin-reference"])
def test_changed_spin_threshold_is_not_proved(name, theorem, monkeypatch):
    """Changing a threshold breaks exactly the theorems that are about it."""
    shipped = getattr(spin_laws, name)
    larger = -1 if name == "limit_point_value" else 1
    monkeypatch.setattr(_theorems, name, lambda *a: shipped(*a) * (1 + larger * 0.5))
    about = {"spin-gate": ("switching_energy", "limit_point_value", "lyapunov")}
    about["spin-reference"] = ("limit_point_value", "lyapunov", "safe_reference_bound")
    assert prove(theorem).holds == (name not in about[theorem])


def test_gate_wider_than_the_sharp_one_is_not_proved(monkeypatch):
    shipped = spin_laws.switching_energy_sharp
    monkeypatch.setattr(_theorems, "switching_energy_sharp", lambda *a: shipped(*a) * (1 + 1e-6))
    assert "V < eps_sharp implies W < W_bad" in fails(prove("spin-gate"))
    monkeypatch.setattr(_theorems, "switching_energy_sharp", lambda *a: shipped(*a) * (1 - 1e-6))
    assert "eps_sharp is the largest" in fails(prove("spin-gate"))


# simulation beside it


def rates(law):
    model = Hovercraft()

    def f(t, z):
        s = HovercraftState(*map(float, z))
        _, out = law.step(0, (), Estimate(t=0, age=0.0, fresh=True, valid=True, state=s))
        rate = model.dynamics(0.0, s, out.demand)
        return [float(rate.surge_velocity), float(rate.sway_velocity), float(rate.yaw_rate)]

    return f


@pytest.mark.thorough
def test_reverse_converges_from_the_edge_of_its_region():
    """The shipped law and vehicle in floats, from V = c: V always falls. The region has a useful size."""
    certificate, _ = read("reverse")
    point = {"u": symbol("u") - Fraction(99, 130)}
    V = certificate.lyapunov.substitute(point)
    P = np.zeros((3, 3))
    for i, a in enumerate("uvr"):
        for j, b in enumerate("uvr"):
            P[i, j] = float(V.derivative(a).derivative(b).terms.get((), 0)) / 2
    assert np.array_equal(P, P.T)
    level, f = float(certificate.level), rates(ReverseMomentum())
    rest, draws = np.array([-1.98 / 2.6, 0.0, 0.0]), np.random.default_rng(5)
    for _ in range(5):
        e = draws.standard_normal(3)
        e *= np.sqrt(level / (e @ P @ e))
        path = solve_ivp(f, (0, 40), rest + e, rtol=1e-9, atol=1e-10, t_eval=np.linspace(0, 40, 201))
        value = np.einsum("it,ij,jt->t", path.y - rest[:, None], P, path.y - rest[:, None])
        assert (np.diff(value)[value[1:] > 1e-10] < 0).all()
        assert np.abs(path.y[:, -1] - rest).max() < 1e-4
    extents = np.sqrt(level * np.diag(np.linalg.inv(P)))
    assert (extents > [4.5, 4.5, 9.0]).all()


def test_reverse_lyapunov_function_grows_outside_its_region():
    """dV/dt is positive at some point with V below six times the proved level."""
    theorem = THEOREMS["hovercraft/reverse"]()
    certificate, _ = read("reverse")
    draws, fall = np.random.default_rng(6), -lie_derivative_of(certificate.lyapunov, theorem.field)

    def numbers(p, z):
        return sum(
            float(c) * np.prod([z["uvr".index(n)] ** q for n, q in m] or [1.0], axis=0) for m, c in p.terms.items()
        )

    z = draws.uniform(-1, 1, (3, 200_000)) * np.array([[12.0], [12.0], [24.0]])
    V, falls = numbers(certificate.lyapunov, z), numbers(fall, z)
    worst = V[falls < 0].min()
    assert float(certificate.level) < worst < 6 * float(certificate.level)


def test_a_claim_without_proof_is_not_proved():
    certificate, _ = read("forward")
    theorem = THEOREMS["hovercraft/forward"]()
    for claim in (GROWS, FALLS):
        proofs = {n: p for n, p in certificate.proofs.items() if n != claim}
        assert claim in fails(prove_theorem(certificate._replace(proofs=proofs), theorem))


def fly_zero_velocity(start, ends):
    """Return the times in which V of the shipped law and vehicle falls from V = start J to each of the ends."""
    law, model = ZeroVelocity(), Hovercraft()
    m, J, d, k1, k2 = (float(v) for v in (model.mass, model.inertia, model.arm, law.k1, law.k2))

    def f(t, z):
        u, v, r = z
        FX, FY = -k1 * u, -k2 * (v - d * r)
        return [v * r + FX / m, -u * r + FY / m, -d * FY / J]

    path = solve_ivp(f, (0, 120), start, rtol=1e-9, atol=1e-12, t_eval=np.linspace(0, 120, 12_001))
    V = (m * (path.y[0] ** 2 + path.y[1] ** 2) + J * path.y[2] ** 2) / 2
    return [float(path.t[np.argmax(end > V)]) for end in ends]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("changes", "ends"),
    [({}, (0.5, 0.2, 0.1)), ({"level": 0.2, "rate": 1.0, "slip_cross": 0.4, "turn_cross": 0.12}, (0.1, 0.05, 0.02446))],
)
def test_zero_velocity_settles_within_the_proved_time(changes, ends):
    """From random starts at the level; the bound is within 15 times of the slowest run."""
    theorem = THEOREMS["hovercraft/zero-velocity-time"](**changes)
    pytest.importorskip("clarabel")
    assert prove_theorem(design_theorem(theorem), theorem).holds
    level, draws = float(theorem.about["level"]), np.random.default_rng(7)
    size = np.sqrt(2 * level / np.array([2.6, 2.6, 0.096]))
    slowest = np.zeros(len(ends))
    for _ in range(25):
        e = draws.standard_normal(3)
        slowest = np.maximum(slowest, fly_zero_velocity(e / np.linalg.norm(e) * size, ends))
    bounds = np.array([settling_bound(theorem, level, end) for end in ends])
    assert (slowest < bounds).all()
    assert (bounds < 15 * slowest).all()


def test_excessive_decay_rate_is_not_proved():
    pytest.importorskip("clarabel")
    theorem = THEOREMS["hovercraft/zero-velocity-time"](rate=2.0)
    assert "dW/dt <= -rate V^2" in fails(prove_theorem(design_theorem(theorem), theorem))
    for start, end in ((2.0, 0.1), (0.1, 0.2), (0.1, 0.0)):
        with pytest.raises(InputError, match="level"):
            settling_bound(theorem, start, end)


@pytest.mark.thorough
def test_monitor_checks_the_proved_braking_time_in_flight():
    """21 s from 1 J to 0.2 J: met in a flight with all imperfections; a hundredth of it is violated."""
    bound = settling_bound(THEOREMS["hovercraft/zero-velocity-time"](), 1.0, 0.2)
    assert 20 < bound < 21
    formulas = "; ".join(
        f"{n}: always(law.mode == 1 or eventually[0, {s} s](law.mode == 1))" for n, s in DWELLS.items()
    )
    flown = build("hovercraft/heading-bang-bang", {"duration": "40 s", "autopilot.monitor.formulas": formulas})
    log = simulate(flown, log_period=ms(100), signals=("law", "monitor"))
    assert (log["law.mode"] == 0).any(), "it brakes"
    assert VERDICTS[int(log["monitor.proved.verdict"][-1])] == "holds"
    assert VERDICTS[int(log["monitor.hasty.verdict"][-1])] == VERDICTS[VIOLATED]
