import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.rotation import from_euler, wrap
from trimtab.environment.magnetic import COLLEGE_PARK, magnetic_heading, strength_ratio

FIELD = np.array(COLLEGE_PARK)
HEADINGS = np.concatenate([np.linspace(-np.pi, np.pi, 41), [1e-9, np.pi - 1e-9, -1e-12]])


@jax.jit
def found(roll, pitch, headings):
    """Return the headings that are found in readings of the field."""

    def one(psi):
        return magnetic_heading(from_euler(roll, pitch, psi).T @ FIELD, FIELD, roll, pitch)

    return jax.vmap(one)(headings)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, -0.3), (-0.5, 0.7)])
def test_recovers_the_heading_at_every_angle(roll, pitch):
    """Also a hair from 0 and pi, where the source's arc cosine is 1e-8 off at best."""

    got = np.asarray(found(roll, pitch, jnp.asarray(HEADINGS)))
    np.testing.assert_allclose(np.asarray(wrap(got - HEADINGS)), 0, atol=1e-14)


def test_arc_cosine_heading_loses_precision():
    """Reason for using atan2 instead of acos."""
    psi = 1e-9
    b = np.asarray(from_euler(0.0, 0.0, psi).T @ FIELD)[:2]
    w = FIELD[:2]
    by_acos = np.arccos(np.clip(b @ w / np.linalg.norm(b) / np.linalg.norm(w), -1, 1))
    assert abs(by_acos - psi) > 1e-10
    assert abs(float(magnetic_heading(np.append(b, 0.0), FIELD)) - psi) < 1e-15


def test_heading_refers_to_true_north():
    """Nose along the horizontal field: the heading is the declination."""
    level = np.hypot(*FIELD[:2])
    got = float(magnetic_heading(jnp.array([level, 0.0, FIELD[2]]), FIELD))
    assert got == pytest.approx(np.arctan2(FIELD[1], FIELD[0]), abs=1e-15)


def test_strength_ratio_of_full_and_zero_field():
    assert float(strength_ratio(from_euler(0.1, 0.2, 0.3).T @ FIELD, FIELD)) == pytest.approx(1)
    assert float(strength_ratio(jnp.zeros(3), FIELD)) == 0
    assert float(magnetic_heading(jnp.zeros(3), FIELD)) == 0


def test_magnetic_heading_lowers_to_generated_c():
    lower_function(lambda b, w, r, p: (magnetic_heading(b, w, r, p), strength_ratio(b, w)), (FIELD, FIELD, 0.1, 0.1))
