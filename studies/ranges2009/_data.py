"""Plaza1 and Plaza2 as logs of trimtab.

Contents of the files, and corrections to them:

- Positions x, y are taken as east, north. Headings are measured from x to y in the files, from north to east here.
- Each odometry reading has a distance and an angle since the previous reading. The distance is never negative, even if
  the vehicle backs up.
- Plaza1's ranges come in three pieces that overlap by a minute each, so they are sorted. If two ranges have the same
  time, the second is moved by 100 ns.
- The heading of Plaza2's ground truth points backwards, so half a turn is added.
- The truth is given at the times of the odometry.
"""

import functools
import importlib.util
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.io import loadmat

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import UNITS_PER_SECOND
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.samples import SampleSeries, log_samples

NAMES = ("Plaza1", "Plaza2")
OTHER = {"Plaza1": "Plaza2", "Plaza2": "Plaza1"}
HEADING_OFFSET = {"Plaza1": 0.0, "Plaza2": math.pi}
"""Correction (rad) added to the heading of the ground truth."""


class Plaza(NamedTuple):
    """Data of a log in the frames of this package. Times are in s from the first truth.

    t: times of truth and odometry (n,).  north, east, heading: truth (n,).
    distance, turn: odometry, summed since the first reading (n,).
    range_t, beacon, range: time, beacon and length of each range (m,).  beacons: positions (4, 3) in m.
    ids: radio of each beacon.
    """

    t: Any
    north: Any
    east: Any
    heading: Any
    distance: Any
    turn: Any
    range_t: Any
    beacon: Any
    range: Any
    beacons: Any
    ids: tuple[int, ...]


def data_folder() -> Path:
    """Return gtsam's folder of example data, without importing gtsam."""
    spec = importlib.util.find_spec("gtsam")
    folders = list(spec.submodule_search_locations or ()) if spec is not None else []
    if not folders:
        fix = 'pip install "trimtab[data]"'
        raise InputError("study 'ranges2009'", "its logs are in the package gtsam, which is not installed", fix=fix)
    return Path(folders[0]) / "Data"


@functools.cache
def read_plaza(name: str) -> Plaza:
    """Read Plaza1 or Plaza2 from its file."""
    held = loadmat(data_folder() / f"{name}_.mat")
    truth, odometry, ranges, radios = (np.asarray(held[key], float) for key in ("GT", "DR", "TD", "TL"))
    radios = radios[np.argsort(radios[:, 0])]
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    ids = tuple(int(i) for i in radios[:, 0])
    heading = math.pi / 2 - np.unwrap(truth[:, 3] + HEADING_OFFSET[name])
    heading = heading - 2 * math.pi * round(heading[0] / (2 * math.pi))
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(odometry[:, 1:3], axis=0)])
    begin = truth[0, 0]
    return Plaza(
        t=truth[:, 0] - begin,
        north=truth[:, 2],
        east=truth[:, 1],
        heading=heading,
        distance=total[:, 0],
        turn=-total[:, 1],
        range_t=ranges[:, 0] - begin,
        beacon=np.searchsorted(radios[:, 0], ranges[:, 2]),
        range=ranges[:, 3],
        beacons=np.stack([radios[:, 2], radios[:, 1], np.zeros(len(radios))], axis=1),
        ids=ids,
    )


def plaza_log(name: str) -> Log:
    """Return the data as a log: samples of `odometry` and `ranging`, and the truth."""
    p = read_plaza(name)
    arrived = np.arange(len(p.ids)) == p.beacon[:, None]
    metre, radian = (
        Quantity("m", "Distance driven since the first reading."),
        Quantity("rad", "Angle turned since the first reading."),
    )
    odometry = SampleSeries(_ticks(p.t), {"distance": p.distance, "turn": p.turn}, {"distance": metre, "turn": radian})
    ranging = SampleSeries(
        _ticks(p.range_t),
        {"range": np.where(arrived, p.range[:, None], 0.0), "arrived": arrived},
        {
            "range": Quantity("m", "Range to each radio; 0 if none arrived."),
            "arrived": Quantity("1", "True for each range that arrived."),
        },
    )
    truth = SampleSeries(
        _ticks(p.t),
        {"heading": p.heading, "north": p.north, "east": p.east},
        {
            "heading": Quantity("rad", "Heading from north to the vehicle's x axis, unwrapped.", kind="angle"),
            "north": Quantity("m", "Position, north.", frame="W"),
            "east": Quantity("m", "Position, east.", frame="W"),
        },
    )
    about: Mapping[str, Any] = {"name": name, "radios": p.ids, "source": "gtsam/Data"}
    return log_samples({"odometry": odometry, "ranging": ranging}, truth, about)


@functools.cache
def written_log(name: str, folder: Path) -> Log:
    """Return the log of a data set, written to a file and read back, as for a replay."""
    return read_mcap(write_mcap(plaza_log(name), folder / f"{name}.mcap"))


def _ticks(seconds: Any) -> Any:
    """Return times as integer ticks, each at least one tick after the previous one."""
    ticks, order = np.round(seconds * UNITS_PER_SECOND).astype(np.int64), np.arange(len(seconds))
    return np.maximum.accumulate(ticks - order) + order
