"""Measure the effect of the servo frame on a hovercraft with pulse outputs (docs page, Servo pulses).

python benchmarks/servo_frame.py                  1000 runs per row: a minute
python benchmarks/servo_frame.py --runs 100       a quick look

Each row has the same random draws, so that differences have narrower intervals than errors. Both uplinks have a delay
of 40 ms. The uplink of the thesis accepts a command every 20 ms, the other every 1 ms.
"""

import argparse

import numpy as np

from trimtab import Campaign, build
from trimtab.analysis.campaign.statistics.intervals import mean, quantile

SCENARIO, METRIC = "hovercraft/spin", "error_rms:yaw_rate"
QUICK = {"world.uplink.period": "1 ms", "world.uplink.steps": "40"}
ROWS = [
    *(("1 ms", QUICK, f"{frame} ms") for frame in (1, 5, 20, 40, 80, 160)),
    *(("20 ms", {}, f"{frame} ms") for frame in (1, 20)),
]


def fly(settings: dict[str, str], frame: str, runs: int) -> np.ndarray:
    """Return the yaw-rate error of each run."""
    scenario = build(SCENARIO, {**settings, "world.actuators.frame": frame})
    return np.asarray(Campaign(scenario, runs=runs, seed=0, metrics=[METRIC]).run().columns[METRIC])


def main() -> None:
    """Print the median error for each uplink and frame, and the mean increase relative to the first row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    runs = parser.parse_args().runs
    print(
        f"{'command each':>12}  {'frame':>6}  {'yaw rate, RMS error (rad/s)':>28}  {'more than the first (rad/s)':>32}"
    )
    first = None
    for uplink, settings, frame in ROWS:
        errors = fly(settings, frame, runs)
        is_first, first = first is None, errors if first is None else first
        median, more = quantile(errors, 0.5), mean(errors - first)
        told = f"{median.value:.4f} ({median.low:.4f} to {median.high:.4f})"
        difference = f"{more.value:+.5f} ({more.low:+.5f} to {more.high:+.5f})" if not is_first else ""
        print(f"{uplink:>12}  {frame:>6}  {told:>28}  {difference:>32}", flush=True)


if __name__ == "__main__":
    main()
