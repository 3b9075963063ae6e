"""Whatever of trimtab is imported, and in whatever order with JAX: what uses JAX has it compute in float64."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import trimtab

PACKAGE = Path(trimtab.__file__).parent
SWITCH = 'jax.config.update("jax_enable_x64", True)'
COMPUTES_NOTHING = {"trimtab.commands.output"}
"""Imports JAX only to tell it where to keep what it compiles."""


def _module_name(file):
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {_module_name(file): file for file in sorted(PACKAGE.rglob("*.py"))}


def _names(statement):
    if isinstance(statement, ast.Import):
        return [alias.name for alias in statement.names]
    if isinstance(statement, ast.ImportFrom):
        return [statement.module, *(f"{statement.module}.{alias.name}" for alias in statement.names)]
    return []


@cache
def _imports_at_once(module):
    """The modules of trimtab, and JAX, that a module imports while it is imported itself."""
    names = [n for s in ast.parse(MODULES[module].read_text(encoding="utf-8")).body for n in _names(s)]
    return {n for n in names if n in MODULES} | {"jax" for n in names if n.split(".")[0] == "jax"}


def _reach(module):
    reached, rest = set(), [module]
    while rest:
        name = rest.pop()
        if name not in reached:
            reached.add(name)
            rest += _imports_at_once(name) if name in MODULES else []
    return reached


USERS = sorted(m for m in MODULES if "jax" in _imports_at_once(m))


def test_there_are_modules_that_use_jax():
    assert len(USERS) > 100
    assert "trimtab.core.record" in USERS


@pytest.mark.parametrize("module", sorted(set(USERS) - COMPUTES_NOTHING))
def test_who_imports_jax_switches_float64_on(module):
    switches = [m for m in _reach(module) & set(MODULES) if f"\n{SWITCH}\n" in MODULES[m].read_text(encoding="utf-8")]
    assert switches, f"{module}: import trimtab.core.record, or write {SWITCH}"


RECORD = """
from trimtab.core.record import Scalar, option, quantity, record

@record
class Gains:
    k: Scalar = quantity("1", "A gain.", default=3.0)
    form: str = option("A form.", default="plain")

GAINS = Gains()
assert jax.tree.leaves(GAINS) == [3.0], jax.tree.leaves(GAINS)
slope = jax.jit(jax.grad(lambda g: g.k**2 if g.form == "plain" else 0 * g.k))(GAINS)
assert type(slope) is Gains and slope.k.dtype == "float64" and slope.k == 6.0, slope
"""
JAX = "import jax, jax.numpy as jnp\n"
FLOAT64 = "assert jnp.linspace(0.0, 1.0, 3).dtype == 'float64'\n"
ORDERS = {
    "jax, then records": JAX + RECORD + FLOAT64,
    "declarations, jax, records": "import trimtab.core.quantity, trimtab.logs.log\n" + JAX + RECORD + FLOAT64,
    "a part of the loop, then jax": "import trimtab.core.rotation\n" + JAX + FLOAT64 + RECORD,
    "the compiler, then jax": "import trimtab.compiler.function\n" + JAX + FLOAT64 + RECORD,
}


@pytest.mark.thorough
@pytest.mark.parametrize("text", ORDERS.values(), ids=ORDERS)
def test_every_order_gives_float64_and_pytrees(text):
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
