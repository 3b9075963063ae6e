"""In whatever order a program imports trimtab and JAX: float64 before anything is computed, and records are pytrees.

Each case is a program of its own, because a process imports JAX once.
"""

import os
import subprocess
import sys

import pytest

RECORD = """
from trimtab.core.record import Scalar, option, part, quantity, record, replace

@record
class Gains:
    k: Scalar = quantity("1", "A gain.", default=3.0)
    form: str = option("A form.", default="plain")
"""
JAX = """
import jax
import jax.numpy as jnp
"""
NO_JAX = "import sys; assert 'jax' not in sys.modules\n"
PYTREE = """
assert jax.tree.leaves(GAINS) == [3.0], jax.tree.leaves(GAINS)
slope = jax.jit(jax.grad(lambda g: g.k**2 if g.form == "plain" else 0 * g.k))(GAINS)
assert type(slope) is Gains and slope.k.dtype == "float64" and slope.k == 6.0, slope
paths = jax.tree_util.tree_flatten_with_path({"g": GAINS})[0]
assert jax.tree_util.keystr(paths[0][0]) == "['g'].k"
"""
FLOAT64 = "assert TABLE.dtype == 'float64', TABLE.dtype\n"

ORDERS = {
    "jax, then records": JAX + RECORD + "TABLE = jnp.ones(3)\nGAINS = Gains()\n" + PYTREE + FLOAT64,
    "records, then jax, then one is made": RECORD + NO_JAX + JAX + "GAINS = Gains()\n" + PYTREE,
    "records, then jax, then a copy is made": RECORD
    + "GAINS = Gains(1.0)\n"
    + NO_JAX
    + JAX
    + "GAINS = replace(GAINS, k=3.0)\n"
    + PYTREE,
    "records, jax, another record": RECORD
    + "GAINS = Gains()\n"
    + JAX
    + '@record\nclass Other:\n    x: Scalar = quantity("m", "A length.")\n'
    + PYTREE,
    "one is made, then jax, then a part of the loop": RECORD
    + "GAINS = Gains()\n"
    + JAX
    + "import trimtab.core.rotation\n"
    + PYTREE,
    "one is made, then a part of the loop": RECORD
    + "GAINS = Gains()\n"
    + NO_JAX
    + "from trimtab.core.float64 import jax\n"
    + PYTREE,
    "an array before the first record": "from trimtab.core.record import record\n"
    + NO_JAX
    + JAX
    + "TABLE = jnp.linspace(0.0, 1.0, 3)\n"
    + RECORD
    + "GAINS = Gains()\n"
    + PYTREE
    + FLOAT64,
    "an array and no record at all": "import trimtab.logs.log\n" + NO_JAX + JAX + "TABLE = jnp.ones(2)\n" + FLOAT64,
    "what checks itself when made": RECORD.replace("default=3.0)", "default=2.0)")
    + "    def __post_init__(self):\n        object.__setattr__(self, 'k', self.k + 1)\n"
    + "assert Gains().k == 3.0\n"
    + NO_JAX
    + JAX
    + "GAINS = Gains()\n"
    + PYTREE,
    "messages before jax": "from trimtab.core.signals import PlanarForce, measured\n"
    + NO_JAX
    + JAX
    + "sample = measured(7, PlanarForce(1.0, 2.0))\nassert jax.tree.leaves(sample) == [1.0, 2.0, 7, 0.0, True, True]\n",
}


def program(text, **environment):
    own = {k: v for k, v in os.environ.items() if k != "JAX_ENABLE_X64"}
    return subprocess.run([sys.executable, "-c", text], env=own | environment, capture_output=True, text=True)


@pytest.mark.parametrize("text", ORDERS.values(), ids=ORDERS)
def test_every_order_gives_float64_and_pytrees(text):
    done = program(text)
    assert done.returncode == 0, done.stderr


def test_the_environment_is_left_as_it_was_found():
    text = RECORD + JAX + "GAINS = Gains()\nimport os\nprint(os.environ.get('JAX_ENABLE_X64'), jnp.ones(1).dtype)\n"
    assert program(text).stdout == "None float64\n"
    assert program(text, JAX_ENABLE_X64="0").stdout == "0 float64\n"
    assert program(text, JAX_ENABLE_X64="1").stdout == "1 float64\n"
