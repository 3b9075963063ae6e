"""References in space: each derivative is that of the one before."""

import itertools

import jax
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.reference import Circle, FigureEight
from trimtab.core.spatial_reference import FixedPlace, Helix, LevelPath

REFERENCES = {
    "place": FixedPlace((1.0, 2.0, -3.0), heading=0.4),
    "helix": Helix(origin=(0.0, 0.0, -3.0)),
    "circle": LevelPath(Circle(period=5.0, ease=3.0), height=3.0),
    "eight": LevelPath(FigureEight(period=8.0, ease=3.0), height=2.0),
}
ORDER = ("place", "velocity", "acceleration", "jerk", "snap")
TURNS = ("heading", "heading_rate", "heading_acceleration")


@pytest.mark.thorough(
    "place-place", "place-helix", "place-circle", "place-eight", "heading-helix", "heading-circle", "heading-eight"
)
@pytest.mark.parametrize("reference", REFERENCES.values(), ids=REFERENCES)
@pytest.mark.parametrize("names", [ORDER, TURNS], ids=["place", "heading"])
def test_derivatives_of_spatial_references_are_consistent(reference, names):
    for t in (0.3, 1.7, 2.9, 4.4, 7.1):
        point, rate = jax.jvp(reference.at, (t,), (1.0,))
        for name, next_name in itertools.pairwise(names):
            np.testing.assert_allclose(getattr(rate, name), getattr(point, next_name), atol=1e-9, err_msg=f"{name} {t}")


def test_helix_matches_the_publication():
    """x_d = (0.4 t, 0.4 sin πt, 0.6 cos πt), b_1d = (cos πt, sin πt, 0)."""
    for t in (0.0, 0.3, 1.9):
        point = Helix().at(t)
        np.testing.assert_allclose(point.place, [0.4 * t, 0.4 * np.sin(np.pi * t), 0.6 * np.cos(np.pi * t)], atol=1e-12)
        assert point.heading == pytest.approx(np.pi * t)


def test_level_path_keeps_height_and_heading():
    turned = replace(REFERENCES["circle"], heading=0.7)
    for t in (1.0, 4.0):
        assert turned.at(t).place[2] == -3.0
        assert turned.at(t).heading == 0.7
        np.testing.assert_array_equal(turned.at(t).place[:2], turned.path.at(t).place)
