"""Records: declared fields, pytree round trip, paths, declared dtypes, and refusal of what is not declared."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import DTYPES
from trimtab.core.record import (
    Option,
    Part,
    Quantity,
    Scalar,
    absent_parts,
    declarations,
    leaves,
    option,
    part,
    period,
    quantity,
    record,
    replace,
    to_arrays,
    with_leaf,
    with_part_of,
)
from trimtab.vehicles.hovercraft import Hovercraft


@record
class Gains:
    """Two gains. Source: this test."""

    k1: Scalar = quantity("kg/s", "First.", default=1.0, above=0)
    k2: Scalar = quantity("kg/s", "Second.", default=2.0)


@record
class Block:
    """Every kind of field. Source: this test."""

    x: Any = quantity("m", "A vector.", frame="W", default=np.zeros(3), shape=(3,))
    angle: Scalar = quantity("rad", "An angle.", kind="angle", default=0.5)
    t: Scalar = quantity("100 ns", "A time.", kind="time", default=7)
    n: Scalar = quantity("1", "A count.", kind="count", default=3)
    mode: Scalar = quantity("1", "A mode.", kind="mode", modes=("off", "on"), default=1)
    word: Scalar = quantity("1", "A word.", kind="word", default=2**32 - 1)
    flag: Scalar = quantity("1", "A flag.", kind="flag", default=True)
    gains: Gains = part("Nested.", default=Gains())
    several: Any = part("A mapping.", default={"a": Gains(3.0, 4.0), "b": Gains()})
    pair: Any = part("A tuple.", default=(Gains(5.0, 6.0), Gains()))
    nothing: Any = part("Left out.", default=None)
    form: str = option("A choice.", default="literal", choices=("literal", "sharp"))
    every: int = period("A period.", default=10_000, low=5)


PATHS = [
    "x",
    "angle",
    "t",
    "n",
    "mode",
    "word",
    "flag",
    "gains.k1",
    "gains.k2",
    "several.a.k1",
    "several.a.k2",
    "several.b.k1",
    "several.b.k2",
    "pair.0.k1",
    "pair.0.k2",
    "pair.1.k1",
    "pair.1.k2",
    "form",
    "every",
]


def test_declarations_keep_all_declared_properties():
    declared = declarations(Block)
    assert declared["x"] == Quantity("m", "A vector.", frame="W", shape=(3,))
    assert declared["mode"] == Quantity("1", "A mode.", kind="mode", modes=("off", "on"))
    assert declared["gains"] == Part("Nested.")
    assert declared["form"] == Option("A choice.", choices=("literal", "sharp"))
    assert declared["every"] == Option("A period.", kind="period", low=5)
    assert declarations(Gains())["k1"] == Quantity("kg/s", "First.", above=0)


def test_records_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Gains().k1 = 3.0  # pyright: ignore[reportAttributeAccessIssue]


def test_rejects_field_without_declaration():
    with pytest.raises(InputError, match=r"record Bad: 'k1' has no declaration"):

        @record
        class Bad:
            """Source: this test."""

            k1: float = 1.0


def test_rejects_missing_value_by_name():
    @record
    class Needs:
        """Source: this test."""

        mass: Scalar = quantity("kg", "No default.")

    with pytest.raises(TypeError, match="mass"):
        Needs()  # pyright: ignore[reportCallIssue]


def test_pytree_round_trip_keeps_options_and_values():
    block = Block(form="sharp", every=20)
    flat, structure = jax.tree.flatten(block)
    again = jax.tree.unflatten(structure, flat)
    assert isinstance(again, Block)
    assert (again.form, again.every, again.nothing) == ("sharp", 20, None)
    assert [v for _, v, _ in leaves(again)] == [v for _, v, _ in leaves(block)]
    assert len(flat) == 17


def test_pytree_paths_are_the_field_names():
    paths = [jax.tree_util.keystr(p) for p, _ in jax.tree_util.tree_flatten_with_path(Block())[0]]
    assert ".gains.k1" in paths
    assert ".several['a'].k2" in paths


def test_option_change_recompiles_and_quantity_change_does_not():
    traced = []

    @jax.jit
    def area(block):
        traced.append(block.form)
        return block.gains.k1 * 2

    first = to_arrays(Block())
    assert area(first) == 2.0
    assert area(with_leaf(first, "gains.k1", lambda v, _: np.asarray(9.0))) == 18.0
    assert traced == ["literal"]
    area(replace(first, form="sharp"))
    assert traced == ["literal", "sharp"]


def test_leaves_are_dotted_paths_in_declared_order():
    assert [p for p, _, _ in leaves(Block())] == PATHS
    found = {p: (v, d) for p, v, d in leaves(Block())}
    assert found["several.a.k1"] == (3.0, declarations(Gains)["k1"])
    assert found["pair.0.k2"][0] == 6.0


@pytest.mark.parametrize("path", PATHS)
def test_with_leaf_changes_only_the_named_leaf(path):
    marker = object()
    block = Block()
    changed = with_leaf(block, path, lambda old, declared: marker)
    before, after = ({p: v for p, v, _ in leaves(b)} for b in (block, changed))
    assert after.pop(path) is marker
    before.pop(path)
    assert list(before) == list(after)
    assert all(before[p] is after[p] for p in before)
    assert type(changed.several) is dict
    assert type(changed.pair) is tuple


def test_with_leaf_passes_old_value_and_declaration():
    seen = []
    with_leaf(Block(), "pair.0.k1", lambda old, declared: seen.append((old, declared)))
    assert seen == [(5.0, declarations(Gains)["k1"])]


@pytest.mark.parametrize("path", ["nosuch", "gains", "gains.k9", "gains.k1.x", "pair.7.k1", "several.c.k1", ""])
def test_with_leaf_rejects_path_of_a_non_leaf(path):
    with pytest.raises(KeyError):
        with_leaf(Block(), path, lambda old, declared: old)


def test_to_arrays_gives_every_quantity_its_declared_dtype():
    made = to_arrays(Block())
    for path, value, declared in leaves(made):
        if isinstance(declared, Quantity):
            assert isinstance(value, np.ndarray), path
            assert value.dtype == DTYPES[declared.kind], path
    assert made.word == 2**32 - 1
    assert made.x.shape == (3,)
    assert (made.form, made.nothing, type(made.pair), type(made.several)) == ("literal", None, tuple, dict)


def test_to_arrays_is_idempotent():
    once, twice = to_arrays(Block()), to_arrays(to_arrays(Block()))
    assert jax.tree.structure(once) == jax.tree.structure(twice)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(once), jax.tree.leaves(twice), strict=True))


def test_to_arrays_converts_records_in_mappings_and_tuples():
    made = to_arrays({"a": (Gains(1, 2),)})
    assert made["a"][0].k1.dtype == np.float64
    assert to_arrays(()) == ()


def test_setting_of_an_absent_part_creates_that_part():
    craft = {"craft": Hovercraft()}
    assert [path for path, _ in absent_parts(craft)] == ["craft.friction"]
    there = with_part_of(craft, "craft.friction.torque_viscous")
    assert there["craft"].friction.torque_viscous == 0.0
    assert list(absent_parts(there)) == []
    for path in ("craft.friction", "craft.friction.drag", "craft.mass", "friction.torque_viscous"):
        assert with_part_of(craft, path) is craft
    assert with_part_of(there, "craft.friction.torque_viscous") is there


def test_records_pass_through_vmap_and_grad():
    batch = Gains(jnp.arange(3.0), jnp.ones(3))
    doubled = jax.vmap(lambda g: replace(g, k1=2 * g.k1))(batch)
    np.testing.assert_array_equal(doubled.k1, [0.0, 2.0, 4.0])
    slope = jax.grad(lambda g: g.k1**2 * g.k2)(Gains(3.0, 2.0))
    assert isinstance(slope, Gains)
    assert (float(slope.k1), float(slope.k2)) == (12.0, 9.0)


def test_replace_error_suggests_the_nearest_field():
    with pytest.raises(InputError, match="no such field") as refused:
        replace(Hovercraft(), mas=3.0)
    assert "mass" in refused.value.choices
    assert "mass=" in refused.value.fix


@pytest.mark.parametrize("value", [0.02, 10.0])
def test_rejects_period_without_unit(value):
    @record
    class Lamp:
        """Source: this test."""

        blink: int = period("Time between two blinks.", default="500 ms")

    assert Lamp("20 ms").blink == Lamp(200_000).blink
    with pytest.raises(InputError, match="not a whole number of 100 ns") as refused:
        Lamp(value)
    assert f'blink="{value} s"' in refused.value.fix


def test_assignment_error_suggests_replace():
    @record
    class Wheel:
        """A wheel. Source: this test."""

        radius: float = quantity("m", "Radius.", default=0.3)

    wheel = Wheel()
    with pytest.raises(dataclasses.FrozenInstanceError, match=r"write wheel = replace\(wheel, radius=…\)"):
        wheel.radius = 0.4  # pyright: ignore[reportAttributeAccessIssue]
    assert wheel.radius == 0.3


def test_rejects_field_without_annotation():
    with pytest.raises(InputError, match="record Spoke: 'length' is a field but has no type annotation") as refused:

        @record
        class Spoke:
            """A spoke. Source: this test."""

            length = quantity("m", "Length.", default=0.3)

    assert "name: float = quantity" in refused.value.fix
