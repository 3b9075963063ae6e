"""Write the tables of the oracles anew: `python tests/oracles/write.py` (some minutes), from anywhere."""

import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "tests"))

HYPERSONIC = ROOT / "studies" / "hypersonic2022" / "oracle.txt"
HEADER = "# By tests/oracles, which share no code with the package; written by tests/oracles/write.py. Name, numbers.\n"


def write_values(file: Path, values: dict[str, Any]) -> None:
    """One line a name; twelve figures."""
    lines = [f"{name} {' '.join(_figures(v) for v in np.ravel(value))}\n" for name, value in values.items()]
    file.write_text(HEADER + "".join(lines), encoding="utf-8")


def _figures(value: Any) -> str:
    return str(int(value)) if isinstance(value, bool | np.bool_) else f"{float(value):.12g}"


def read_values(file: Path) -> dict[str, Any]:
    """Name -> numbers (n,)."""
    lines = [line.split() for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return {name: np.array([float(n) for n in numbers]) for name, *numbers in lines}


if __name__ == "__main__":
    from oracles.hypersonic_values import flown_values, quick_values

    write_values(HYPERSONIC, quick_values() | flown_values())
