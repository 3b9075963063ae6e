"""State-space models of a vehicle, or of any x' = f(x, u), y = h(x, u): functions of vectors with named entries.

All design tools use this form, so that they work for any vehicle. This code runs offline.

Source: this module; the form is that of A. Isidori, "Nonlinear Control Systems", Springer 1995, chapter 5.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument_name
from trimtab.core.record import FAST_COMPILE_OPTIONS, Quantity, is_record, leaves, with_leaf
from trimtab.core.suggestions import closest

Function = Callable[[Any, Any], Any]
"""Function from (x (n,), u (m,)) to a vector, traceable by jax."""


class StateSpaceModel(NamedTuple):
    """Model x' = f(x, u), y = h(x, u), with the names of all entries.

    f: (x (n,), u (m,)) -> x' (n,).  h: (x, u) -> y (p,).  states, inputs, outputs: names.  x0, u0: the model's
    reference point.  state_record, input_record: records with the layout of the vectors, or None.  to_record: function
    from the state vector to the record, if the vector is in other coordinates than the record (`design.coordinates`),
    or None.
    """

    f: Function
    h: Function
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    x0: Any
    u0: Any
    state_record: Any = None
    input_record: Any = None
    to_record: Callable[[Any], Any] | None = None

    def state(self, x: Any) -> Any:
        """Convert the state vector (n,) to the vehicle's state record; return the vector if the model has no record."""
        if self.to_record is not None:
            return jax.jit(self.to_record, compiler_options=FAST_COMPILE_OPTIONS)(jnp.asarray(x))
        return x if self.state_record is None else unpack_record(self.state_record, x)

    def input(self, u: Any) -> Any:
        """Convert the input vector (m,) to the vehicle's input record; return the vector if the model has no record."""
        return u if self.input_record is None else unpack_record(self.input_record, u)

    def keep(self, inputs: Iterable[str] = (), outputs: Iterable[str] = ()) -> "StateSpaceModel":
        """Return the model with only the given inputs and outputs; all by default. Other inputs are held at u0."""
        j = np.array(find_indices(argument_name("inputs"), tuple(inputs) or self.inputs, self.inputs))
        k = np.array(find_indices(argument_name("outputs"), tuple(outputs) or self.outputs, self.outputs))
        held, f, h = jnp.asarray(self.u0), self.f, self.h
        return self._replace(
            f=lambda x, u: f(x, held.at[j].set(u)),
            h=lambda x, u: h(x, held.at[j].set(u))[k],
            inputs=tuple(self.inputs[i] for i in j),
            outputs=tuple(self.outputs[i] for i in k),
            u0=np.asarray(self.u0)[j],
            input_record=None,
        )

    def evaluate(self, x: Any, u: Any) -> tuple[Any, Any]:
        """Return x' (n,) and y (p,) at one point, as numpy arrays."""
        rates, outputs = compile_functions(self.f, self.h)(jnp.asarray(x), jnp.asarray(u))
        return np.asarray(rates), np.asarray(outputs)

    def slopes(self, x: Any, u: Any) -> tuple[Any, Any, Any, Any]:
        """Return A = df/dx, B = df/du, C = dh/dx, D = dh/du at one point, as numpy arrays."""
        (A, B), (C, D) = compile_slopes(self.f, self.h)(jnp.asarray(x), jnp.asarray(u))
        return np.asarray(A), np.asarray(B), np.asarray(C), np.asarray(D)

    def point(self, x: Any = None, u: Any = None) -> tuple[Any, Any]:
        """Return state and input as finite vectors. Each may be a vector, a record, changes to x0 or u0, or None."""
        pairs = ((x, self.x0, self.states, "state"), (u, self.u0, self.inputs, "input"))
        vectors = [_as_vector(value, start, labels, what) for value, start, labels, what in pairs]
        return vectors[0], vectors[1]


@lru_cache(maxsize=32)
def compile_functions(f: Function, h: Function) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Return the function (x, u) -> f, h. It is compiled once per model."""
    return jax.jit(lambda x, u: (f(x, u), h(x, u)), compiler_options=FAST_COMPILE_OPTIONS)


@lru_cache(maxsize=32)
def compile_slopes(f: Function, h: Function) -> Callable[[Any, Any], Any]:
    """Return the function (x, u) -> (df/dx, df/du), (dh/dx, dh/du). It is compiled once per model."""
    slopes = [jax.jacfwd(function, argnums=(0, 1)) for function in (f, h)]
    return jax.jit(lambda x, u: tuple(slope(x, u) for slope in slopes), compiler_options=FAST_COMPILE_OPTIONS)


def entry_names(value: Any) -> tuple[str, ...]:
    """Return the name of each entry of a record's vector, e.g. ("surge_velocity", "position[0]", "heading")."""
    names: list[str] = []
    for path, old, _ in real_leaves(value):
        names += [path] if np.ndim(old) == 0 else [f"{path}[{i}]" for i in range(int(np.size(old)))]
    return tuple(names)


def input_names(value: Any, states: Sequence[str]) -> tuple[str, ...]:
    """Return the name of each entry of an input record, e.g. "rudder", or "u.rudder" if a state is named "rudder"."""
    return tuple(f"u.{name}" if name in states else name for name in entry_names(value))


def record_vector(value: Any) -> Any:
    """Return the real numbers and angles of a record as one vector, in declared order."""
    if not entry_names(value):
        raise InputError("vector", f"{type(value).__name__} has no real fields", fix="give a state or an input record")
    return jnp.concatenate([jnp.ravel(jnp.asarray(v, jnp.float64)) for _, v, _ in real_leaves(value)])


def unpack_record(like: Any, values: Any) -> Any:
    """Return a copy of the record `like` whose real numbers and angles are set from a vector (n,). Angles are not
    wrapped."""
    start, record = 0, like
    for path, old, _ in real_leaves(like):
        size = int(np.size(old))
        new = values[start : start + size].reshape(np.shape(old))
        start += size
        record = with_leaf(record, path, lambda _old, _d, new=new: new)
    return record


def model_of_functions(
    f: Function,
    states: Sequence[str],
    inputs: Sequence[str],
    *,
    h: Function | None = None,
    outputs: Sequence[str] | None = None,
    x0: Any = None,
    u0: Any = None,
) -> StateSpaceModel:
    """Create a model from functions of vectors.

    Args:
        f: the derivative, (x (n,), u (m,)) -> x' (n,).
        states: names of the n states.
        inputs: names of the m inputs.
        h: the outputs, (x, u) -> y (p,); default: all states.
        outputs: names of the p outputs; default: "y0", "y1", …, or the states' names if h is not given.
        x0: state at the model's reference point (n,); default: zeros.
        u0: input at the model's reference point (m,); default: zeros.
    """
    x = np.zeros(len(states)) if x0 is None else np.asarray(x0, float)
    u = np.zeros(len(inputs)) if u0 is None else np.asarray(u0, float)
    if h is None:
        h, outputs = _whole_state, (states if outputs is None else outputs)
    _check_length("states", states, "x0", np.shape(x))
    _check_length("inputs", inputs, "u0", np.shape(u))
    _check_length("states", states, "f(x, u)", jax.eval_shape(f, jnp.asarray(x), jnp.asarray(u)).shape)
    shape = jax.eval_shape(h, jnp.asarray(x), jnp.asarray(u)).shape
    labels = tuple(outputs) if outputs is not None else tuple(f"y{i}" for i in range(int(np.prod(shape))))
    _check_length("outputs", labels, "h(x, u)", shape)
    return StateSpaceModel(f, h, tuple(states), tuple(inputs), labels, x, u)


def model_of_vehicle(
    vehicle: Any,
    x: Any,
    u: Any,
    *,
    outputs: Iterable[str] | Mapping[str, Callable[[Any, Any], Any]] | None = None,
    t: float = 0.0,
) -> StateSpaceModel:
    """Create a model of any object with `dynamics(t, x, u)` whose state and input are records.

    Args:
        vehicle: the vehicle.
        x: state record at the model's point x0.
        u: input record at the model's point u0.
        outputs: names of states, or name -> function of the two records; default: all states.
        t: time at which the dynamics are evaluated (s).
    """
    for value, what in ((x, "state"), (u, "input")):
        if not is_record(value):
            problem = f"the {what} must be a record, got a {type(value).__name__}"
            fix = "give the vehicle's records, or use `model_of_functions` for vectors"
            raise InputError("of_vehicle", problem, fix=fix)
    states = entry_names(x)
    inputs = input_names(u, states)

    def f(xs: Any, us: Any) -> Any:
        return record_vector(vehicle.dynamics(t, unpack_record(x, xs), unpack_record(u, us)))

    if isinstance(outputs, Mapping):
        labels, functions = tuple(outputs), tuple(outputs.values())

        def h(xs: Any, us: Any) -> Any:
            a, b = unpack_record(x, xs), unpack_record(u, us)
            return jnp.stack([jnp.asarray(function(a, b), jnp.float64) for function in functions])
    else:
        labels = states if outputs is None else tuple(outputs)
        rows = jnp.array(find_indices("of_vehicle.outputs", labels, states))

        def h(xs: Any, us: Any) -> Any:
            return xs[rows]

    model = model_of_functions(f, states, inputs, h=h, outputs=labels, x0=record_vector(x), u0=record_vector(u))
    return model._replace(state_record=x, input_record=u)


def find_indices(part: str, names: Iterable[str], known: Sequence[str]) -> list[int]:
    """Return the index of each name in the list of known names; raise InputError for an unknown or repeated name."""
    places: list[int] = []
    for name in names:
        if name not in known:
            near = closest(name, known)
            fix = f"write {near[0]!r}" if near else "use one of the listed names"
            raise InputError(part, f"unknown name {name!r}", choices=known, fix=fix)
        if known.index(name) in places:
            raise InputError(part, f"{name!r} is given twice", fix=f"give {name!r} once")
        places.append(known.index(name))
    return places


def format_combination(v: Any, names: Iterable[str]) -> str:
    """Format a vector as text, e.g. "0.8 FX - 0.6 FY". Entries below 1 % of the largest are left out."""
    pairs = sorted(zip(np.asarray(v), names, strict=True), key=lambda pair: -abs(pair[0]))
    sign = np.sign(pairs[0][0]) or 1.0
    text = ""
    for value, name in pairs:
        if abs(value) < 0.01 * abs(pairs[0][0]):
            break
        number = f"{abs(value):.3g} {name}" if abs(abs(value) - 1) > 5e-4 else name
        text += (" - " if value * sign < 0 else " + ") + number if text else number
    return text


def _whole_state(x: Any, u: Any) -> Any:
    return x


def real_leaves(value: Any) -> list[tuple[str, Any, Quantity]]:
    """Return path, value and declaration of each real number or angle in a record, in declared order."""
    return [(p, v, d) for p, v, d in leaves(value) if isinstance(d, Quantity) and d.kind in ("real", "angle")]


def _check_length(what: str, labels: Sequence[str], source: str, shape: tuple[int, ...]) -> None:
    if len(set(labels)) != len(labels):
        raise InputError(f"model.{what}", f"{tuple(labels)} contains a name twice", fix="give each entry its own name")
    if shape != (len(labels),):
        problem = f"got {len(labels)} names for {source} of shape {shape}"
        raise InputError(f"model.{what}", problem, fix=f"give a vector ({len(labels)},), or one name for each entry")


def _as_vector(value: Any, start: Any, labels: tuple[str, ...], what: str) -> Any:
    if value is None or isinstance(value, Mapping):
        changes: Mapping[str, float] = value or {}
        vector = np.array(start, float)
        vector[find_indices(f"model.{what}", changes, labels)] = list(changes.values())
    else:
        vector = np.array(record_vector(value) if is_record(value) else value, float)
    if vector.shape != np.shape(start):
        raise InputError(
            f"model.{what}",
            f"must have shape {np.shape(start)}, got {vector.shape}",
            fix=f"give a vector ({len(labels)},): {', '.join(labels)}",
        )
    bad = [f"{n} = {v}" for n, v in zip(labels, vector, strict=True) if not np.isfinite(v)]
    if bad:
        raise InputError(f"model.{what}", f"all values must be finite, got {', '.join(bad)}", fix="give finite values")
    return vector
