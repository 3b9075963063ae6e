"""Rows of basis "reference": what is computed beside what tests/oracles give for the same, from the table oracle.txt.

The oracles share no code with this package; `python tests/oracles/write.py` writes the table, and tests hold that it is
what they give.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.study import Row, same, within

TABLE = Path(__file__).parent / "oracle.txt"
DIGITS = 1e-7
"""Relative tolerance of two programs that solve the same equations: searches stop before rounding."""


@cache
def oracle_values() -> dict[str, Any]:
    """Return name -> numbers (n,)."""
    lines = [line.split() for line in TABLE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return {name: np.array([float(n) for n in numbers]) for name, *numbers in lines}


def oracle_number(name: str, part: int = 0) -> float:
    """Return one number of the table."""
    return float(oracle_values()[name][part])


def oracle_poles(name: str) -> Any:
    """Return complex numbers of the table, imaginary parts not negative."""
    real, imaginary = oracle_values()[name].reshape(-1, 2).T
    return real + 1j * imaginary


def reference(id: str, what: str, computed: Any, citation: str, *, name: str = "", part: int = 0, **about: Any) -> Row:
    """Return a row against the oracle's number of the same id, or another name, within DIGITS by default."""
    about = {"basis": "reference", **about}
    if "tolerance" not in about and "relative" not in about:
        about["relative"] = DIGITS
    return within(id, what, oracle_number(name or id, part), computed, citation, **about)


def reference_flag(id: str, what: str, computed: Any, citation: str, *, name: str = "", **about: Any) -> Row:
    """Return a row of a condition against the oracle's."""
    expected = bool(oracle_number(name or id))
    return same(id, what, expected, bool(computed), citation, **{"basis": "reference", **about})


def reference_seeds(
    id: str, what: str, computed: Any, citation: str, *, name: str = "", part: int = 0, **about: Any
) -> Row:
    """Mean over our seeds (n,) beside the mean over the oracle's 40: four times the deviation of their difference.

    The noise is drawn by another generator, so only its statistics can agree.
    """
    numbers = oracle_values()[name or id].reshape(2, -1)[:, part]
    mean, deviation = float(numbers[0]), float(numbers[1])
    computed = np.asarray(computed)
    tolerance = 4 * deviation * float(np.sqrt(1 / 40 + 1 / len(computed)))
    return within(id, what, mean, computed.mean(), citation, tolerance=tolerance, **{"basis": "reference", **about})


def pole_error(poles: Any, name: str) -> float:
    """Return the largest distance of the oracle's poles to the nearest computed one."""
    return max(float(np.abs(np.asarray(poles) - p).min()) for p in oracle_poles(name))
