"""Unusual arguments of compiled functions: computed as JAX does, or rejected with InputError; Python never crashes."""

import gc
import os
import threading
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.core.errors import InputError

X = np.arange(12.0).reshape(3, 4)
REST = {"a": 1.0, "n": np.int32(3)}


def function(x, rest):
    return {"y": x * 2 + rest["a"], "n": rest["n"] + 1}


@pytest.fixture(scope="module")
def compiled():
    return trimtab.compile(function, X, REST)


class Raises:
    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("not today")


class Lies:
    def __array__(self, *_: Any, **__: Any) -> Any:
        return "no array"


class Own(np.ndarray):
    pass


def unaligned():
    return np.frombuffer(bytearray(12 * 8 + 1), np.float64, count=12, offset=1).reshape(3, 4)


def read_only():
    array = X.copy()
    array.flags.writeable = False
    return array


def deleted():
    array = jnp.ones((3, 4))
    array.delete()
    return array


SAME = {
    "by columns": lambda: np.asfortranarray(X),
    "transposed": lambda: np.ascontiguousarray(X.T).T,
    "other order of bytes": lambda: X.astype(">f8"),
    "read only": read_only,
    "reversed twice": lambda: X[::-1, ::-1].copy()[::-1, ::-1],
    "subclass": lambda: X.view(Own),
    "of jax": lambda: jnp.asarray(X),
    "buffer": lambda: memoryview(X),
    "integers": lambda: X.astype(np.int32),
    "float32": lambda: X.astype(np.float32),
    "lists": lambda: X.tolist(),
}
NOTHING = {
    "unaligned": unaligned,
    "broadcast": lambda: np.broadcast_to(0.0, (3, 4)),
}
REFUSED = {
    "raises": Raises,
    "lies": Lies,
    "deleted": deleted,
    "masked": lambda: np.ma.masked_greater(X, 3),
    "objects": lambda: X.astype(object),
    "text": lambda: "abc",
    "texts": lambda: X.astype(str),
    "none": lambda: None,
    "structured": lambda: np.zeros((3, 4), [("a", float)]),
    "huge": lambda: 10**400,
    "complex": lambda: X + 1j,
    "long": lambda: X.astype(np.longdouble) if np.longdouble is not np.float64 else None,
    "times": lambda: X.astype("datetime64[s]"),
    "keys": lambda: jax.random.split(jax.random.key(0), (3, 4)),
    "other shape": lambda: X.T,
    "empty": lambda: np.zeros((0, 4)),
    "axes": lambda: np.ones((1, 1, 1, 3, 4)),
    "set": lambda: {1, 2},
    "type": lambda: float,
    "ragged": lambda: [[1, 2], [3]],
    "function": lambda: function,
}


FINE_AS_EXAMPLES = ("other shape", "empty", "axes", "deleted", "none", "ragged")
"""Arrays of other shapes, trees without numbers, and trees of lists that JAX joins or not."""


@pytest.mark.parametrize("name", SAME)
def test_arrays_of_every_layout_give_the_same_result(compiled, name):
    if name == "lists":
        with pytest.raises(InputError):  # a list is a tree of its numbers
            compiled(SAME[name](), REST)
        return
    assert np.array_equal(compiled(SAME[name](), REST)["y"], X * 2 + 1)


@pytest.mark.parametrize("name", NOTHING)
def test_accepts_arrays_of_unusual_memory(compiled, name):
    assert np.array_equal(compiled(NOTHING[name](), REST)["y"], np.ones((3, 4)))


@pytest.mark.parametrize("name", REFUSED)
def test_rejects_invalid_arrays_in_every_argument(compiled, name):
    for place in (
        lambda v: (v, REST),
        lambda v: (X, v),
        lambda v: (X, {**REST, "a": v}),
        lambda v: (X, {**REST, "n": v}),
    ):
        with pytest.raises(InputError):
            compiled(*place(REFUSED[name]()))
        with pytest.raises(InputError):
            compiled.lanes(*place(REFUSED[name]()))


@pytest.mark.parametrize(
    "arguments",
    [(), (X,), (X, REST, 1), (X, []), ([X], REST), (X, {"a": 1.0}), (X, {**REST, "z": 2}), (X, {1: 2, "a": 3})],
)
def test_rejects_other_tree_structures(compiled, arguments):
    with pytest.raises(InputError):
        compiled(*arguments)
    with pytest.raises(InputError):
        compiled.lanes(*arguments)


@pytest.mark.parametrize(
    "name", [n for n in REFUSED if n not in ("keys", "other shape", "empty", "axes", "deleted", "none", "ragged")]
)
def test_rejects_example_that_is_not_an_array(name):
    example = REFUSED[name]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(InputError):
            trimtab.compile(lambda x: jnp.asarray(x) + 1, example)


@pytest.mark.parametrize("shape", [(2**31,), (2**16, 2**16), (2**33,), (2**31 - 1,)])
def test_rejects_arrays_beyond_32_bit_indices(shape):
    huge = jax.ShapeDtypeStruct(shape, np.float32)
    for f in (lambda x: x + 1, lambda x: x.sum(), lambda x: x.ravel()[0]):
        with pytest.raises(InputError, match="32 bits"):
            trimtab.compile(f, huge)
    with pytest.raises(InputError, match="32 bits"):
        trimtab.compile(lambda x: jnp.sin(x + jnp.arange(2**33)).sum(), 1.0)


@pytest.mark.parametrize("f", [5, None, "sin", np.sin, lambda x: np.sin(x), lambda x: x if x.sum() > 0 else -x])
def test_rejects_functions_jax_cannot_trace(f):
    with pytest.raises(InputError):
        trimtab.compile(f, np.ones(3))


def test_lanes_accept_zero_and_one_run():
    compiled = trimtab.compile(lambda x: x + 1, np.ones(3), threads=4)
    assert compiled.lanes(np.ones((0, 3))).shape == (0, 3)
    assert np.array_equal(compiled.lanes(np.ones((1, 3))), np.full((1, 3), 2.0))


def test_rejects_calls_inside_a_jax_trace():
    compiled = trimtab.compile(lambda x: x + 1, np.ones(3))
    for use in (jax.jit(lambda x: compiled(x)), jax.grad(lambda x: compiled(x)[0])):
        with pytest.raises(InputError, match="traced"):
            use(np.ones(3))


def test_results_outlive_the_function():
    compiled = trimtab.compile(function, X, REST)
    views = [compiled(X, REST)["y"][1:] for _ in range(1000)]
    del compiled
    gc.collect()
    assert all(np.array_equal(v, X[1:] * 2 + 1) for v in views)


@pytest.mark.thorough
def test_eight_threads_call_and_compile_concurrently():
    shared, problems = trimtab.compile(lambda x: jnp.sin(x) + 1, np.ones(3), threads=2), []

    def work(k):
        try:
            wanted = np.sin(np.full(3, float(k))) + 1
            for i in range(200):
                assert np.allclose(shared(np.full(3, float(k))), wanted, rtol=0, atol=1e-15)
                assert shared.lanes(np.full((17, 3), float(k))).shape == (17, 3)
                if i % 100 == 0:
                    assert trimtab.compile(lambda x, i=i: x * k + i, np.ones(3))(np.ones(3))[0] == k + i
        except BaseException as problem:
            problems.append(problem)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert problems == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_forked_process_can_call_it():
    compiled = trimtab.compile(lambda x: x + 1, np.ones(3))
    child = os.fork()
    if child == 0:
        right = compiled(np.ones(3))[0] == 2 and compiled.lanes(np.ones((50, 3)))[49, 0] == 2
        os._exit(0 if right else 1)
    assert os.waitpid(child, 0)[1] == 0
