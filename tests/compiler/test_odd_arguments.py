"""Wrong uses of `trimtab.compile`: each rejected with part, problem and fix; Python never crashes."""

import copy
import functools
import os
import pickle
import subprocess
import sys
import textwrap
import threading
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler.arguments import Arguments
from trimtab.core.errors import InputError

KEY = jax.random.key(3)


class Raising:
    """No array."""

    def __init__(self, error: type[Exception]) -> None:
        self.error = error

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise self.error("boom")


class Sub(np.ndarray):  # pyright: ignore[reportMissingTypeArgument]
    """An array of another class."""


class NoArray:
    """Claims to be one."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        return 5


def scaled(x: Any, k: Any) -> Any:
    return x * k, x.sum()


@functools.cache
def compiled_scaled() -> Any:
    return trimtab.compile(scaled, np.zeros(3), 1.0)


def inside_itself() -> list[Any]:
    endless: list[Any] = []
    endless.append(endless)
    return endless


def deleted() -> jax.Array:
    x = jnp.ones(3)
    x.delete()
    return x


def bad_calls() -> dict[str, tuple[tuple[Any, ...], str]]:
    return {
        "RuntimeError": ((Raising(RuntimeError), 1.0), "x is not an array: boom"),
        "MemoryError": ((Raising(MemoryError), 1.0), "x is not an array: boom"),
        "IndexError": ((Raising(IndexError), 1.0), "x is not an array: boom"),
        "__array__ without": ((NoArray(), 1.0), "x is not an array"),
        "deleted": ((deleted(), 1.0), "x is not an array: Array has been deleted"),
        "key": ((np.ones(3), KEY), "k is a random key of type key<fry>, the example has float64"),
        "bytes": ((bytes(24), 1.0), "x has shape"),
        "a tree in itself": ((inside_itself(), 1.0), "not a tree"),
        "keys of several types": (({1: 1, "a": 2}, 1.0), "not a tree"),
        "a number beyond floats": ((np.ones(3), 10**400), "too large"),
        "only a shape": ((jax.ShapeDtypeStruct((3,), np.float64), 1.0), "x has shape"),
        "long double": ((np.zeros(3, np.longdouble), 1.0), "float128|longdouble|float96"),
        "matrix": ((np.ones(3), np.ones((1, 1)).view(np.matrix)), "k has shape"),
    }


@pytest.mark.parametrize("name", bad_calls())
def test_rejects_bad_calls(name: str) -> None:
    arguments, problem = bad_calls()[name]
    for call in (compiled_scaled(), compiled_scaled().lanes):
        with pytest.raises(InputError, match=problem) as refusal:
            call(*arguments)
        assert refusal.value.fix


@pytest.mark.parametrize("change", [jax.jit, jax.vmap, jax.grad])
def test_rejects_calls_traced_by_jax(change: Any) -> None:
    given = np.ones((2, 3)) if change is jax.vmap else 1.0
    with pytest.raises(InputError, match="traced by JAX"):
        change(lambda k: compiled_scaled()(np.ones(3), k)[1])(given)


def odd_arrays() -> dict[str, Any]:
    x = np.array([0.5, -1.0, 2.0])
    read_only = x.copy()
    read_only.flags.writeable = False
    return {
        "unaligned": np.frombuffer(b"a" + x.tobytes(), np.uint8)[1:].view(np.float64),
        "read-only": read_only,
        "backwards": x[::-1].copy()[::-1],
        "swapped": x.astype(x.dtype.newbyteorder()),
        "memoryview": x.data,
        "subclass": x.view(Sub),
        "metadata": x.astype(np.dtype("f8", metadata={"unit": "m"})),
        "float32": x.astype(np.float32),
        "jax": jnp.asarray(x),
    }


@pytest.mark.parametrize("name", odd_arrays())
def test_accepts_arrays_of_every_origin(name: str) -> None:
    x = odd_arrays()[name]
    got = compiled_scaled()(x, 2.0)
    assert np.array_equal(got[0], [1.0, -2.0, 4.0])
    assert np.array_equal(compiled_scaled().lanes(x, np.array([1.0, 2.0]))[0][1], got[0])


@pytest.mark.parametrize(("mine", "given"), ["lq", "ql", "LQ", "QL"])
def test_dtype_aliases_are_equivalent(mine: str, given: str) -> None:
    compiled = trimtab.compile(lambda x: x + 1, np.zeros(2, mine))
    assert np.array_equal(compiled(np.ones(2, given)), [2, 2])
    assert np.array_equal(compiled.lanes(np.ones((5, 2), given)), np.full((5, 2), 2))


@pytest.mark.parametrize("wrong", [{"lanes": True}, {"lanes": [4]}, {"threads": True}, {"threads": 2.0}])
def test_rejects_bad_options(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        trimtab.compile(lambda x: x, 1.0, **wrong)


def test_copies_and_pickles_compute_the_same() -> None:
    for again in (copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))):
        other = again(compiled_scaled())
        assert np.array_equal(other(np.ones(3), 2.0)[0], np.full(3, 2.0))


@pytest.mark.thorough
def test_calls_stay_correct_while_other_threads_compile() -> None:
    x = np.linspace(0.0, 1.0, 9000)
    first = trimtab.compile(lambda x: jnp.cumsum(jnp.sin(x))[::-1], x)
    wanted, wrong, over = first(x), [], threading.Event()

    def call() -> None:
        while not over.is_set():
            if not np.array_equal(first(x), wanted):
                wrong.append("single")

    def build(k: int) -> None:
        got = trimtab.compile(lambda y: y * k + 1, 1.0)
        if got(2.0) != 2 * k + 1 or not np.array_equal(got.lanes(np.arange(9.0)), np.arange(9.0) * k + 1):
            wrong.append(f"build {k}")

    callers = [threading.Thread(target=call) for _ in range(4)]
    builders = [threading.Thread(target=build, args=(k,)) for k in range(4)]
    for t in (*callers, *builders):
        t.start()
    for t in builders:
        t.join()
    over.set()
    for t in callers:
        t.join()
    assert not wrong


SCRIPTS = {
    "after fork": """
        import multiprocessing
        def child(): raise SystemExit(0 if (f(x) == wanted).all() and (f.lanes(many)[2] == wanted).all() else 5)
        f.lanes(many)
        p = multiprocessing.get_context("fork").Process(target=child); p.start(); p.join(60)
        assert p.exitcode == 0, p.exitcode
    """,
    "at shutdown": """
        import threading, time, atexit
        def go():
            while True: f(x), f.lanes(many)
        for _ in range(8): threading.Thread(target=go, daemon=True).start()
        atexit.register(lambda: f(x))
        class Late:
            def __del__(self): f(x)
        late = Late()
        time.sleep(0.3)
    """,
    "views outlive": """
        import gc
        view = f(x)[1:]; each = f.lanes(many)[1]
        del f; gc.collect()
        for _ in range(50): np.empty(9000)[:] = 7
        assert (view == wanted[1:]).all() and (each == wanted).all()
    """,
    "arguments change": """
        import threading
        stop = []
        def spoil():
            while not stop:
                for v in (0, 10**9, -10**9, 2**31 - 1, 8999): i[:] = v
        t = threading.Thread(target=spoil); t.start()
        for _ in range(3000): g(x, i)
        stop.append(1); t.join()
    """,
}
PROLOGUE = """
import warnings; warnings.simplefilter("ignore")
import numpy as np, jax, jax.numpy as jnp, trimtab
x = np.linspace(0.0, 1.0, 9000); many = np.stack([x] * 5); i = np.arange(9)
f = trimtab.compile(lambda x: jnp.cumsum(jnp.sin(x))[::-1], x, threads=3)
g = trimtab.compile(lambda x, i: (x[i], x.at[i].set(1.0), jax.lax.dynamic_slice(x, i[:1], (50,))), x, i)
wanted = f(x)
"""


def run_script(text: str, **environment: str) -> str:
    command = [sys.executable, "-X", "faulthandler", "-c", text]
    ran = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | environment, timeout=200, check=False
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    return ran.stdout


@pytest.mark.thorough
@pytest.mark.parametrize("name", SCRIPTS)
def test_misuse_scripts_do_not_crash_python(name: str) -> None:
    run_script(PROLOGUE + textwrap.dedent(SCRIPTS[name]))


@pytest.mark.thorough
def test_truncated_libraries_are_built_again(tmp_path: Path) -> None:
    script = "import trimtab; print(trimtab.compile(lambda x: x * 3 + 0.25, 1.0)(2.0))"
    for size in (None, 0, 6000):
        for library in tmp_path.rglob("*.so"):
            assert size is not None
            os.truncate(library, size)
        assert "6.25" in run_script(script, TRIMTAB_CACHE=str(tmp_path))


@pytest.mark.thorough
def test_compiles_without_a_writable_cache() -> None:
    script = "import trimtab; print(trimtab.compile(lambda x: x * 3 + 0.25, 1.0)(2.0))"
    assert "6.25" in run_script(script, TRIMTAB_CACHE="/proc/nowhere")


class Pair(NamedTuple):
    """A named tuple."""

    x: Any
    k: Any


@jax.tree_util.register_pytree_node_class
class Backwards(NamedTuple):
    """A named tuple that JAX takes apart in another order."""

    x: Any
    k: Any

    def tree_flatten(self) -> Any:
        return (self.k, self.x), None

    @classmethod
    def tree_unflatten(cls, _: None, parts: Any) -> "Backwards":
        return cls(*reversed(parts))


def refuse(*_: Any) -> Any:
    raise AssertionError("taken apart in Python")


def test_usual_arguments_are_flattened_without_python_code(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_normalise", "_normalise_runs"):
        monkeypatch.setattr(Arguments, name, refuse)
    x = jnp.arange(3.0)
    swap = trimtab.compile(lambda p, d: (Pair(p.k, p.x), d["a"] * 2), Pair(x, 1.0), {"a": x})
    pair, doubled = swap(Pair(x, 2.0), {"a": x + 1})
    assert type(pair) is Pair
    assert pair.x == 2.0
    assert np.array_equal(pair.k, x)
    assert np.array_equal(doubled, [2, 4, 6])
    many = jnp.arange(15.0).reshape(5, 3)
    pairs, doubled = swap.lanes(Pair(many, 2.0), {"a": np.ones(3)})
    assert np.array_equal(pairs.x, np.full(5, 2.0))
    assert np.array_equal(pairs.k, many)
    assert np.array_equal(doubled, np.full((5, 3), 2.0))


@pytest.mark.parametrize("dtype", ["float32", "int8", "int16", "int32", "int64", "uint8", "uint32", "uint64", "bool"])
def test_jax_arrays_of_each_dtype_are_read_correctly(dtype: str) -> None:
    for x in (jnp.asarray([0, 1, 3, 120], dtype), jnp.asarray(1, dtype)):
        same, wide = trimtab.compile(lambda x: x, x), trimtab.compile(lambda x: x * 1.0, np.zeros(x.shape))
        assert np.array_equal(same(x), x)
        if dtype not in ("uint64", "int64"):  # which float64 does not hold
            assert np.array_equal(wide(x), np.asarray(x, np.float64))


def test_custom_registered_named_tuples_keep_field_order() -> None:
    halved = trimtab.compile(lambda p: p.x / p.k, Backwards(np.ones(3), 1.0))
    assert np.array_equal(halved(Backwards(np.ones(3), 2.0)), np.full(3, 0.5))


def test_lanes_reject_masked_arrays_and_unequal_run_counts() -> None:
    with pytest.raises(InputError, match="masked"):
        compiled_scaled().lanes(np.ma.masked_array(np.ones((4, 3)), mask=np.eye(4, 3, dtype=bool)), 1.0)
    with pytest.raises(InputError, match="x has 4 runs, k has 5 runs"):
        compiled_scaled().lanes(jnp.ones((4, 3)), jnp.ones(5))


@pytest.mark.parametrize("shape", [(2, 3, 4), (5, 6, 7)])
def test_reshapes_read_the_given_axes_in_order(shape: tuple[int, ...]) -> None:
    x = np.arange(np.prod(shape, dtype=float)).reshape(shape)
    turned = trimtab.compile(lambda x: jax.lax.reshape(x, (x.size,), (2, 0, 1)), x)
    assert np.array_equal(turned(x), x.transpose(2, 0, 1).ravel())
