"""Theorems of systems outside the package: proved, not proved, and from a user's file on the command line."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import PlanarForce
from trimtab.design.polynomial import constant, symbol
from trimtab.design.squares import Region
from trimtab.design.theorem import LawTheorem, closed_loop, hurwitz_minors, prove_theorem
from trimtab.design.theorem_file import design_theorem, parse_theorem, theorem_digest, theorem_json
from trimtab.laws.velocity import ZeroVelocity
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

x, y, a, b = (symbol(n) for n in "xyab")
REST = Region(("x", "y"), ("a", "b"), {"x": constant(0), "y": constant(0)})
PENDULUM = LawTheorem("pendulum", {}, "it rests", REST, {"x": y, "y": -a * x - b * y}, (a * x**2 + y**2) / 2)


def fails(theorem):
    certificate, written = parse_theorem(theorem_json(design_theorem(theorem)), "file")
    proof = prove_theorem(certificate, theorem, (written, theorem_digest(certificate)))
    assert proof.holds == (not any(not c.holds for c in proof.conditions))
    return {c.name for c in proof.conditions if not c.holds}


def test_pendulum_with_friction_is_proved():
    assert fails(PENDULUM) == set()


def test_pendulum_without_friction_is_not_proved():
    free = PENDULUM._replace(field={"x": y, "y": -a * x})
    assert fails(free) == {"largest invariant set in dV/dt = 0"}


def test_pendulum_with_negative_friction_or_spring_fails():
    assert "-dV/dt >= 0" in fails(PENDULUM._replace(field={"x": y, "y": -a * x + b * y}))
    assert "V > 0" in fails(PENDULUM._replace(field={"x": y, "y": a * x - b * y}, lyapunov=(y**2 - a * x**2) / 2))


def test_wrong_equilibrium_fails():
    there = REST._replace(rest={"x": a, "y": constant(0)})
    assert "the law's point of rest is an equilibrium" in fails(PENDULUM._replace(region=there))


def test_lyapunov_function_must_be_that_of_the_law():
    """A proof with another V does not prove what the law logs."""
    certificate, doubled = design_theorem(PENDULUM), PENDULUM._replace(lyapunov=2 * PENDULUM.lyapunov)
    proof = prove_theorem(certificate, doubled)
    assert {c.name for c in proof.conditions if not c.holds} == {"V is that of the law"}


def test_false_identity_fails():
    assert fails(PENDULUM._replace(identities={"a is b": a - b})) == {"a is b"}


def test_hurwitz_minors_agree_with_eigenvalues():
    draws = np.random.default_rng(1)
    names = ("x", "y", "z")
    for n in (1, 2, 3):
        for _ in range(60):
            J = draws.normal(size=(n, n)) - 0.8 * np.eye(n)
            field = {
                names[i]: sum((float(J[i, j]) * symbol(names[j]) for j in range(n)), constant(0)) for i in range(n)
            }
            rest = dict.fromkeys(names[:n], constant(0))
            positive = all(p.sign(()) == 1 for p in hurwitz_minors(field, rest))
            assert positive == bool(np.linalg.eigvals(J).real.max() < 0)


@record
class Saturated:
    """Not a polynomial. Source: this test."""

    k1: Scalar = quantity("kg/s", "Gain.", default=1.0)

    def step(self, t, state, estimate):
        """Clipped."""
        return (), Output(PlanarForce(-jnp.clip(self.k1 * estimate.state.surge_velocity, -1, 1), 0.0))


@record
class Output:
    """A demand. Source: this test."""

    demand: PlanarForce = part("Force.")


def test_rejects_law_with_non_polynomial_code():
    with pytest.raises(InputError, match="Saturated: its code is not a polynomial"):
        closed_loop(Hovercraft(), Saturated(), HovercraftState(), {"surge_velocity": "u"})


def test_closed_loop_polynomials_match_code_values():
    law = ZeroVelocity()
    names = {"surge_velocity": "u", "sway_velocity": "v", "yaw_rate": "r"}
    field, V = closed_loop(law.model, law, HovercraftState(), names)
    draws = np.random.default_rng(2)
    for _ in range(20):
        z = draws.normal(size=3)
        s = HovercraftState(*z)
        rate = law.model.dynamics(0.0, s, PlanarForce(-law.k1 * z[0], -law.k2 * (z[1] - law.model.arm * z[2])))
        at = dict(zip("uvr", map(constant, z.tolist()), strict=True))
        got = [float(p.substitute(at).terms.get((), 0)) for p in (*field.values(), V)]
        wanted = [rate.surge_velocity, rate.sway_velocity, rate.yaw_rate, law.lyapunov(s)]
        np.testing.assert_allclose(got, np.array(wanted, float), rtol=1e-12, atol=1e-14)


OWN = """
from trimtab.design.polynomial import constant, symbol
from trimtab.design.squares import Region
from trimtab.design.theorem import LawTheorem

def theorem(*, friction: float = 0.5):
    x, y = symbol("x"), symbol("y")
    rest = {"x": constant(0), "y": constant(0)}
    field = {"x": y, "y": -x - x**3 - constant(friction) * y}
    V = y**2 / 2 + x**2 / 2 + x**4 / 4
    return LawTheorem("spring", {"friction": friction}, "it rests", Region(("x", "y"), (), rest), field, SUCH)

def something():
    return 3
"""


def call(*words):
    return CliRunner().invoke(main, ["design", *map(str, words)])


@pytest.mark.thorough
def test_user_written_law_is_proved_and_rechecked(tmp_path):
    """Without a V in the code: a region is found, written, and proved again with the file beside it."""
    own, out = tmp_path / "my_law.py", tmp_path / "law.json"
    own.write_text(OWN.replace("SUCH", "None"), encoding="utf-8")
    done = call(f"{own}:theorem", "--set", "friction=1", "--out", out)
    assert done.exit_code == 0, done.output
    assert ": proved" in done.output
    assert json.loads(out.read_text())["about"] == {"friction": 1.0}
    again = call(f"{own}:theorem", "--check", out, "--json")
    assert again.exit_code == 0, again.output
    plain = json.loads(again.stdout)
    assert plain["holds"]
    assert plain["level"] > 0
    lost = call("--check", out)
    assert lost.exit_code == 2
    assert "my_law.py:theorem" in lost.output
    own.write_text(OWN.replace("SUCH", "None").replace("- x**3", "- 2*x**3"), encoding="utf-8")
    assert call(f"{own}:theorem", "--check", out).exit_code == 1


def test_fourth_degree_lyapunov_function_is_not_proved(tmp_path):
    """Completing squares reaches the second degree: the line says that there is no proof, and nothing is written."""
    own, out = tmp_path / "my_law.py", tmp_path / "law.json"
    own.write_text(OWN.replace("SUCH", "V"), encoding="utf-8")
    done = call(f"{own}:theorem", "--out", out)
    assert done.exit_code == 1
    assert "FAILS  V > 0: the file has no proof of this claim" in done.output
    assert f"not written: {out}" in done.output
    assert not out.exists()


def test_command_line_errors_suggest_the_fix(tmp_path):
    own = tmp_path / "my_law.py"
    own.write_text(OWN, encoding="utf-8")
    assert "not a LawTheorem" in call(f"{own}:something").output
    assert "trimtab design hovercraft/forward" in call("hovercraft/foward").output
    assert "leave --method out" in call("hovercraft/forward", "--method", "lqr").output
    assert "remove it" in call("hovercraft/forward", "--set", "k1=2").output
    assert "not stable" in call("hovercraft/reverse", "--set", "theta=0.3").output
