"""Compiled functions run on small stacks: thousands of arguments and results, large arrays, and many small ones."""

import textwrap

import pytest

from compiler.test_odd_arguments import run_script

PROLOGUE = """
import threading, jax, jax.numpy as jnp, numpy as np, trimtab
jax.config.update("jax_enable_x64", True)

def products(x, count):
    sums = [jnp.cumsum(x * k) for k in range(count)]
    return jnp.cumsum(sum(a[::-1] * b for a, b in zip(sums, [*sums[3:], *sums[:3]])))[::-1]

def run(kilobytes, call):
    found = []
    threading.stack_size(kilobytes << 10)
    thread = threading.Thread(target=lambda: found.append(call()))
    thread.start()
    thread.join()
    return found[0]
"""
CASES = {
    "leaves": """
        f = trimtab.compile(lambda x: (x[0] + x[-1], x[5]), [0.0] * 12000)
        given = [float(k) for k in range(12000)]
        assert run(256, lambda: f(given)) == (11999.0, 5.0)
    """,
    "results": """
        f = trimtab.compile(lambda x: [x] * 12000, 0.0)
        assert run(128, lambda: f(3.0)) == [3.0] * 12000
    """,
    "arrays": """
        f = trimtab.compile(lambda x: products(x, 14), np.ones(1000))
        assert f.workspace > 0
        assert run(128, lambda: f(np.ones(1000)))[-1] == products(np.ones(1000), 14)[-1]
    """,
    "small arrays": """
        f = trimtab.compile(lambda x: products(x, 90), np.ones(100))
        assert f.workspace > 0
        assert run(128, lambda: f(np.ones(100)))[-1] == products(np.ones(100), 90)[-1]
    """,
}


@pytest.mark.thorough("results", "leaves", "arrays", "small arrays")
@pytest.mark.parametrize("name", CASES)
def test_compiled_functions_run_on_small_stacks(name: str) -> None:
    run_script(PROLOGUE + textwrap.dedent(CASES[name]))
