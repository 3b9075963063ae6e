"""Rows of basis "reference": values compared with those of tests/oracles, from the table oracle.txt.

The oracles share no code with this package. `python tests/oracles/write.py` writes the table, and tests check that the
table matches the oracles.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.study import Row, same, within

TABLE = Path(__file__).parent / "oracle.txt"
DIGITS = 1e-7
"""Relative tolerance between two programs that solve the same equations.

It covers the tolerance of iterative searches.
"""


@cache
def oracle_values() -> dict[str, Any]:
    """Return the oracles' table: name -> numbers (n,)."""
    lines = [line.split() for line in TABLE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return {name: np.array([float(n) for n in numbers]) for name, *numbers in lines}


def oracle_number(name: str, part: int = 0) -> float:
    """Return one number of the oracles' table."""
    return float(oracle_values()[name][part])


def oracle_poles(name: str) -> Any:
    """Return the poles with this name in the oracles' table: those without negative imaginary part."""
    real, imaginary = oracle_values()[name].reshape(-1, 2).T
    return real + 1j * imaginary


def reference(id: str, what: str, computed: Any, citation: str, *, name: str = "", part: int = 0, **about: Any) -> Row:
    """Return a row that compares with the oracle's number of this id, or of `name`, within DIGITS by default."""
    about = {"basis": "reference", **about}
    if "tolerance" not in about and "relative" not in about:
        about["relative"] = DIGITS
    return within(id, what, oracle_number(name or id, part), computed, citation, **about)


def reference_flag(id: str, what: str, computed: Any, citation: str, *, name: str = "", **about: Any) -> Row:
    """Return a row that compares a condition with the oracle's verdict."""
    expected = bool(oracle_number(name or id))
    return same(id, what, expected, bool(computed), citation, **{"basis": "reference", **about})


def reference_seeds(
    id: str, what: str, computed: Any, citation: str, *, name: str = "", part: int = 0, **about: Any
) -> Row:
    """Return a row for the mean over n seeds, within 4 standard errors of the difference from the oracle's mean.

    The noise is drawn by another generator, so only its statistics can agree.
    """
    numbers = oracle_values()[name or id].reshape(2, -1)[:, part]
    mean, deviation = float(numbers[0]), float(numbers[1])
    computed = np.asarray(computed)
    tolerance = 4 * deviation * float(np.sqrt(1 / 40 + 1 / len(computed)))
    return within(id, what, mean, computed.mean(), citation, tolerance=tolerance, **{"basis": "reference", **about})


def pole_error(poles: Any, name: str) -> float:
    """Return the largest distance of an oracle's pole from the nearest computed pole."""
    return max(float(np.abs(np.asarray(poles) - p).min()) for p in oracle_poles(name))
