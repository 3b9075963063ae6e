"""Findings about the compiler of JAX functions to C."""

import functools
import importlib.metadata
import tempfile
import time
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import trimtab
from findings.finding import Finding, Outcome, run_python
from trimtab.compiler.compiled_function import export_callable
from trimtab.core.errors import InputError
from trimtab.export.verify import verify_folder

RNG = np.random.default_rng(1)
Pair = namedtuple("Pair", ["x", "k"])
ROUNDS, CALLS = 20, 300


def compare(function: Callable[..., Any], *arguments: Any) -> Outcome:
    """Compare a compiled function with JAX at the same arguments."""
    got = jax.tree.leaves(trimtab.compile(function, *arguments)(*arguments))
    with jax.enable_x64(True):
        wanted = jax.tree.leaves(jax.jit(function)(*arguments))
    off = max(float(np.max(np.abs(np.asarray(g) - np.asarray(w)))) for g, w in zip(got, wanted, strict=True))
    return Outcome(f"largest difference to JAX {off:.1e}", off < 1e-9)


def table_at_two_shapes() -> Outcome:
    """Multiply by one table at two shapes."""
    with jax.enable_x64(True):
        table = jnp.asarray(RNG.normal(size=(24, 48)))
    return compare(lambda x: table.reshape(48, 24) @ (table @ x), RNG.normal(size=48))


def several_results_at_compile_time() -> Outcome:
    """Sort, split and pass on a table of integers."""
    table = jnp.arange(60)[::-1]
    return compare(
        lambda x: (jnp.sort(table) * x, jnp.split(table, 2)[1] * x, lax.optimization_barrier(table) * x), 1.0
    )


def top_of_negated_nan() -> Outcome:
    """Take the largest of negated numbers, one of them NaN."""
    x = np.array([1.0, np.nan, 2.0])
    found = [int(trimtab.compile(lambda x: lax.top_k(-x, 1)[1], v)(v)[0]) for v in (x, np.tile(x, 20))]
    return Outcome(f"positions {found}", found == [0, 0])


MANY_LEAVES = """
import threading, numpy as np, trimtab, jax.numpy as jnp
leaves = [float(i) for i in range(12000)]; arrays = [np.arange(1000.0)] * 14
f = trimtab.compile(lambda t: t[0] + t[-1], leaves)
g = trimtab.compile(lambda t: sum(jnp.cumsum(jnp.sin(x)) for x in t), arrays)
def go(): print(f(leaves), g(arrays)[0])
threading.stack_size(128 * 1024)
thread = threading.Thread(target=go); thread.start(); thread.join()
"""


def many_leaves_on_a_small_stack() -> Outcome:
    """Call with many leaves in a thread with a small stack."""
    status, line = run_python(MANY_LEAVES)
    return Outcome(f"exit status {status}, {line}", (status, line) == (0, "11999.0 0.0"))


PRECISION = "import jax, trimtab; f = trimtab.compile(lambda x: x * 2, 1.0); print(jax.config.jax_enable_x64, f(0.1))"


def precision_of_other_code() -> Outcome:
    """Look at JAX's setting after a compilation."""
    status, line = run_python(PRECISION)
    return Outcome(f"jax_enable_x64 and f(0.1): {line}", (status, line) == (0, "False 0.2"))


NAMES = ("template", "export", "exp10", "std", "NAN", "linux", "main", "double", "trimtab", "y0", "errno")


def names_of_the_c_language() -> Outcome:
    """Compile and export functions whose name or argument has a meaning in C or C++."""
    failed = []
    for name in NAMES:
        space: dict[str, Any] = {}
        exec(f"def {name}({name}): return {name} * 2", space)
        function = space[name]
        compiled = trimtab.compile(function, 1.0, lanes=4)
        good = compiled(2.0) == 4 and np.array_equal(compiled.lanes(np.ones(3)), np.full(3, 2.0))
        failed += [] if good and verifies(function, (1.0,)) else [name]
    return Outcome(f"{len(NAMES) - len(failed)} of {len(NAMES)} work {failed or ''}", not failed)


def verifies(function: Callable[..., Any], example: tuple[Any, ...]) -> bool:
    """Export a function to a new folder, and verify the folder."""
    with tempfile.TemporaryDirectory() as folder:
        export_callable(function, example, Path(folder))
        return verify_folder(Path(folder)).good


def least_time(call: Callable[[], Any]) -> float:
    """Return the CPU time (s) of one of CALLS calls."""
    start = time.process_time()
    for _ in range(CALLS):
        call()
    return (time.process_time() - start) / CALLS


def cost_of_a_call() -> Outcome:
    """Compare the CPU time of calls with that of `jax.jit`, in turns, by the least of all rounds."""
    with jax.enable_x64(True):
        a, j = np.arange(3.0), jnp.arange(3.0)
        many = jnp.ones((4, 3))

        def product(p: Any) -> Any:
            return p.x * p.k

        kinds: dict[str, tuple[Any, Any, tuple[Any, ...]]] = {
            "jax.Array": (trimtab.compile(jnp.square, a), jax.jit(jnp.square), (j,)),
            "two": (trimtab.compile(jnp.multiply, a, a), jax.jit(jnp.multiply), (j, j)),
            "namedtuple": (trimtab.compile(product, Pair(a, a)), jax.jit(product), (Pair(j, j),)),
            "lanes": (trimtab.compile(jnp.square, a).lanes, jax.jit(jax.vmap(jnp.square)), (many,)),
        }
        ratios = {}
        for name, (mine, theirs, given) in kinds.items():
            pairs = [(functools.partial(mine, *given), functools.partial(theirs, *given))] * ROUNDS
            times = [(least_time(one), least_time(other)) for one, other in pairs]
            ratios[name] = min(t[0] for t in times) / min(t[1] for t in times)
    text = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    return Outcome(f"CPU time as a fraction of jax.jit's: {text}", max(ratios.values()) <= 1)


def integers_beyond_doubles() -> Outcome:
    """Verify an exported sum of 64-bit integers."""
    good = verifies(lambda a: a + 1, (np.int64(2**53 + 1),))
    return Outcome(f"verified: {good}", good)


def sign_of_a_zero() -> Outcome:
    """Compute a heading from a zero with a sign."""
    heading = trimtab.compile(lambda s, v: jnp.arctan2(0 * s, jnp.maximum(-v * s, 0)), 0.0, 1.0)(0.0, 1.0)
    return Outcome(f"{heading}", heading == 0)


def refusals_with_substitutes() -> Outcome:
    """Compile primitives without C text, and read what the error suggests."""
    x = np.arange(4.0)

    def pooled(x: Any) -> Any:
        return jnp.sum(lax.reduce_window(x, -jnp.inf, lax.max, (2,), (2,), "VALID"))

    functions = {
        "fori_loop": lambda x: lax.reduce(x, 0.0, lambda a, b: a + 2 * b, (0,)),
        "astype": lambda x: lax.reduce_precision(x, 8, 23),
        "reshape": jax.grad(pooled),
        "top_k": lambda x: lax.approx_max_k(x, 2)[0],
    }
    named = []
    for word, function in functions.items():
        try:
            trimtab.compile(function, x)
        except InputError as refusal:
            named += [word] if word in (refusal.fix or "") else []
    return Outcome(f"substitutes named: {', '.join(named)}", len(named) == len(functions))


def narrow_products() -> Outcome:
    """Verify exported products of int32 and uint16 with the sanitizer for undefined behaviour."""
    good = [
        verifies(lambda a, b: a * b, (np.dtype(t).type(60000), np.dtype(t).type(50000))) for t in ("int32", "uint16")
    ]
    return Outcome(f"verified: {good}", all(good))


def versions_of_jax() -> Outcome:
    """Compile a scan with the installed JAX, and look at the versions that are accepted."""
    scanned = compare(lambda x: lax.scan(lambda c, v: (c + v, c), 0.0, x), np.arange(5.0))
    bounds = [r for r in importlib.metadata.requires("trimtab") or [] if r.replace(" ", "").startswith("jax")][:1]
    accepts = not any("<0.11" in r or "<0.12" in r for r in bounds)
    return Outcome(f"JAX {jax.__version__}, requirement {bounds}, scan: {scanned.text}", accepts and scanned.holds)


FINDINGS = [
    Finding("K1", "T.reshape(48, 24) @ (T @ x) with a table T (24, 48)", "wrong by 74, silently", table_at_two_shapes),
    Finding(
        "K2",
        "jnp.sort(T) * x, jnp.split(T, 2), lax.optimization_barrier(T) with a table T of 60 integers",
        "ValueError from inside",
        several_results_at_compile_time,
    ),
    Finding(
        "K3", "lax.top_k(-x, 1) with a NaN in x", "the NaN is chosen; JAX puts a negated NaN last", top_of_negated_nan
    ),
    Finding(
        "K4",
        "12 000 leaves, and 14 arrays of 1 000, in a thread with a stack of 128 kB",
        "SIGSEGV",
        many_leaves_on_a_small_stack,
    ),
    Finding(
        "K5",
        "first trimtab.compile of a process",
        "jax_enable_x64 stays on for all other code",
        precision_of_other_code,
    ),
    Finding(
        "K6",
        f"functions and arguments named {', '.join(NAMES)}",
        "BuildError with twenty lines of the C++ compiler",
        names_of_the_c_language,
    ),
    Finding(
        "K7",
        "calls with a jax.Array, two, a named tuple, and .lanes",
        "5.4, 21.8, 13 and 32 microseconds; jax.jit takes 3.7",
        cost_of_a_call,
    ),
    Finding(
        "K8",
        "exported f(a: int64) = a + 1 at 2**53 + 1",
        "the check rejects correct C: its vectors go through double",
        integers_beyond_doubles,
    ),
    Finding("K9", "arctan2(0 s, maximum(-v s, 0)) at (0, 1)", "pi; JAX gives 0", sign_of_a_zero),
    Finding(
        "K10",
        "lax.reduce with a function, lax.reduce_precision, the gradient of max pooling, lax.approx_max_k",
        "the error names no substitute",
        refusals_with_substitutes,
    ),
    Finding("K11", "exported products of int32 and uint16", "signed overflow without -fwrapv", narrow_products),
    Finding("K12", "JAX 0.11 and 0.12", "refused; without the bound, every scan is a KeyError", versions_of_jax),
]
