"""Typed random keys as arguments and results of compiled functions, and trees of classes registered with JAX."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler.arguments import Arguments
from trimtab.core.errors import InputError
from trimtab.export.verify import verify_folder

KEY = jax.random.key(3)
IMPLEMENTATIONS = ("threefry2x32", "rbg", "unsafe_rbg")


def drawn(key: Any, x: Any) -> dict[str, Any]:
    """Return the next key, and draws from the present one."""
    following, mine = jax.random.split(key)
    return {"key": following, "x": x + jax.random.uniform(mine, (3,), dtype=jnp.float64)}


def same_key(a: Any, b: Any) -> bool:
    return a.dtype == b.dtype and np.array_equal(jax.random.key_data(a), jax.random.key_data(b))


def test_key_goes_in_and_comes_out() -> None:
    compiled = trimtab.compile(drawn, KEY, 0.5)
    with jax.enable_x64(True):
        expected = jax.jit(drawn)(KEY, 2.5)
    for given in (KEY, np.asarray(jax.random.key_data(KEY))):  # the words of a key are accepted, too
        found = compiled(given, 2.5)
        assert same_key(found["key"], expected["key"])
        assert np.array_equal(found["x"], expected["x"])
    assert same_key(compiled(compiled(KEY, 0.0)["key"], 0.0)["key"], drawn(drawn(KEY, 0.0)["key"], 0.0)["key"])


def test_keys_of_many_runs_have_an_axis_of_runs() -> None:
    compiled, x = trimtab.compile(drawn, KEY, 0.5), np.arange(11.0)
    keys = jax.random.split(KEY, 11)
    found, shared = compiled.lanes(keys, x), compiled.lanes(KEY, x)
    for k in range(11):
        for many, key in ((found, keys[k]), (shared, KEY)):
            alone = compiled(key, x[k])
            assert same_key(many["key"][k], alone["key"])
            assert np.array_equal(many["x"][k], alone["x"])


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_array_of_keys_is_one_argument(implementation: str) -> None:
    keys = jax.random.split(jax.random.key(1, impl=implementation), (3, 4))
    compiled = trimtab.compile(lambda k: k[1, ::-1], jax.ShapeDtypeStruct(keys.shape, keys.dtype))
    assert same_key(compiled(keys), keys[1, ::-1])


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (jax.random.key(1, impl="rbg"), "key is a random key of type key<rbg>, the example has key<fry>"),
        (jax.random.split(KEY, 5), r"key has shape \(5, 2\)"),
        (1.0, r"key has shape \(\)"),
        (np.zeros(2), "key has type float64, the example has uint32"),
    ],
)
def test_rejects_another_kind_of_key(given: Any, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        trimtab.compile(drawn, KEY, 0.5)(given, 0.5)


def test_key_in_place_of_a_number_is_rejected() -> None:
    with pytest.raises(InputError, match="x is a random key of type key<fry>, the example has float64"):
        trimtab.compile(drawn, KEY, 0.5)(KEY, KEY)


@pytest.mark.thorough
def test_exported_function_takes_the_words_of_a_key(tmp_path: Path) -> None:
    trimtab.compile(drawn, KEY, 0.5).export(tmp_path)
    assert "uint32_t key[2]" in (tmp_path / "drawn.h").read_text()
    assert verify_folder(tmp_path).good


@jax.tree_util.register_dataclass
@dataclass
class Craft:
    """State of another library: a class that only JAX knows."""

    place: Any
    speed: Any


@pytest.mark.parametrize("example", [(KEY, 0.5), (Craft(np.zeros(3), 1.0), 0.5)], ids=["key", "class"])
def test_keys_and_registered_classes_are_checked_without_python_code(
    example: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("_normalise", "_normalise_runs"):
        monkeypatch.setattr(Arguments, name, None)
    compiled = trimtab.compile(lambda x, y: (x, y * 2), *example)
    assert compiled(*example)[1] == 1.0
    assert compiled.lanes(example[0], np.arange(3.0))[1].tolist() == [0.0, 2.0, 4.0]


def test_accepts_classes_registered_with_jax() -> None:
    def step(craft: Craft, dt: Any) -> Craft:
        return Craft(craft.place + dt * craft.speed, craft.speed * 2)

    compiled = trimtab.compile(step, Craft(np.zeros(3), 1.0), 0.1)
    found = compiled(Craft(jnp.arange(3.0), 2), 0.5)  # float32 and int, for float64
    assert isinstance(found, Craft)
    assert found.place.tolist() == [1.0, 2.0, 3.0]
    assert found.speed == 4.0
    many = compiled.lanes(Craft(np.zeros((5, 3)), np.arange(5.0)), 0.5)
    assert many.place[:, 2].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    with pytest.raises(InputError, match=r"craft.place has shape \(2,\), the example has \(3,\)"):
        compiled(Craft(np.zeros(2), 1.0), 0.1)
    with pytest.raises(InputError, match="the arguments have the structure"):
        compiled((np.zeros(3), 1.0), 0.1)
    with pytest.raises(InputError, match="needs 2 arguments"):
        compiled(Craft(np.zeros(3), 1.0))
