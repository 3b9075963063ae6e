"""Proofs of certificates: valid ones hold, and each condition is violated once, alone where possible."""

import numpy as np
import pytest
from design.systems import ball_system, integrators

from trimtab.design import composite
from trimtab.design.certificate import design_certificate
from trimtab.design.certificate_check import ROBUST, _poles_condition, prove_certificate
from trimtab.design.certificate_file import certificate_digest
from trimtab.design.certified_system import CertifiedSystem

SYSTEM = ball_system()


@pytest.fixture(scope="module")
def certificate():
    return design_certificate(SYSTEM)


def failing(certificate, system=SYSTEM, written=None):
    return {c.name: c for c in prove_certificate(certificate, system, written).conditions if not c.holds}


def own_system(c):
    """The system that a certificate's data describe, as if the check compared the file with itself."""
    o = c.observer
    return SYSTEM._replace(A=c.A, B=c.B, Qe=c.Qe, Re=c.Re, Q=c.Q, C=o.C, Q_eta=o.Q, R=o.R)


@pytest.mark.thorough("True-lmi", "False-lqr")
@pytest.mark.parametrize("method", ["lqr", "lmi"])
@pytest.mark.parametrize("observer", [True, False])
def test_valid_certificate_is_proved(method, observer):
    system = ball_system(method, observer)
    proof = prove_certificate(design_certificate(system), system)
    assert proof.holds, [c for c in proof.conditions if not c.holds]
    lines = {c.name: c for c in proof.conditions}
    assert len(lines) == len(proof.conditions)
    assert ("P_eta > 0" in lines) == ("C is that of ball and beam" in lines) == observer
    assert ("K = -R_e^-1 B'P" in lines) == (method == "lqr")
    assert lines["(14)"].how.startswith("exact")
    if method == "lqr":
        assert lines["(14)"].number == pytest.approx(0.0099, rel=1e-6)  # 0.99 of Q - Q_e


def chain_system(n: int, m: int) -> CertifiedSystem:
    """Chain of n integrators with the last m derivatives as inputs, all weights 1."""
    A, _ = integrators(n)
    B, Q = np.eye(n)[:, -m:], np.eye(n)
    states, inputs = (tuple(f"{name}{i}" for i in range(k)) for name, k in (("x", n), ("u", m)))
    return CertifiedSystem("chain", {}, "lqr", states, inputs, A, B, Q / 1.01, np.eye(m), Q, np.ones(n))


@pytest.mark.thorough("12-1", "13-4")
@pytest.mark.parametrize(("n", "m"), [(12, 1), (13, 4), (13, 5)])
def test_long_integrator_chain_is_proved(n, m):
    """Terms of the Riccati equation are 1e5 times the weight; the equation is compared with the weight."""
    system = chain_system(n, m)
    assert not failing(design_certificate(system), system)


def test_proved_margin_is_below_the_true_margin(certificate):
    """P in units of its diagonal, by an eigenvalue."""
    d = 1 / np.sqrt(np.diag(certificate.P))
    number = next(c.number for c in prove_certificate(certificate, SYSTEM).conditions if c.name == "P > 0")
    assert 0.95 < number / np.linalg.eigvalsh(certificate.P * np.outer(d, d))[0] < 1


def with_entry(M, at, value):
    changed = np.array(M, float)
    changed[at] = value
    return changed


def inside(c, **fields):
    return c._replace(observer=c.observer._replace(**fields))


def times(c, field, factor):
    return c._replace(**{field: factor * getattr(c, field)})


def observed(c, field, factor):
    return inside(c, **{field: factor * getattr(c.observer, field)})


NAMED = " is that of ball and beam"
BROKEN = {
    "system" + NAMED: lambda c: c._replace(system="ball and bean"),
    "method" + NAMED: lambda c: c._replace(method="lmi"),
    "states are those of ball and beam": lambda c: c._replace(states=("x", *c.states[1:])),
    "inputs are those of ball and beam": lambda c: c._replace(inputs=("v",)),
    "settings and point are those of ball and beam": lambda c: c._replace(about={"beam_m": 1.0 + 1e-6}),
    "A" + NAMED: lambda c: c._replace(A=with_entry(c.A, (0, 1), 1 + 1e-8)),
    "B" + NAMED: lambda c: c._replace(B=with_entry(c.B, (3, 0), 1 + 1e-8)),
    "Q_e" + NAMED: lambda c: c._replace(Qe=with_entry(c.Qe, (1, 1), 0.1 * (1 - 1e-8))),
    "R_e" + NAMED: lambda c: c._replace(Re=c.Re * (1 + 1e-8)),
    "Q" + NAMED: lambda c: c._replace(Q=with_entry(c.Q, (3, 3), c.Q[3, 3] * (1 + 1e-8))),
    "scale" + NAMED: lambda c: c._replace(scale=with_entry(c.scale, 0, 1e-20)),
    "A_eta" + NAMED: lambda c: inside(c, A=with_entry(c.observer.A, (1, 1), 1e-9)),
    "C" + NAMED: lambda c: inside(c, C=c.observer.C * (1 + 1e-8)),
    "Q_eta" + NAMED: lambda c: inside(c, Q=c.observer.Q * (1 + 1e-8)),
    "R" + NAMED: lambda c: inside(c, R=c.observer.R * (1 + 1e-8)),
    "kappa": lambda c: c,  # the system's own number is beyond its limit, below
    "kappa, as recorded": lambda c: c._replace(recorded={"kappa": 0.3 + 1e-8}),
    "no other number recorded": lambda c: c._replace(recorded=c.recorded | {"rho": 0.1}),
    "poles of A + B K, as recorded": lambda c: c._replace(poles=c.poles[[0, 0, 1, 1]]),
    "K = -R_e^-1 B'P": lambda c: c._replace(K=with_entry(c.K, (0, 0), c.K[0, 0] * (1 + 1e-7))),
    "poles of A_eta - L C, as recorded": lambda c: inside(c, poles=c.observer.poles * (1 + 1e-5)),
    "L = P_eta C'R^-1": lambda c: inside(c, L=with_entry(c.observer.L, (0, 0), c.observer.L[0, 0] * (1 + 1e-7))),
    "least weight lambda*, as recorded": lambda c: inside(c, least_weight=c.observer.least_weight * (1 + 1e-5)),
}
"""Line -> a change that it must see."""


@pytest.mark.thorough(
    "system is that of ball and beam",
    "method is that of ball and beam",
    "states are those of ball and beam",
    "inputs are those of ball and beam",
    "settings and point are those of ball and beam",
    "B is that of ball and beam",
    "Q_e is that of ball and beam",
    "R_e is that of ball and beam",
    "Q is that of ball and beam",
    "scale is that of ball and beam",
    "A_eta is that of ball and beam",
    "C is that of ball and beam",
    "Q_eta is that of ball and beam",
    "R is that of ball and beam",
    "kappa",
    "kappa, as recorded",
    "no other number recorded",
    "poles of A + B K, as recorded",
    "K = -R_e^-1 B'P",
    "poles of A_eta - L C, as recorded",
    "L = P_eta C'R^-1",
    "least weight lambda*, as recorded",
)
@pytest.mark.parametrize("line", BROKEN)
def test_each_comparison_detects_its_own_change(certificate, line):
    """Changes of 1e-8 of an entry leave every matrix definite, so that only the comparison detects them."""
    system = ball_system(kappa=1.0) if line == "kappa" else SYSTEM
    broken = failing(BROKEN[line](certificate), system)
    assert line in broken, sorted(broken)
    assert {n for n in broken if n.endswith("ball and beam")} <= {line}
    assert not {n for n in broken if n.endswith((" > 0", "Hurwitz", "observable")) or n.startswith("V falls")}
    if line != "kappa":
        assert broken[line].why


def flip_gain(c):
    return c._replace(K=-c.K)


PROVED = {
    "Q_e > 0": (lambda c: c._replace(Qe=with_entry(c.Qe, (1, 1), -0.1)), "pivot at r'"),
    "R_e > 0": (lambda c: times(c, "Re", -1), "pivot at w"),
    "P > 0": (lambda c: times(c, "P", -1), "pivot at"),
    "(14)": (lambda c: times(c, "Qe", 1.02), "pivot at"),
    "A + B K Hurwitz": (flip_gain, "pivot at"),
    "left side of (14) = Q_e - Q": (lambda c: c._replace(Q=1.000001 * c.Q), "largest deviation at"),
    "R > 0": (lambda c: observed(c, "R", -1), "pivot at 0"),
    "P_eta > 0": (lambda c: observed(c, "P", -1), "pivot at theta"),
    "A_eta - L C Hurwitz": (lambda c: observed(c, "L", -1), "pivot at"),
    "(A_eta, C) observable": (lambda c: inside(c, C=np.array([[0.0, 1.0]])), "rank 1 of 2"),
    "Riccati equation of P_eta": (lambda c: observed(c, "Q", 1.00001), "largest deviation at"),
    "(15)": (lambda c: inside(c, weight=0.98 * c.observer.least_weight), "pivot at w."),
    "V falls, gain K": (lambda c: observed(c, "weight", 1e-3), "pivot at w."),
    "V falls, gain K + R_e^-1 B'P/2": (lambda c: observed(c, "weight", 1e-3), "pivot at w."),
    "V falls, gain K - R_e^-1 B'P/2": (lambda c: observed(c, "weight", 1e-3), "pivot at w."),
}


@pytest.mark.parametrize("name", PROVED)
def test_each_condition_fails_for_a_consistently_altered_file(certificate, name):
    """The system is changed with the file, so that no comparison fails: the condition itself must, with its number."""
    change, why = PROVED[name]
    bad = change(certificate)
    broken = failing(bad, own_system(bad))
    line = next((n for n in broken if n == name or n.startswith(name + " z(")), None)
    assert line is not None, sorted(broken)
    assert why in broken[line].why
    assert np.isfinite(broken[line].number)


@pytest.mark.parametrize("robust", [0.0, 0.5, -0.5])
def test_decrease_for_each_gain_needs_its_own_weight(certificate, robust):
    """Each gain needs another weight: just below the weight of one gain, V still falls for gains that need less."""
    f, o = certificate.feedback_matrices(), certificate.observer_matrices(certificate.observer)
    needs = {name: composite.least_decrease_weight(f, o, r) for name, r in ROBUST.items()}
    values = sorted(needs.values())
    assert values[0] < 0.9 * values[1] < 0.81 * values[2]
    own = next(need for (_, r), need in zip(ROBUST.items(), needs.values(), strict=True) if r == robust)
    for factor in (0.99, 1.01):
        broken = failing(inside(certificate, weight=factor * own))
        want = {f"V falls, gain {name}" for name, need in needs.items() if need > factor * own}
        assert {n for n in broken if n.startswith("V falls")} == want


def test_poles_are_matched_one_to_one():
    """Every pole has a near one in the other list, but one is a double pole, and another is recorded twice."""
    now, recorded = np.array([-1.0, -1.0, -2.0]), np.array([-1.0, -2.0, -2.0])
    line = _poles_condition(now, recorded)
    assert not line.holds
    assert line.number == pytest.approx(1.0, rel=1e-6)  # -1 recorded as -2: off by its own size
    assert _poles_condition(now, np.array([-2.0, -1.0, -1.0])).holds


def test_indefinite_lyapunov_matrix_fails_the_proof(certificate):
    """P negative definite and A + B K unstable: the Lyapunov inequality holds all the same."""
    bad = flip_gain(certificate)._replace(A=-certificate.A, P=-certificate.P)
    broken = failing(bad, own_system(bad))
    assert "not positive definite" in broken["A + B K Hurwitz"].why


def test_singular_weight_hides_no_other_condition(certificate):
    """With a singular weight or an asymmetric matrix, every condition is still listed with its own result."""
    names = [c.name for c in prove_certificate(certificate, SYSTEM).conditions]
    singular = prove_certificate(times(certificate, "Re", 0), SYSTEM).conditions
    assert [c.name for c in singular] == names
    lines = {c.name: c for c in singular}
    assert lines["P > 0"].holds
    assert lines["A + B K Hurwitz"].holds
    assert lines["(14)"].why == "the matrix has no inverse"
    skew = failing(certificate._replace(P=certificate.P + np.triu(np.full((4, 4), 1e-9), 1)))
    assert "not symmetric: r, r' is" in skew["P > 0"].why


CHANGES = [(f, False) for f in ("A", "B", "K", "P", "Qe", "Re", "Q")]
CHANGES += [(f, True) for f in ("A", "C", "Q", "R", "P", "L")]


@pytest.mark.thorough(
    "A-False",
    "B-False",
    "K-False",
    "P-False",
    "Qe-False",
    "Q-False",
    "A-True",
    "C-True",
    "Q-True",
    "R-True",
    "P-True",
    "L-True",
)
@pytest.mark.parametrize(("field", "inner"), CHANGES)
def test_every_changed_matrix_entry_fails_the_proof(certificate, field, inner):
    """Each nonzero entry in turn by 1 %, each zero one by 1 % of the largest, also with the system changed alike."""
    whole = getattr(certificate.observer if inner else certificate, field)
    for i, j in np.ndindex(whole.shape):
        changed = whole.copy()
        changed[i, j] += 0.01 * (changed[i, j] or np.abs(whole).max())
        bad = inside(certificate, **{field: changed}) if inner else certificate._replace(**{field: changed})
        assert failing(bad), (field, i, j)
        if (field, inner) != ("A", False):  # A_eta is then another block: that is what is seen
            broken = failing(bad, own_system(bad))
            assert any(np.isfinite(c.number) and c.number for c in broken.values()), (field, i, j)


def test_observer_output_matrix_must_match_the_plant(certificate):
    """C and L with the sign turned make the same A - L C, P and Riccati equation; the system's C does not turn."""
    o = certificate.observer
    assert set(failing(inside(certificate, C=-o.C, L=-o.L))) == {"C" + NAMED}
    system = ball_system(observer=False)
    assert "estimated states are those of ball and beam" in failing(certificate, system)
    without = failing(design_certificate(system))
    assert without["C" + NAMED].why == "nothing, must be shape (1, 2)"
    assert "estimated states are those of ball and beam" in without


def test_missing_recorded_number_fails(certificate):
    assert set(failing(certificate._replace(recorded={}))) == {"kappa, as recorded"}


def test_wrong_digest_fails(certificate):
    assert not failing(certificate, written=certificate_digest(certificate))
    assert set(failing(certificate, written="0" * 64)) == {"file unchanged since it was written"}


def test_extreme_numbers_fail_and_do_not_raise(certificate):
    o = certificate.observer
    assert failing(inside(certificate, Q=-o.Q))
    for big in (1e49, 1e-49, 1e160, 1e308, 1e-308):
        assert failing(certificate._replace(K=with_entry(certificate.K, (0, 0), big)))
        assert failing(certificate._replace(Qe=big * np.eye(4)))
        assert failing(inside(certificate, R=np.array([[big]])))


def test_each_pole_is_compared_relative_to_its_size():
    """A slow pole beside a fast one counts as much as the fast one."""
    poles = np.array([-0.03, -0.05 + 1j, -0.05 - 1j, -5e5])
    assert _poles_condition(poles, poles).holds
    for i, wrong in ((0, 0.3), (0, -0.0300001), (1, -0.05001 + 1j), (3, -5.00001e5)):
        recorded = poles.copy()
        recorded[i] = wrong
        assert not _poles_condition(poles, recorded).holds


@pytest.mark.parametrize("version", ["99.0", "0.0", "0.1.0rc1"])
def test_certificate_of_another_version_is_not_proved(certificate, version):
    other = certificate._replace(version=version)
    assert list(failing(other, written=certificate_digest(other))) == ["version is that of this package"]
