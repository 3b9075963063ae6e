"""10 000 formulas and signals at random, their robustness by the definition, and what RTAMT says of them.

RTAMT 0.4.10 can't stand in constraints.txt: what it is made with, antlr4-python3-runtime 4.7, is none for Python 3.13.
So its numbers are kept beside this file, `rtamt.npz`: the robustness at the first row of each pair, and a checksum of
that at all rows. To write them anew, some minutes:

    python3.11 -m venv .peers/rtamt && .peers/rtamt/bin/pip install rtamt==0.4.10 numpy
    .peers/rtamt/bin/python tests/oracles/temporal_logic.py

Signals and constants are whole numbers and quarters, so that every sum is exact.
"""

import random
import zlib
from pathlib import Path
from typing import Any

import numpy as np

TABLE = Path(__file__).with_name("rtamt.npz")
PAIRS = 10_000
FUTURE, PAST = ("always", "eventually", "until"), ("historically", "once", "since")
RELATIONS = ("<", "<=", ">", ">=", "==", "!=")
UNEQUAL = {"!=": "!=="}
"""What RTAMT writes otherwise."""


class Draw:
    """Choices that are the same in every Python: made of random() alone."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed).random

    def below(self, n: int) -> int:
        """A whole number from 0 to n - 1."""
        return int(self.random() * n)

    def one_of(self, things: Any) -> Any:
        """One of some."""
        return things[self.below(len(things))]


def draw_pair(k: int) -> tuple[Any, dict[str, list[float]]]:
    """Pair k: a formula as a tree, and its signals by name, all of one length."""
    draw = Draw(k)
    m = 2 + draw.below(30)  # RTAMT 0.4.10 fails on a single row: UnboundLocalError
    signals = {name: [draw.below(41) / 4 - 5 for _ in range(m)] for name in ("x", "y")}
    return draw_formula(draw, 1 + draw.below(4)), signals


def draw_number(draw: Draw) -> Any:
    """A number that has a signal in it."""
    signal = ("signal", draw.one_of(("x", "y")))
    kind = draw.below(6)
    if kind == 0:
        return ("abs", (draw.one_of("+-"), signal, ("constant", draw.below(9) / 2)))
    if kind == 1:
        return (draw.one_of("+-"), ("signal", "x"), ("signal", "y"))
    return ("*", ("constant", 2.0), signal) if kind == 2 else signal


def draw_formula(draw: Draw, depth: int) -> Any:
    """A formula of a depth."""
    if depth == 0:
        return (draw.one_of(RELATIONS), draw_number(draw), ("constant", draw.below(25) / 4 - 3))
    word = draw.one_of(("not", "and", "or", "implies", *FUTURE, *FUTURE, *PAST, *PAST))
    below = [draw_formula(draw, draw.below(depth))]
    if word in ("and", "or", "implies", "until", "since"):
        below.append(draw_formula(draw, draw.below(depth)))
    if word not in (*FUTURE, *PAST):
        return (word, *below)
    low, more, bounded = draw.below(5), draw.below(12), draw.below(4) > 0
    return (word, (low, low + more) if bounded else None, *below)


def write_formula(tree: Any, spelling: Any = None) -> str:
    """The text of a tree, with all its brackets; times in seconds."""
    head, *rest = tree
    spelling = spelling or {}
    if head == "signal":
        return rest[0]
    if head == "constant":
        return f"(0 - {-rest[0]})" if rest[0] < 0 else str(rest[0])
    if head in ("abs", "not"):
        return f"{head}({write_formula(rest[0], spelling)})"
    interval = ""
    if head in (*FUTURE, *PAST):
        bounds, *rest = rest
        interval = f"[{bounds[0]},{bounds[1]}]" if bounds else ""
    texts = [f"({write_formula(part, spelling)})" for part in rest]
    word = spelling.get(head, head)
    return f"{word}{interval}{texts[0]}" if len(texts) == 1 else f"{texts[0]} {word}{interval} {texts[1]}"


def value_at(tree: Any, signals: dict[str, list[float]], i: int) -> float:
    """A number at row i."""
    head, *rest = tree
    if head == "signal":
        return signals[rest[0]][i]
    if head == "constant":
        return rest[0]
    numbers = [value_at(part, signals, i) for part in rest]
    if head == "abs":
        return abs(numbers[0])
    return {"+": numbers[0] + numbers[1], "-": numbers[0] - numbers[1], "*": numbers[0] * numbers[1]}[head]


def robustness_at(tree: Any, signals: dict[str, list[float]], i: int) -> float:
    """Robustness at row i by the definition, without a thought for time; rows are a second apart."""
    head, *rest = tree
    if head in RELATIONS:
        left, right = (value_at(part, signals, i) for part in rest)
        if head in ("<", "<="):
            return right - left
        return left - right if head in (">", ">=") else abs(left - right) * (-1 if head == "==" else 1)
    if head in ("not", "and", "or", "implies"):
        numbers = [robustness_at(part, signals, i) for part in rest]
        if head == "not":
            return -numbers[0]
        return min(numbers) if head == "and" else max(numbers[0] * (-1 if head == "implies" else 1), numbers[1])
    bounds, *below = rest
    low, high = bounds or (0, 10**9)
    m, way = len(signals["x"]), 1 if head in FUTURE else -1
    rows = [j for j in range(m) if low <= way * (j - i) <= high]
    if len(below) == 1:
        numbers = [robustness_at(below[0], signals, j) for j in rows]
        return min(numbers, default=np.inf) if head in ("always", "historically") else max(numbers, default=-np.inf)
    return max(
        (
            min([robustness_at(below[1], signals, j), *(robustness_at(below[0], signals, r) for r in range(i, j, way))])
            for j in rows
        ),
        default=-np.inf,
    )


def checksum(rows: Any) -> int:
    """Of the robustness at all rows; -0 is 0."""
    return zlib.crc32((np.asarray(rows, np.float64) + 0.0).tobytes())


def ask_rtamt(tree: Any, signals: dict[str, list[float]]) -> list[float]:
    """What RTAMT says at each row, in discrete time and offline."""
    import rtamt

    specification = rtamt.StlDiscreteTimeSpecification()
    for name in signals:
        specification.declare_var(name, "float")
    specification.spec = write_formula(tree, UNEQUAL)
    specification.parse()
    m = len(signals["x"])
    rows = specification.evaluate({"time": list(range(m)), **{name: list(x) for name, x in signals.items()}})
    return [float(value) for _, value in rows]


if __name__ == "__main__":
    found = [ask_rtamt(*draw_pair(k)) for k in range(PAIRS)]
    np.savez_compressed(
        TABLE,
        first=np.array([rows[0] for rows in found], np.float32),
        checksums=np.array([checksum(rows) for rows in found], np.uint32),
    )
    print(f"{PAIRS} pairs in {TABLE.name}, {TABLE.stat().st_size} bytes")
