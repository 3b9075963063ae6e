"""Parts of trimtab that use JAX switch it to float64, in every order of imports. The compiler leaves JAX's setting."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import trimtab

PACKAGE = Path(trimtab.__file__).parent
SWITCH = 'jax.config.update("jax_enable_x64", True)'
COMPUTES_NOTHING = {"trimtab.commands.output", "trimtab.run.kept_blocks"}
"""Use JAX's settings or its trees, and compute no arrays."""


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


@cache
def _users():
    return sorted(m for m in MODULES if "jax" in _imports_at_once(m))


COMPILER = sorted(m for m in MODULES if m.startswith("trimtab.compiler."))
"""Trace inside `jax.enable_x64`, so that the user's own setting stays."""


def test_finds_the_modules_that_use_jax():
    assert len(_users()) > 100
    assert "trimtab.core.record" in _users()


@cache
def _is_switch(module):
    return f"\n{SWITCH}\n" in MODULES[module].read_text(encoding="utf-8")


def _switches(module):
    """The modules that a module imports, itself included, and that switch float64 on."""
    return [m for m in _reach(module) & set(MODULES) if _is_switch(m)]


def test_modules_that_import_jax_switch_float64_on():
    without = [m for m in _users() if m not in COMPUTES_NOTHING and m not in COMPILER and not _switches(m)]
    assert without == [], f"import trimtab.core.record, or write {SWITCH}"


def test_compiler_does_not_change_the_float64_switch():
    assert {module: _switches(module) for module in COMPILER if _switches(module)} == {}


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
FLOAT32 = FLOAT64.replace("float64", "float32")
COMPILE = "import trimtab\nassert trimtab.compile(jnp.sin, 0.5)(0.5).dtype == 'float64'\n"
ORDERS = {
    "jax, then records": JAX + RECORD + FLOAT64,
    "declarations, jax, records": "import trimtab.core.quantity, trimtab.logs.log\n" + JAX + RECORD + FLOAT64,
    "a part of the loop, then jax": "import trimtab.core.rotation\n" + JAX + FLOAT64 + RECORD,
    "a compiled function, then a record": JAX + COMPILE + FLOAT32 + RECORD + FLOAT64 + COMPILE,
}


@pytest.mark.thorough
@pytest.mark.parametrize("text", ORDERS.values(), ids=ORDERS)
def test_every_import_order_gives_float64_and_pytrees(text):
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
