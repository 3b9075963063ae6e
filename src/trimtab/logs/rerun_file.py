"""Recording of a flight for Rerun's viewer: the moving body with its path, and all signals over time.

    /world/vehicle        frame and axes of the body, in the world frame W      /world/way        path of the body
    /signals/truth/…      all signals of the log, by path, with a separate entry for each element of a vector

The axes of the scene are those of W: x north, y east, z down, as declared to Rerun.
Source: Rerun's manual, Transform3D and send_columns.
"""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, argument, install_command
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log

NAME, TIMELINE = "trimtab", "time"
SIGNALS, WORLD, BODY, WAY = "signals", "world", "world/vehicle", "world/way"
AXIS_LENGTH = 0.5
"""Length (m) of the drawn axes of the body, chosen for visibility."""
MOST_NUMBERS = 64
"""Maximum number of elements of a signal in the recording. Larger signals, e.g. of a swarm, are left out."""


def write_rerun(file: Path, log: Log, motion: Any) -> dict[str, int]:
    """Write a Rerun recording. Return the path of each entity in the recording -> number of poses or signal elements.

    Args:
        file: path that ends in .rrd. An existing file is replaced.
        log: log with the signals.
        motion: motion of the body, `run.log_motion.MotionRows`.

    Raises:
        InputError: the package rerun-sdk is missing.
    """
    rr = import_rerun()
    recording = rr.RecordingStream(NAME, recording_id=file.stem)
    recording.save(file)
    recording.log(WORLD, rr.ViewCoordinates.FRD, static=True)
    _send_body(rr, recording, motion)
    numbers = 0
    for path in log.paths:
        values = np.asarray(log[path], float)
        columns = values.reshape(len(log), -1)
        if columns.shape[1] > MOST_NUMBERS:
            continue
        times = [rr.TimeColumn(TIMELINE, duration=log.t)]
        for k, column in enumerate(columns.T):
            place = f"{SIGNALS}/{path.replace('.', '/')}" + (f"/{k}" if values.ndim > 1 else "")
            recording.send_columns(place, indexes=times, columns=rr.Scalars.columns(scalars=column))
            numbers += 1
    recording.disconnect()
    return {f"/{BODY}": len(motion.ticks), f"/{SIGNALS}": numbers}


def _send_body(rr: Any, recording: Any, motion: Any) -> None:
    """Add the moving frame of the body, its axes, and its path to the recording."""
    times = [rr.TimeColumn(TIMELINE, duration=to_seconds(motion.ticks))]
    pose = {"translation": motion.position, "quaternion": motion.attitude[:, [1, 2, 3, 0]]}
    recording.send_columns(BODY, indexes=times, columns=rr.Transform3D.columns(**pose))
    axes = AXIS_LENGTH * np.eye(3)
    colors = [[230, 60, 60], [60, 200, 60], [60, 60, 230]]
    recording.log(f"{BODY}/axes", rr.Arrows3D(vectors=axes, colors=colors), static=True)
    recording.log(WAY, rr.LineStrips3D([motion.position]), static=True)


def import_rerun() -> Any:
    """Return the package rerun. Raise InputError if the package is not installed."""
    try:
        return importlib.import_module("rerun")
    except ImportError:
        fix = f"{install_command('rerun')}; or use {argument('as', 'ros2')}, or open the log itself in Foxglove"
        raise InputError("Rerun", "needs the package 'rerun-sdk', which is not installed", fix=fix) from None
