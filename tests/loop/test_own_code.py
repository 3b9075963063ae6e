"""Slips in somebody's own law or vehicle are said with file and line, and with what to write instead."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record
from trimtab.loop.own_code import describe_fault
from trimtab.loop.structure import check_members, zeros_of, zeros_of_step


@record
class Point:
    """A point. Source: none."""

    north: float = quantity("m", "North.", default=0.0)


def branch(x):
    if x.north > 1:
        return 1.0
    return x.north


SLIPS = {
    "if": (branch, "`if` on a traced value", "jnp.where"),
    "and": (lambda x: (x.north > 1) and (x.north < 2), "`and` on a traced value", "&"),
    "math": (lambda x: math.sin(x.north), "`math.sin` of a traced value", "jnp.sin"),
    "numpy": (lambda x: np.cos(x.north), "`np.cos` of a traced value", "jnp.cos"),
    "float": (lambda x: float(x.north), "`float()` of a traced value", "leave float() out"),
    "range": (lambda x: [0 for _ in range(jnp.asarray(x.north, int))], "`range()` of a traced value", "fixed number"),
    "misspelt": (lambda x: x.nort, "'Point' object has no attribute 'nort'", "write 'north' instead"),
    "shape": (lambda x: jnp.stack([x.north, jnp.zeros(2)]), "", "give law an input"),
    "another name": (lambda x: nothing, "NameError: name 'nothing' is not defined", ""),  # noqa: F821
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_is_said_with_its_line_and_what_to_write(slip):
    function, problem, fix = SLIPS[slip]
    with pytest.raises(InputError) as refused:
        zeros_of("law", "the state", function, Point(1.0))
    line = function.__code__.co_firstlineno + (function is branch)
    assert f"test_own_code.py:{line}: {problem}" in refused.value.problem
    assert fix in refused.value.fix


def test_what_gives_no_pair_is_refused():
    with pytest.raises(
        InputError, match="its step\\(\\) must return \\(state, output\\), got a Point as declared"
    ) as refused:
        zeros_of_step("law", "the state", lambda x: x, Point(1.0))
    assert "(state, output)" in refused.value.fix


class Wanted:
    """An interface."""

    reads: tuple[str, ...]

    def step(self, t, state): ...


def test_what_a_part_lacks_is_said_with_what_to_write():
    with pytest.raises(InputError, match=r"Point has no step\(\)[\s\S]*def step\(self, t, state\): …  in Point"):
        check_members("law", Point(1.0), Wanted)
    with pytest.raises(InputError, match=r"Point has no 'reads'"):
        check_members("law", Point(1.0), Wanted, ("step",))
    check_members("law", Point(1.0), Wanted, ("step", "reads"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def scenario(:\n", "own.py:1:14: invalid syntax"),
        ("\nimport nothing_of_that_name\n", "own.py:2: No module named 'nothing_of_that_name'"),
        ("def scenario():\n    return nothing\n", "own.py:2: NameError: name 'nothing' is not defined"),
        ("def scenario():\n    return 1 / 0\n", "own.py:2: ZeroDivisionError"),
    ],
)
def test_a_file_that_does_not_run_is_refused_with_its_line(tmp_path, text, said):
    from trimtab.scenarios.build import build

    (tmp_path / "own.py").write_text(text)
    with pytest.raises(InputError) as refused:
        build(f"{tmp_path / 'own.py'}:scenario")
    assert said in refused.value.problem
    assert refused.value.fix


def test_an_error_of_nobody_has_no_line():
    assert describe_fault(ValueError("odd")).place == ""
    assert jax.errors.ConcretizationTypeError in describe_fault.__globals__["CONVERSIONS"]
