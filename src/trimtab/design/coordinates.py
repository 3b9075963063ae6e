"""Coordinates of three-dimensional motion, in which three angles replace the quaternion of the attitude.

A quaternion q_XB is recognised by its frame of two letters and its shape (4,). Vectors in the frame X are converted to
body axes, so that steady flight (a turn or a climb) is an equilibrium.

    trim_model     roll, pitch, yaw; velocities in body axes; positions unchanged; for points stated by users
    error_model    q = q_r exp(e): attitude and position relative to a reference that continues the steady flight

A vehicle without a quaternion keeps its own states in both models. This code runs offline.

Source: [1] B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft Control and Simulation", Wiley 2015, sections 3.6, 3.7,
for the states of a trim; [2] J. Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508,
chapter 5, for the error state.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion, rotation
from trimtab.core.quantity import Quantity
from trimtab.core.record import FAST_COMPILE_OPTIONS, with_leaf
from trimtab.design.model import StateSpaceModel, find_indices, input_names, real_leaves, record_vector, unpack_record

AXES = ("forward", "starboard", "down")
EULER = ("roll", "pitch", "yaw")
TURN = ("x", "y", "z")
"""Names of the components of a body's rotation relative to steady flight, about the body's axes."""
DERIVED = ("speed", "angle_of_attack", "sideslip", "climb")
"""Extra outputs of a vehicle that moves in three dimensions: airspeed (m/s), angle of attack, sideslip and climb
(rad)."""
STANDS = 1e-6
"""Limit below which flow and path angles are undefined: speed (m/s), or an angle's distance from 90 degrees (rad)."""
SAME = 1e-9
"""Largest difference (m/s, rad or m) at which a state counts as equal to a component of the vehicle's motion."""


class _StateField(NamedTuple):
    """Field of a state record, and the form of this field in the design coordinates.

    path, shape: path and shape of the field.  form: "attitude"; "velocity" or "position" in the outer frame of a
    quaternion; "body velocity"; or "plain".  attitude: path of the quaternion.
    """

    path: str
    shape: tuple[int, ...]
    form: str
    attitude: str = ""


def attitude_fields(state: Any) -> dict[str, str]:
    """Return the path of each quaternion in a state record, keyed by the quaternion's outer frame."""
    return {d.frame[0]: path for path, _, d in real_leaves(state) if _is_quaternion(d)}


def error_names(state: Any, path: str) -> tuple[str, ...]:
    """Return the names of a field's components in `error_model`; () if no real or angle field of the record has this
    path."""
    return tuple(name for leaf in _describe_leaves(state) if leaf.path == path for name in _error_names(leaf))


def state_from_trim(state: Any, values: Mapping[str, float]) -> Any:
    """Return the state record, with the named coordinates of `trim_model` set to the given values."""
    fields = _describe_leaves(state)
    names = [name for leaf in fields for name in _trim_names(leaf)]
    z = np.array(_to_trim(state, fields))
    z[find_indices("trim", values, names)] = list(values.values())
    return jax.tree.map(np.asarray, _from_trim(state, fields, jnp.asarray(z)))


def trim_model(vehicle: Any, x: Any, u: Any, *, t: float = 0.0) -> StateSpaceModel:
    """Build the vehicle's model in the coordinates in which users state steady flight, e.g. roll, pitch and yaw.

    Outputs are the states. A vehicle with a 3-D velocity also has the outputs DERIVED: airspeed in still air,
    angle of attack, sideslip and climb angle.

    Args:
        vehicle: object with `dynamics(t, x, u)`.
        x: state record at the model's operating point.
        u: input record at the model's operating point.
        t: time (s).
    """
    fields = _describe_leaves(x)
    names = tuple(name for leaf in fields for name in _trim_names(leaf))

    def to_record(z: Any) -> Any:
        return _from_trim(x, fields, z)

    def f(z: Any, us: Any) -> Any:
        state = to_record(z)
        rate = vehicle.dynamics(t, state, unpack_record(u, us))
        return jax.jvp(lambda own: _to_trim(own, fields), (_as_floats(state),), (_as_rates(state, rate),))[1]

    derived = _derived_outputs(fields)

    def h(z: Any, us: Any) -> Any:
        return jnp.concatenate([z, derived(to_record(z))]) if derived else z

    outputs = (*names, *(DERIVED if derived else ()))
    x0 = np.asarray(_evaluate_once(lambda own: _to_trim(own, fields), _as_floats(x)))
    u0 = np.asarray(record_vector(u))
    return StateSpaceModel(f, h, names, input_names(u, names), outputs, x0, u0, x, u, to_record)


def error_model(vehicle: Any, x: Any, u: Any, *, t: float = 0.0) -> StateSpaceModel:
    """Build the model of deviations from steady flight, relative to a reference that continues the flight at (x, u).

    States: rotation relative to the reference, in body axes; velocities in body axes; position relative to the
    reference, in the reference's body axes. All other states are those of `trim_model`.

    Args: as in `trim_model`.
    """
    fields, us0 = _describe_leaves(x), record_vector(u)
    names = tuple(name for leaf in fields for name in _error_names(leaf))
    start = _as_floats(x)
    drift = _evaluate_once(lambda x, u: _as_rates(x, vehicle.dynamics(t, x, u)), start, _as_floats(u))

    def to_record(z: Any) -> Any:
        return _from_error(start, fields, z)

    def f(z: Any, us: Any) -> Any:
        state = to_record(z)
        rate = _as_rates(state, vehicle.dynamics(t, state, unpack_record(u, us)))
        return jax.jvp(lambda r, own: _to_error(r, own, fields), (start, state), (drift, rate))[1]

    derived = _derived_outputs(fields)

    def h(z: Any, us: Any) -> Any:
        return jnp.concatenate([z, derived(to_record(z))]) if derived else z

    outputs = (*names, *(DERIVED if derived else ()))
    x0 = np.asarray(_evaluate_once(lambda x: _to_error(x, x, fields), start))
    return StateSpaceModel(f, h, names, input_names(u, names), outputs, x0, np.asarray(us0), x, u, to_record)


def flight_names(vehicle: Any, model: StateSpaceModel) -> dict[str, str]:
    """Return the names of speed, climb, sideslip, roll, yaw and height in `trim_model`, as far as these exist.

    For a vehicle with a quaternion, these are names of outputs and Euler angles. For any other vehicle, they are names
    of states that are equal, near the model's point, to components of the vehicle's `motion`. For several vehicles
    together, the result is empty.
    """
    fields = _describe_leaves(model.state_record)
    turns = [leaf.path for leaf in fields if leaf.form == "attitude"]

    def move(z: Any) -> Any:
        return vehicle.motion(np.int64(0), _from_trim(model.state_record, fields, z), model.input_record)

    if turns or not hasattr(vehicle, "motion") or not hasattr(move(model.x0), "v_WB_B"):
        names = {n: n for n in ("speed", "climb", "sideslip") if n in model.outputs}
        return names | {n: f"{turns[0]}.{n}" for n in ("roll", "yaw") if turns}

    def measure(z: Any) -> Any:
        motion = move(z)
        speed = jnp.linalg.norm(motion.v_WB_B)
        down = (rotation.from_euler(*motion.attitude) @ motion.v_WB_B)[2]
        up, aside = jnp.arcsin(jnp.stack([-down, motion.v_WB_B[1]]) / jnp.maximum(speed, 1e-9))
        return jnp.stack([speed, up, aside, motion.attitude[0], motion.attitude[2], -motion.p_WB[2]])

    draws = np.asarray(model.x0) + np.random.default_rng(0).uniform(-0.1, 0.1, (4, len(model.x0)))
    seen = np.asarray(_evaluate_once(jax.vmap(measure), jnp.asarray(draws)))
    same = np.abs(seen[:, :, None] - draws[:, None, :]).max(axis=0) < SAME
    words = ("speed", "climb", "sideslip", "roll", "yaw", "height")
    return {word: model.states[int(row.argmax())] for word, row in zip(words, same, strict=True) if row.any()}


def unsmooth_outputs(model: StateSpaceModel) -> dict[str, str]:
    """Return each DERIVED output that has no derivative at the model's point, with the reason."""
    derived = [n for n in DERIVED if n in model.outputs and n not in model.states]
    if model.to_record is None or not derived:
        return {}
    y = dict(zip(model.outputs, model.evaluate(model.x0, model.u0)[1].tolist(), strict=True))
    if y.get("speed", 1.0) < STANDS:
        return dict.fromkeys(derived, "the vehicle stands still")
    steep = {n: abs(abs(y.get(n, 0.0)) - np.pi / 2) < STANDS for n in ("climb", "sideslip")}
    reasons = {"climb": "the path is vertical"} if steep["climb"] else {}
    if steep["sideslip"]:
        reasons |= dict.fromkeys(("angle_of_attack", "sideslip"), "the vehicle moves straight sideways")
    return {n: why for n, why in reasons.items() if n in derived}


def _evaluate_once(function: Callable[..., Any], *inputs: Any) -> Any:
    """Compile function(*inputs) and evaluate it. This is ten times as fast as evaluation without compilation."""
    return jax.jit(function, compiler_options=FAST_COMPILE_OPTIONS)(*inputs)


def _is_quaternion(d: Quantity) -> bool:
    return d.shape == (4,) and len(d.frame) == 2 and d.unit == "1"


def _describe_leaves(x: Any) -> tuple[_StateField, ...]:
    outer = attitude_fields(x)
    fields = []
    for path, value, d in real_leaves(x):
        form = "plain"
        if _is_quaternion(d):
            form = "attitude"
        elif np.shape(value) == (3,) and d.frame in outer:
            form = "position" if d.unit == "m" else "velocity"
        elif np.shape(value) == (3,) and outer and d.frame == "B" and d.unit == "m/s":
            form = "body velocity"
        fields.append(_StateField(path, np.shape(value), form, outer.get(d.frame, next(iter(outer.values()), ""))))
    return tuple(fields)


def _entry_names(leaf: _StateField) -> list[str]:
    return [f"{leaf.path}[{i}]" for i in range(int(np.prod(leaf.shape)))] if leaf.shape else [leaf.path]


def _trim_names(leaf: _StateField) -> list[str]:
    words = {"attitude": EULER, "velocity": AXES, "body velocity": AXES}.get(leaf.form)
    return [f"{leaf.path}.{word}" for word in words] if words else _entry_names(leaf)


def _error_names(leaf: _StateField) -> list[str]:
    words = {"attitude": TURN, "velocity": AXES, "body velocity": AXES, "position": AXES}.get(leaf.form)
    return [f"{leaf.path}.{word}" for word in words] if words else _entry_names(leaf)


def _field(x: Any, path: str) -> Any:
    for name in path.split("."):
        x = x[name] if isinstance(x, dict) else getattr(x, name)
    return jnp.asarray(x, jnp.float64)


def _put(x: Any, path: str, value: Any) -> Any:
    return with_leaf(x, path, lambda _old, _d: value)


def _as_floats(x: Any) -> Any:
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float64), x)


def _as_rates(x: Any, rate: Any) -> Any:
    return jax.tree.map(lambda v, d: jnp.broadcast_to(jnp.asarray(d, jnp.float64), jnp.shape(v)), x, rate)


def _in_body(x: Any, leaf: _StateField) -> Any:
    return quaternion.to_matrix(_field(x, leaf.attitude)).T @ _field(x, leaf.path)


def _to_trim(x: Any, fields: tuple[_StateField, ...]) -> Any:
    parts = []
    for leaf in fields:
        if leaf.form == "attitude":
            parts.append(rotation.to_euler(quaternion.to_matrix(_field(x, leaf.path))))
        elif leaf.form == "velocity":
            parts.append(_in_body(x, leaf))
        else:
            parts.append(jnp.ravel(_field(x, leaf.path)))
    return jnp.concatenate(parts)


def _from_trim(like: Any, fields: tuple[_StateField, ...], z: Any) -> Any:
    values, start = {}, 0
    for leaf in fields:
        size = 3 if leaf.form == "attitude" else int(np.prod(leaf.shape))
        values[leaf.path] = z[start : start + size]
        start += size
    x = like
    for leaf in sorted(fields, key=lambda leaf: leaf.form != "attitude"):  # attitudes first, to rotate the vectors
        own = values[leaf.path]
        if leaf.form == "attitude":
            x = _put(x, leaf.path, quaternion.from_euler(*own))
        elif leaf.form == "velocity":
            x = _put(x, leaf.path, quaternion.to_matrix(_field(x, leaf.attitude)) @ own)
        else:
            x = _put(x, leaf.path, own.reshape(leaf.shape))
    return x


def _to_error(r: Any, x: Any, fields: tuple[_StateField, ...]) -> Any:
    """Return deviations of x from r in attitude and position, velocities in body axes, and plain fields unchanged."""
    parts = []
    for leaf in fields:
        if leaf.form == "attitude":
            parts.append(quaternion.local(*(quaternion.normalise(_field(own, leaf.path)) for own in (r, x))))
        elif leaf.form == "velocity":
            parts.append(_in_body(x, leaf))
        elif leaf.form == "position":
            away = _field(x, leaf.path) - _field(r, leaf.path)
            parts.append(quaternion.to_matrix(_field(r, leaf.attitude)).T @ away)
        else:
            parts.append(jnp.ravel(_field(x, leaf.path)))
    return jnp.concatenate(parts)


def _from_error(r: Any, fields: tuple[_StateField, ...], z: Any) -> Any:
    values, start = {}, 0
    for leaf in fields:
        size = 3 if leaf.form == "attitude" else int(np.prod(leaf.shape))
        values[leaf.path] = z[start : start + size]
        start += size
    x = r
    for leaf in sorted(fields, key=lambda leaf: leaf.form != "attitude"):
        own = values[leaf.path]
        if leaf.form == "attitude":
            x = _put(x, leaf.path, quaternion.retract(quaternion.normalise(_field(r, leaf.path)), own))
        elif leaf.form == "velocity":
            x = _put(x, leaf.path, quaternion.to_matrix(_field(x, leaf.attitude)) @ own)
        elif leaf.form == "position":
            x = _put(x, leaf.path, _field(r, leaf.path) + quaternion.to_matrix(_field(r, leaf.attitude)) @ own)
        else:
            x = _put(x, leaf.path, own.reshape(leaf.shape))
    return x


def _derived_outputs(fields: tuple[_StateField, ...]) -> Any:
    """Return the function from a state record to the DERIVED outputs (4,), or None without a 3-D velocity."""
    moving = [leaf for leaf in fields if leaf.form in ("velocity", "body velocity")]
    if not moving:
        return None
    leaf = moving[0]

    def measure_motion(x: Any) -> Any:
        R = quaternion.to_matrix(_field(x, leaf.attitude))
        v = R.T @ _field(x, leaf.path) if leaf.form == "velocity" else _field(x, leaf.path)
        speed2 = v @ v
        speed = jnp.where(speed2 > 0, jnp.sqrt(jnp.where(speed2 > 0, speed2, 1.0)), 0.0)
        safe = jnp.maximum(speed, 1e-9)
        attack = jnp.arctan2(v[2], jnp.where(speed > 0, v[0], 1.0))
        return jnp.stack([speed, attack, jnp.arcsin(v[1] / safe), -jnp.arcsin((R @ v)[2] / safe)])

    return measure_motion
