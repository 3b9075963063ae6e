"""Parameters that can be fitted, and invalid paths."""

import math

import pytest

from trimtab.core.errors import InputError
from trimtab.run.fit_parameters import DELAY, FitParameter, find_parameters, find_scale
from trimtab.scenarios.build import build

NAME = "hovercraft/spin"


def test_rejects_a_parameter_that_is_given_twice() -> None:
    for twice in (DELAY, "world.vehicle.mass"):
        with pytest.raises(InputError, match=f"paths {twice}: is given twice"):
            find_parameters(build(NAME), [twice, "world.vehicle.inertia", twice])


def test_rejects_non_numeric_parameter_paths() -> None:
    with pytest.raises(
        InputError, match=r"paths world.vehicle.mas: is not a numeric parameter[\s\S]*world.vehicle.mass"
    ):
        find_parameters(build(NAME), ["world.vehicle.mas"])


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("world.vehicle.mass[0]", "is one number, so its path must not have an index"),
        ("world.actuators.table.values[0,0]", "this table is computed from the parameters of the thruster"),
        ("world.actuators.rudder.angles[99]", "has shape (21,), so the index of one of its elements is needed"),
    ],
)
def test_rejects_wrong_indices_and_computed_tables(path: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        find_parameters(build(NAME), [path])
    assert said in str(refused.value)


def test_parameters_have_bounds_and_search_scales() -> None:
    _, (mass, delay) = find_parameters(build(NAME), ["world.vehicle.mass", DELAY])
    assert mass == FitParameter("world.vehicle.mass", "kg", 2.6, 1e-6, math.inf)
    assert (find_scale(mass), find_scale(delay)) == (0.1 * 2.6, 0.01)
    assert (delay.low, delay.high) == (-0.5, 0.5)
