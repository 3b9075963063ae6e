"""The oracles import nothing of the package, and what their tables hold is what they give."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

from oracles.write import HYPERSONIC, read_values

FOLDER = Path(__file__).parent
ALLOWED = {"oracles", "numpy", "scipy", "gtsam", "rtamt", *sys.stdlib_module_names} - {"importlib", "runpy"}


@pytest.mark.parametrize("file", [f for f in sorted(FOLDER.glob("*.py")) if not f.name.startswith("test_")], ids=str)
def test_oracles_import_only_numpy_scipy_and_peers(file):
    tree, names = ast.parse(file.read_text(encoding="utf-8")), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names.add((node.module or "").partition(".")[0])
        elif isinstance(node, ast.Name):
            assert node.id not in ("__import__", "exec", "eval")
    assert names <= ALLOWED


ROUNDINGS = {"-h": np.spacing(9e4), "-V": np.spacing(8e3)}
"""An error of altitude (ft) or speed (ft/s) is a difference of two such numbers, and known to a rounding of theirs."""


def differences(table, values):
    """Names of which the table holds something else."""
    found = []
    for name, value in values.items():
        new = np.ravel(np.asarray(value, dtype=float))
        off = max(1e-18, 1e-6 * float(np.abs(new).max()), ROUNDINGS.get(name[-2:], 0.0))
        if name not in table or table[name].shape != new.shape or np.abs(table[name] - new).max() > off:
            found.append(name)
    return found


@pytest.mark.thorough
def test_hypersonic_table_matches_oracle_values():
    from oracles.hypersonic_values import quick_values

    values, table = quick_values(), read_values(HYPERSONIC)
    assert len(values) > 80
    assert differences(table, values) == []
    name, value = next(iter(values.items()))
    assert differences(table, {name: value * (1 + 1e-5)}) == [name], "the comparison itself can fail"


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_hypersonic_table_matches_oracle_flights():
    from oracles.hypersonic_values import flown_values, quick_values

    values, table = flown_values(), read_values(HYPERSONIC)
    assert differences(table, values) == []
    assert set(table) == set(values) | set(quick_values()), "a name is left over"
