"""Motion of a vehicle, computed by the vehicle's function `motion` from the true states in a log."""

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
    """Motion of a vehicle at n instants of a log, and the samples that an ideal IMU would measure.

    ticks: times in 100 ns (n,).  position: in the world frame W (n, 3).  attitude: quaternion q_WB, scalar first (n,
    4). velocity, rate: velocity and angular rate in the body frame B (n, 3).  specific_force: acceleration minus
    gravity, in B (n, 3). At rest it points up.
    """

    ticks: Any
    position: Any
    attitude: Any
    velocity: Any
    rate: Any
    specific_force: Any


class ImuRows(NamedTuple):
    """Samples of a three-axis IMU.

    ticks: times of measurement, in 100 ns (n,).  rate, specific_force: in the body frame B (n, 3).
    """

    ticks: Any
    rate: Any
    specific_force: Any


def read_motion(log: Log, scenario: Scenario, period: int) -> MotionRows:
    """Return the vehicle's motion during a run or flight of a scenario.

    log: log of the run or flight.  period: minimum time between the returned instants (100 ns).

    Raises:
        InputError: the log contains no true states (e.g. because an autopilot wrote it), the scenario is a swarm, or no
            C compiler is found.
    """
    block = motion_block(scenario)
    like = jax.eval_shape(block.step, block.parameters, (), block.input)[1]
    if not isinstance(like, Motion):
        raise InputError(
            "convert",
            "the log must be of one craft, but is of a swarm of several craft",
            fix="use a log of one craft",
        )
    motion = compile_block(block)
    paths = {p: _log_path(p) for p in motion.reads if p.startswith("input.")}
    missing = [path for path in paths.values() if path not in log]
    if missing:
        problem = f"the log has no signal {missing[0]!r}, so it does not contain the vehicle's true motion"
        fix = "use the vehicle's log or the log of a simulation, e.g. there/vehicle.mcap or flight/run.mcap"
        raise InputError("convert", problem, fix=fix)
    rows = choose_rows(log.ticks, period)
    columns = {p: np.asarray(log[path], float)[rows] for p, path in paths.items()}
    found = [_step(motion, int(t), {p: c[k] for p, c in columns.items()}) for k, t in enumerate(log.ticks[rows])]
    p_WB, angles, v, w, a = (np.array(part).reshape(-1, 3) for part in zip(*found, strict=True))
    q = np.array([quaternion(attitude) for attitude in angles])
    R = rotation_matrices(q)
    return MotionRows(log.ticks[rows], p_WB, q, v, w, a - STANDARD * R[:, 2, :])


def _log_path(path: str) -> str:
    """Return the log path of the signal that the block "motion" reads at one of its inputs."""
    name = path.removeprefix("input.")
    return f"actuators.{name}" if name.startswith("u.") or name == "u" else name


def _step(motion: Any, t: int, values: Mapping[str, Any]) -> list[Any]:
    motion.set_inputs({"t": t, **values})
    motion.step()
    return [motion.result(n).tolist() for n in ("p_WB", "attitude", "v_WB_B", "w_WB_B", "a_WB_B")]


def choose_rows(ticks: Any, period: int) -> Any:
    """Return the indices of log rows whose times are at least a period apart. The first row is always included.

    ticks: times of the rows (100 ns).  period: in 100 ns.
    """
    rows, due = list[int](), -(2**62)
    for k, t in enumerate(ticks.tolist()):
        if t >= due:
            rows.append(k)
            due = t + period
    return np.array(rows, int)


def read_imus(log: Log) -> dict[str, ImuRows]:
    """Return the samples of each three-axis IMU in a log, by the sensor's name. Repeated samples are left out."""
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
