"""trimtab.compile: the same numbers as JAX in every kind of tree and type, called from threads, and nothing crashes."""

import gc
import threading
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.export.verify import verify_folder


@record
class Spring:
    """A spring. Source: none."""

    k: Scalar = quantity("N/m", "Stiffness.")
    rest: Any = quantity("m", "Rest.", shape=(2,))


@record
class Cart:
    """A cart. Source: none."""

    spring: Spring = part("Its spring.")
    kind: str = option("How it is drawn.", default="plain")


class Pair(NamedTuple):
    x: Any
    y: Any


def same(got: Any, wanted: Any, relative: float = 1e-13) -> None:
    assert jax.tree.structure(got) == jax.tree.structure(wanted)
    for g, w in zip(jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True):
        w = np.asarray(w)
        assert (g.shape, g.dtype) == (w.shape, w.dtype)
        np.testing.assert_allclose(g, w, rtol=relative if w.dtype == np.float64 else 3e-6)


def test_accepts_and_returns_trees_of_every_kind() -> None:
    def f(x, tree, cart, pair):
        k = cart.spring.k * tree["gain"][1]
        moved = Cart(Spring(k, cart.spring.rest + x), cart.kind)
        return {"b": [x * k, (pair.y, None)], "a": pair._replace(x=x.sum())}, moved

    arguments = (
        np.arange(2.0),
        {"gain": [1, 0.5], "none": None},
        Cart(Spring(3.0, np.ones(2))),
        Pair(np.float32(2.0), np.arange(5)),
    )
    compiled = trimtab.compile(f, *arguments)
    same(compiled(*arguments), jax.jit(f)(*arguments))
    with pytest.raises(InputError, match="have the structure"):
        compiled(*arguments[:2], Cart(Spring(3.0, np.ones(2)), "other"), arguments[3])


def test_records_without_options_are_flattened_in_c() -> None:
    spring = Spring(3.0, np.array([1.0, 2.0]))
    compiled = trimtab.compile(lambda s: s.k * s.rest, spring)
    assert np.array_equal(compiled(Spring(2.0, np.array([4.0, 5.0]))), [8.0, 10.0])
    with pytest.raises(InputError, match=r"s\.rest has shape \(3,\)"):
        compiled(Spring(2.0, np.zeros(3)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int8, np.int32, np.int64, np.uint16, np.uint64, np.bool_])
def test_dtypes_follow_the_example(dtype: Any) -> None:
    x = np.array([[1, 0, 3], [4, 5, 1]], dtype)

    def f(x):
        return x.T, x[:, ::-1], jnp.where(x > 1, x, x[::-1])

    compiled = trimtab.compile(f, x)
    same(compiled(x), jax.jit(f)(x))
    strided = np.zeros((4, 6), dtype)[::2, ::2]
    strided[...] = x
    same(compiled(strided), jax.jit(f)(x))
    same(compiled(jnp.asarray(x)), jax.jit(f)(x))
    same(compiled(x.astype(x.dtype.newbyteorder())), jax.jit(f)(x))


def waves(x, y):
    wild = (
        jnp.sin(x) * jnp.cos(y) + jnp.exp(-x * x) + jnp.arctan2(x, y) + jnp.tanh(x) + x % y + jnp.power(jnp.abs(x), y)
    )
    whole = x.astype(jnp.int32), x > y, jnp.isfinite(x), jnp.argmax(x), jnp.sign(x).astype(jnp.int64)
    loop = jax.lax.while_loop(lambda c: c < 5, lambda c: c + jnp.abs(x[0]) + 0.5, x[1])
    return wild, whole, loop, jnp.maximum(x, y), jnp.nextafter(x, y), jnp.cumsum(x), jnp.abs(x), jnp.round(x)


@pytest.mark.thorough
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_lanes_and_threads_match_single_calls_bitwise(dtype: Any, lanes: int) -> None:
    rng = np.random.default_rng(lanes)
    x, y = (rng.normal(scale=3.0, size=(19, 5)).astype(dtype) for _ in range(2))
    x[3, 2], x[4, 1], x[5, 0] = np.nan, np.inf, -0.0
    compiled = trimtab.compile(waves, x[0], y[0], lanes=lanes, threads=3)
    many = jax.tree.leaves(compiled.lanes(x, y))
    wanted = jax.tree.leaves(jax.vmap(waves)(jnp.asarray(x), jnp.asarray(y)))
    for k in range(len(x)):
        for got, one, w in zip(many, jax.tree.leaves(compiled(x[k], y[k])), wanted, strict=True):
            assert got.dtype == one.dtype == w.dtype
            assert np.array_equal(got[k], one, equal_nan=one.dtype.kind == "f")
            np.testing.assert_allclose(one, w[k], rtol=2e-5 if dtype == np.float32 else 1e-12, atol=1e-6)


def test_array_without_run_axis_is_shared_by_all_runs() -> None:
    compiled = trimtab.compile(lambda x, k: x * k, np.zeros(3), 1.0)
    x = np.arange(15.0).reshape(5, 3)
    assert np.array_equal(compiled.lanes(x, 2.0), 2 * x)
    assert np.array_equal(compiled.lanes(x[0], np.arange(4.0)), np.outer(np.arange(4.0), x[0]))
    with pytest.raises(InputError, match="no array has an axis of runs"):
        compiled.lanes(x[0], 2.0)
    with pytest.raises(InputError, match="has 4 runs"):
        compiled.lanes(x, np.zeros(4))
    assert compiled.lanes(np.zeros((0, 3)), 1.0).shape == (0, 3)


def test_float64_works_without_jax_x64_setting(tmp_path: Any) -> None:
    def noisy(x: Any, words: Any) -> Any:
        draws = jax.random.normal(jax.random.wrap_key_data(words), (3,))
        return {"line": jnp.linspace(0.0, x, 3) + draws, "large": jnp.sort(jnp.arange(60)[::-1]) * 2**40}

    words = np.zeros(2, np.uint32)
    wanted, first = jax.jit(noisy)(0.1, words), jax.jit(noisy)(0.0, words)
    with jax.enable_x64(False):
        function = trimtab.compile(noisy, 0.0, words)
        got, in_lanes = function(0.1, words), function.lanes(np.full(5, 0.1), words)
        function.export(tmp_path)
        assert jnp.zeros(1).dtype == np.float32
    same(got, wanted)
    assert [got[k].dtype for k in ("line", "large")] == [np.float64, np.int64]
    assert all(np.array_equal(in_lanes[k][4], got[k]) for k in got)
    vectors = np.loadtxt(tmp_path / "vectors.csv", delimiter=",", skiprows=1)
    same(vectors[0, -3:], first["line"])


def test_float32_arrays_stay_float32() -> None:
    with jax.enable_x64(False):
        weights = jnp.arange(3.0)
        function = trimtab.compile(lambda x: weights * x, weights)
        assert function(weights).dtype == np.float32


def test_gradients_and_hessians_compile() -> None:
    def rosenbrock(x):
        return jnp.sum(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)

    x = np.linspace(-1, 1, 6)
    for derived in (jax.grad(rosenbrock), jax.hessian(rosenbrock), jax.value_and_grad(rosenbrock)):
        same(trimtab.compile(derived, x)(x), jax.jit(derived)(x), 1e-12)


def test_accepts_keyword_arguments_and_python_numbers() -> None:
    compiled = trimtab.compile(lambda x, n, on: jnp.where(on, x * n, x), 1.0, 2, True)
    assert compiled(3, n=2, on=True) == 6.0
    assert compiled(np.float32(0.5), 4, np.bool_(False)) == 0.5
    assert compiled(x=-1.0, n=np.int32(3), on=True) == -3.0


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int8, np.int32, np.int64, np.uint16, np.uint64, np.bool_])
def test_numpy_scalars_keep_value_and_dtype(dtype: Any) -> None:
    compiled = trimtab.compile(lambda x, y: (x, y), dtype(0), np.zeros(2))
    for number in (dtype(1), dtype(0), np.array([dtype(100)])[0]):
        got = compiled(number, np.ones(2))[0]
        assert got == number
        assert got.dtype == dtype
    assert compiled(x=dtype(1), y=np.ones(2))[0] == dtype(1)


@pytest.mark.parametrize(
    "function", [jnp.signbit, jnp.isnan, jnp.sqrt, jnp.float_power, jnp.select], ids=lambda f: f.__name__
)
def test_compiles_functions_named_like_c_library_functions(function: Any) -> None:
    def named(x):
        return -x

    named.__name__ = function.__name__
    assert trimtab.compile(named, 1.0, lanes=4)(3.0) == -3.0


class Odd:
    """No array."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("never")


REFUSED: dict[str, tuple[Any, ...]] = {
    "too few": (1.0,),
    "too many": (1.0, np.zeros(3), 2.0),
    "shape": (1.0, np.zeros(4)),
    "axes": (np.zeros(1), np.zeros(3)),
    "list for an array": (1.0, [0.0, 0.0, 0.0]),
    "text": ("a", np.zeros(3)),
    "none": (None, np.zeros(3)),
    "complex": (1j, np.zeros(3)),
    "objects": (1.0, np.array([None, 1, 2])),
    "no array": (Odd(), np.zeros(3)),
    "a class": (float, np.zeros(3)),
    "text array": (1.0, np.array(["a", "b", "c"])),
    "a masked length": (1.0, np.zeros((3, 0))),
    "a record array": (1.0, np.zeros(3, [("a", "f8")])),
    "dates": (1.0, np.zeros(3, "M8[s]")),
    "keys that do not sort": ({1: 2.0, "a": 3.0}, np.zeros(3)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_rejects_arguments_unlike_the_example(name: str) -> None:
    compiled = trimtab.compile(lambda x, y: x + y, 1.0, np.zeros(3))
    with pytest.raises(InputError) as caught:
        compiled(*REFUSED[name])
    assert caught.value.fix
    assert np.array_equal(compiled(1.0, np.zeros(3)), np.ones(3))


def test_rejects_lossy_conversions() -> None:
    single = trimtab.compile(lambda x: x * 2, np.float32(1))
    with pytest.raises(InputError, match=r"astype\(np\.float32\)"):
        single(np.zeros(()))
    assert single(0.1).dtype == np.float32
    whole = trimtab.compile(lambda n: n + 1, 1)
    for wrong in (1.0, 2**70, np.float64(1), "1"):
        with pytest.raises(InputError):
            whole(wrong)
    assert whole(2**63 - 1) == -(2**63)


def test_rejects_invalid_examples() -> None:
    with pytest.raises(InputError, match="not an array"):
        trimtab.compile(lambda x: x, "text")
    with pytest.raises(InputError, match="branches in Python"):
        trimtab.compile(lambda x: 1.0 if x > 0 else 2.0, 1.0)
    for wrong in ({"lanes": 3}, {"threads": 0}):
        with pytest.raises(InputError):
            trimtab.compile(lambda x: x, 1.0, **wrong)
    compiled = trimtab.compile(lambda x: x, 1.0)
    with pytest.raises(InputError, match="traced"):
        jax.jit(compiled)(1.0)


def test_eight_threads_call_concurrently() -> None:
    def f(x, k):
        return jnp.cumsum(jnp.sin(x) * k)[::-1], k

    x = np.linspace(0.0, 1.0, 30_000)
    compiled = trimtab.compile(f, x, 1.0)
    assert compiled.workspace > 0
    wanted = {k: compiled(x, float(k))[0].copy() for k in range(8)}
    wrong: list[int] = []

    def call(k: int) -> None:
        for _ in range(50):
            values, same_k = compiled(x, float(k))
            if not np.array_equal(values, wanted[k]) or same_k != k:
                wrong.append(k)
            try:
                compiled(x[:-1], 1.0)
                wrong.append(-1)
            except InputError:
                pass

    threads = [threading.Thread(target=call, args=(k,)) for k in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert not wrong


def test_results_share_no_memory_and_do_not_leak() -> None:
    import resource

    x = np.arange(1000.0)
    compiled = trimtab.compile(lambda x: {"a": x * 2, "b": (x + 1,)}, x)
    first = compiled(x)["a"]
    compiled(x + 1)
    assert np.array_equal(first, 2 * x)
    for _ in range(2000):
        compiled(x)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(20_000):
        compiled(x)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 4000  # 320 MB, were one result kept


@pytest.mark.real_time
@pytest.mark.parametrize("number", [1.0, np.float64(1.0), np.array(1.0)], ids=["Python", "numpy", "array"])
def test_call_costs_less_than_numpy_multiply(number: Any) -> None:
    compiled = trimtab.compile(lambda x: x * 2.0, 1.0)
    rounds: dict[str, list[float]] = {"compiled": [], "numpy": []}
    for _ in range(50):
        for name, product in (("compiled", compiled), ("numpy", lambda x: np.multiply(x, 2.0))):
            start = time.perf_counter()
            for _ in range(1000):
                product(number)
            rounds[name].append(time.perf_counter() - start)
    assert min(rounds["compiled"]) < min(rounds["numpy"])


def test_exported_folder_matches_jax(tmp_path: Any) -> None:
    def drag(v, gains):
        speed = jnp.sqrt(v @ v)
        return {"force": -gains["k"] * speed * v, "fast": speed > 2, "count": jnp.int32(3)}

    example = np.array([1.0, 2.0, 0.5]), {"k": 0.1}
    compiled = trimtab.compile(drag, *example)
    files = compiled.export(tmp_path / "c", name="drag-law")
    assert {f.name for f in files} >= {"drag_law.h", "drag_law.c", "replay.c", "vectors.csv"}
    report = verify_folder(tmp_path / "c")
    assert report.good
    assert report.steps == 8
    header = (tmp_path / "c" / "drag_law.h").read_text()
    assert "void drag_law(const drag_law_in *in, drag_law_out *out);" in header
    assert "double v[3];" in header
    assert "WORKSPACE" not in header
    with pytest.raises(InputError, match="cannot write"):
        compiled.export("/proc/nowhere")


@pytest.mark.thorough
def test_exported_function_declares_its_workspace(tmp_path: Any) -> None:
    compiled = trimtab.compile(lambda x: jnp.cumsum(jnp.sin(x))[::-1].sum(), np.linspace(0, 1, 20_000))
    compiled.export(tmp_path, name="long_sum")
    header = (tmp_path / "long_sum.h").read_text()
    size = int(header.split("LONG_SUM_WORKSPACE = ")[1].split(" ")[0])
    assert size >= 160_000
    assert "void *workspace);" in header
    assert verify_folder(tmp_path).good


@pytest.mark.thorough
def test_large_weights_are_data_and_not_source_text():
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(2, 60, 60))
    x = rng.normal(size=60)
    one, other = (trimtab.compile(lambda x, W=W: W @ x, x, lanes=4) for W in (first, second))
    again = trimtab.compile(lambda x: first @ x, x)
    assert repr(float(first[0, 0])) not in one.c_source
    for compiled, W in ((one, first), (other, second), (again, first)):
        assert np.allclose(compiled(x), W @ x, rtol=0, atol=1e-13)
        assert np.array_equal(compiled.lanes(np.stack([x, -x]))[1], compiled(-x))
    del again
    gc.collect()
    assert np.allclose(one(x), first @ x, rtol=0, atol=1e-13)


def test_exported_weights_are_source_text(tmp_path):
    W = np.random.default_rng(3).normal(size=(60, 60))
    trimtab.compile(lambda x: W @ x, np.zeros(60)).export(tmp_path, name="product")
    assert repr(float(W[0, 0])) in (tmp_path / "product.c").read_text()


def test_lane_count_is_one_for_already_vectorised_runs():
    a = np.ones((60, 60))
    assert trimtab.compile(lambda a, b: jnp.outer(a, b), a[0], a[0])._build_lanes()[0] == 1
    assert trimtab.compile(lambda a: jnp.sin(a) @ a, a)._build_lanes()[0] > 1
