"""Error of the filters over the ground truth, beside gtsam's batch solution.

The batch solution knows all ranges of the drive at every instant of it; a filter those that have come. So each is held
against two batches: that of the whole drive, and those of all that had come by 24 instants. Both have the filter's
model and its tuning, which is of the other log. The lagged filter gives the place of 4 to 5 s ago.
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
    "It does not know what comes later: by the model itself its sigma is {bound:.2f} times that of the whole drive. "
    "Over batches that know no more than it does, it is as good."
)
ERRORS = {("Plaza1", "tight"): 0.268, ("Plaza1", "particle"): 0.268}
ERRORS |= {("Plaza1", "lagged"): 0.221, ("Plaza2", "lagged"): 0.221}
ERRORS |= {("Plaza2", "tight"): 0.309, ("Plaza2", "particle"): 0.323}
"""Measured errors (m)."""


def rows() -> Iterator[Row]:
    """Yield errors, and ratios to the batches."""
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
                f"{name}/{kind}/batch", f"{what}: over the batch of the whole drive", 1.2, flight.rms / batch["rms"],
                PLACE, high=1.2, basis="reference", must_hold=kind not in CAUSAL,
                note=HINDSIGHT.format(bound=flight.sigma / batch["sigma"]) if kind in CAUSAL else "",
            )  # fmt: skip
            if kind not in CAUSAL:
                continue
            causal = compare_causal(name, flight)
            yield at_most(
                f"{name}/{kind}/causal", f"{what}: over batches of what had come", 1.2,
                causal.filter_rms / causal.batch_rms, PLACE, high=1.2, basis="reference",
            )  # fmt: skip
            yield at_most(
                f"{name}/{kind}/difference", f"{what}: away from these batches", 0.1, causal.difference, PLACE,
                high=0.1, unit="m", basis="reference", note="A filter is linear where it was, the batch where it ends.",
            )  # fmt: skip
        yield direction(
            f"{name}/plain", f"{name}: gtsam's own factors, ranges as they are", "worse", batch["plain_rms"], PLACE,
            above=1.0, unit="m", basis="reference", note="7 % of 80 m are 5 m: the scale is what counts.",
        )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot the path: truth, filters, batch."""
    for name in NAMES:
        flights = {kind: fly(name, kind) for kind in FILTERS}
        yield draw_way(folder / f"way-{name}.png", name, read_plaza(name), flights, read_batch()[name])
