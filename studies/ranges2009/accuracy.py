"""Error of the filters relative to the ground truth, compared with gtsam's batch solution.

At every instant the batch solution uses all ranges of the drive, while a filter uses only those that have arrived. So
each filter is compared with two kinds of batch: the whole drive, and all data up to each of 24 instants. Both have the
filter's model, and the filter's tuning from the other log. The lagged filter estimates the position 4 to 5 s ago.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.ranges2009._data import NAMES, read_plaza
from studies.ranges2009._flights import CAUSAL, FILTERS, compare_causal, fly, read_batch
from studies.ranges2009._pictures import draw_way
from trimtab.study import Row, at_most, direction, within

SECTION = "data sets, part 2"
PLACE = "tests/oracles/ranges2009.py"
HINDSIGHT = (
    "The filter has no later data. By its own model, its sigma is {bound:.2f} times the whole-drive batch's. "
    "Compared with batches of the same data, it is as good."
)
ERRORS = {("Plaza1", "tight"): 0.268, ("Plaza1", "particle"): 0.268}
ERRORS |= {("Plaza1", "lagged"): 0.221, ("Plaza2", "lagged"): 0.221}
ERRORS |= {("Plaza2", "tight"): 0.309, ("Plaza2", "particle"): 0.323}
"""(Log, filter) -> measured rms error (m)."""


def rows() -> Iterator[Row]:
    """Yield the errors, and their ratios to the errors of the batches."""
    for name in NAMES:
        batch = read_batch()[name]
        for kind in FILTERS:
            flight = fly(name, kind)
            what = f"{name}, {kind} filter"
            yield within(
                f"{name}/{kind}/rms", f"{what}: horizontal error", ERRORS[name, kind], flight.rms, "[1] the data",
                tolerance=0.03 if kind == "particle" else 0.002, unit="m", basis="own",
            )  # fmt: skip
            yield at_most(
                f"{name}/{kind}/batch", f"{what}: error / whole-drive batch's", 1.2, flight.rms / batch["rms"],
                PLACE, high=1.2, basis="reference", must_hold=kind not in CAUSAL,
                note=HINDSIGHT.format(bound=flight.sigma / batch["sigma"]) if kind in CAUSAL else "",
            )  # fmt: skip
            if kind not in CAUSAL:
                continue
            causal = compare_causal(name, flight)
            yield at_most(
                f"{name}/{kind}/causal", f"{what}: error / that of past-data batches", 1.2,
                causal.filter_rms / causal.batch_rms, PLACE, high=1.2, basis="reference",
            )  # fmt: skip
            yield at_most(
                f"{name}/{kind}/difference", f"{what}: difference from these batches", 0.1, causal.difference, PLACE,
                high=0.1, unit="m", basis="reference", note="Only the filter linearises at past estimates.",
            )  # fmt: skip
        yield direction(
            f"{name}/plain", f"{name}: gtsam's own factors, ranges not scaled", "worse", batch["plain_rms"], PLACE,
            above=1.0, unit="m", basis="reference", note="The scale error dominates: 7 % of 80 m are 5 m.",
        )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot the paths of truth, filters and batch."""
    for name in NAMES:
        flights = {kind: fly(name, kind) for kind in FILTERS}
        yield draw_way(folder / f"way-{name}.png", name, read_plaza(name), flights, read_batch()[name])
