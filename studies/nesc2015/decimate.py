"""Make data/ from NASA's own files: one row per second of each simulation, with the signals that most of them give.

    python -m studies.nesc2015.decimate FOLDER

FOLDER is `Atmospheric_checkcases` of NASA's archive, with one folder per case. Numbers are written to ten figures in
NASA's units, without interpolation.
"""

import csv
import re
import sys
from pathlib import Path

from studies.nesc2015._data import DATA, SIGNALS

STEP, NEAR = 1.0, 2e-3
"""Time between two kept rows (s), and largest distance (s) of a row from a multiple of that time."""


def decimate(folder: Path, case: str) -> list[list[str]]:
    """Return the rows of one case: simulation, time, SIGNALS.

    A field is empty if a simulation does not give the signal.
    """
    rows = []
    for file in sorted(folder.glob(f"Atmos_{case}_*/Atmos_{case}_sim_*.csv")):
        simulation = re.sub(r".*_sim_(\d+)\.csv", r"\1", file.name)
        with file.open(encoding="utf-8", newline="") as lines:
            table = list(csv.reader(lines))
        heading = [name.strip() for name in table[0]]
        kept = -1
        for row in table[1:]:
            if len(row) < len(heading):
                continue
            t = float(row[0])
            if abs(t - round(t / STEP) * STEP) > NEAR or round(t / STEP) == kept:
                continue
            kept = round(t / STEP)
            found = dict(zip(heading, row, strict=False))
            values = [f"{float(found[s]):.10g}" if s in found else "" for s in SIGNALS]
            rows.append([simulation, f"{kept * STEP:g}", *values])
    return rows


def main() -> None:
    """Write one file to data/ for each case in FOLDER."""
    folder = Path(sys.argv[1])
    for place in sorted(folder.glob("Atmos_*")):
        case = place.name.split("_")[1]
        rows = decimate(folder, case)
        if rows:
            with (DATA / f"{case}.csv").open("w", encoding="utf-8", newline="") as out:
                csv.writer(out, lineterminator="\n").writerows([["simulation", "time", *SIGNALS], *rows])


if __name__ == "__main__":
    main()
