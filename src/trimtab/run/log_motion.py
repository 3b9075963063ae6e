"""Motion of a vehicle, computed from the true state in each row of its log by the vehicle's function `motion`."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.compiled_block import compile_block
from trimtab.core.errors import InputError
from trimtab.core.signals import Motion
from trimtab.environment.geodetic import STANDARD
from trimtab.logs.frames import quaternion
from trimtab.logs.log import Log
from trimtab.logs.spatial import rotation_matrices
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import motion_block

FORCE, RATE = ".value.specific_force", ".value.angular_rate"


class MotionRows(NamedTuple):
    """Motion of a vehicle at n instants of its log, with the samples of an ideal IMU.

    ticks: time in 100 ns (n,).  position: in W (n, 3).  attitude: quaternion q_WB, scalar first (n, 4).  velocity,
    rate: in B (n, 3).  specific_force: acceleration minus gravity, in B (n, 3). At rest it points up.
    """

    ticks: Any
    position: Any
    attitude: Any
    velocity: Any
    rate: Any
    specific_force: Any


class ImuRows(NamedTuple):
    """Samples of a three-axis IMU. ticks: times of measurement, 100 ns (n,).  rate, specific_force: in B (n, 3)."""

    ticks: Any
    rate: Any
    specific_force: Any


def read_motion(log: Log, scenario: Scenario, period: int) -> MotionRows:
    """Return the vehicle's motion from a log of this scenario, with at most one row per `period` (100 ns).

    Raises:
        InputError: the log has no true state (e.g. it is an autopilot's log) or is of a swarm, or no C compiler is
            found.
    """
    block = motion_block(scenario)
    like = jax.eval_shape(block.step, block.parameters, (), block.input)[1]
    if not isinstance(like, Motion):
        raise InputError(
            "convert",
            "the log must be of one craft, but is of a swarm of several craft",
            fix="give a log of one craft",
        )
    motion = compile_block(block)
    paths = {p: _log_path(p) for p in motion.reads if p.startswith("input.")}
    missing = [path for path in paths.values() if path not in log]
    if missing:
        problem = f"the log has no {missing[0]!r}, so it does not contain the vehicle's true motion"
        fix = "give the log of the vehicle or of a run: there/vehicle.mcap, flight/run.mcap"
        raise InputError("convert", problem, fix=fix)
    rows = choose_rows(log.ticks, period)
    columns = {p: np.asarray(log[path], float)[rows] for p, path in paths.items()}
    found = [_step(motion, int(t), {p: c[k] for p, c in columns.items()}) for k, t in enumerate(log.ticks[rows])]
    p_WB, angles, v, w, a = (np.array(part).reshape(-1, 3) for part in zip(*found, strict=True))
    q = np.array([quaternion(attitude) for attitude in angles])
    R = rotation_matrices(q)
    return MotionRows(log.ticks[rows], p_WB, q, v, w, a - STANDARD * R[:, 2, :])


def _log_path(path: str) -> str:
    """Return the path in the log of an input of the block "motion"."""
    name = path.removeprefix("input.")
    return f"actuators.{name}" if name.startswith("u.") or name == "u" else name


def _step(motion: Any, t: int, values: Mapping[str, Any]) -> list[Any]:
    motion.set_inputs({"t": t, **values})
    motion.step()
    return [motion.result(n).tolist() for n in ("p_WB", "attitude", "v_WB_B", "w_WB_B", "a_WB_B")]


def choose_rows(ticks: Any, period: int) -> Any:
    """Return the indices of rows whose times are at least a period apart. The first row is always included."""
    rows, due = list[int](), -(2**62)
    for k, t in enumerate(ticks.tolist()):
        if t >= due:
            rows.append(k)
            due = t + period
    return np.array(rows, int)


def read_imus(log: Log) -> dict[str, ImuRows]:
    """Return the samples of each three-axis IMU, by the sensor's name. Repeated samples are left out."""
    imus = dict[str, ImuRows]()
    for path in log.paths:
        name = path.removeprefix("sensors.").removesuffix(FORCE)
        head = f"sensors.{name}"
        if path != head + FORCE or head + RATE not in log or log[path].shape[1:] != (3,):
            continue
        times, valid = log[f"{head}.t"], log[f"{head}.valid"]
        new = np.flatnonzero(valid & np.concatenate([[True], np.diff(times) != 0]))
        imus[name] = ImuRows(times[new], log[head + RATE][new], log[path][new])
    return imus
