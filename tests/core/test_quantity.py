"""Declarations are refused where they are wrong, and read from records, mappings and tuples, without JAX."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import (
    DTYPES,
    KINDS,
    Option,
    Quantity,
    Scalar,
    children,
    declarations,
    is_record,
    leaves,
    option,
    period,
    quantity,
)
from trimtab.core.record import record


@record
class Gains:
    """Two gains. Source: this test."""

    k1: Scalar = quantity("kg/s", "First.", default=1.0, above=0)
    k2: Scalar = quantity("kg/s", "Second.", default=2.0)


def test_rejects_unknown_kind():
    with pytest.raises(TypeError, match="'length' is not one of"):
        quantity("m", "A length.", kind="length")


@pytest.mark.parametrize("kind", KINDS)
def test_kind_determines_the_dtype(kind):
    assert Quantity("1", "Something.", kind=kind).dtype() is DTYPES[kind]


def test_declarations_of_options_and_periods():
    @record
    class Choices:
        """Source: this test."""

        form: str = option("A form.", default="flat", choices=("flat", "round"))
        every: int = period("A period.", default=7, low=5)

    assert declarations(Choices) == {
        "form": Option("A form.", choices=("flat", "round")),
        "every": Option("A period.", kind="period", low=5),
    }


def test_accepts_array_as_default():
    start = np.zeros(3)

    @record
    class Vector:
        """Source: this test."""

        x: Scalar = quantity("m", "A vector.", default=start, shape=(3,))

    assert Vector().x is start


def test_is_record_accepts_only_record_instances():
    @dataclasses.dataclass
    class Plain:
        x: float = 1.0

    assert is_record(Gains())
    assert not any(is_record(v) for v in (Plain(), 1.0, None, {"a": Gains()}, Gains))


def test_children_lists_one_level_only():
    assert [n for n, _, _ in children(Gains())] == ["k1", "k2"]
    assert children({"a": 1}) == [("a", 1, None)]
    assert children((4, 5)) == [("0", 4, None), ("1", 5, None)]
    assert children(1.0) == []


def test_leaves_are_listed_below_a_path():
    assert [p for p, _, _ in leaves(Gains(), "law")] == ["law.k1", "law.k2"]
    assert list(leaves(3.0)) == []


@pytest.mark.parametrize(
    ("unit", "wrong", "problem"),
    [
        (1, {}, "the unit must be a text, got 1"),
        ("", {}, "the unit must be a text, got ''"),
        ("kg", {"above": "0"}, "above must be a number in kg, got '0'"),
        ("kg", {"low": 1, "high": 0}, "low must not be above high, got low=1 and high=0"),
        ("kg", {"shape": 3}, "shape must be a tuple, got 3"),
    ],
)
def test_rejects_invalid_declarations(unit, wrong, problem):
    with pytest.raises(InputError) as refused:
        quantity(unit, "Mass.", **wrong)
    assert refused.value.problem == problem
    assert refused.value.fix


def test_importing_declarations_does_not_import_jax():
    text = "import sys, trimtab.core.quantity\nprint('jax' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", text], text=True) == "False\n"
