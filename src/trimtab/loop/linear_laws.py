"""Linear laws about a trim for any vehicle: from a gain and its certificate, or from a compensator made elsewhere."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, leaves
from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.design.bryson import INTEGRAL, weigh_by_limits
from trimtab.design.certificate import Certificate, design_certificate
from trimtab.design.certificate_file import read_certificate
from trimtab.design.coordinates import attitude_fields, error_model, error_names, state_from_trim
from trimtab.design.exchange import discrete_matrices
from trimtab.design.linearise import linearise
from trimtab.design.model import StateSpaceModel, entry_names, input_names, record_vector, unpack_record
from trimtab.design.output_inversion import Inversion
from trimtab.laws.course_tracking import CourseTracking
from trimtab.laws.state_feedback import StateFeedback
from trimtab.laws.state_space import StateSpaceLaw

STATE, INPUT = "x0 ", "u0 "
"""What a certificate's settings begin with that are numbers of the trim."""
MOST = 5.0
"""An integral is held within this many of its limits."""


def read_feedback(file: Path | str, x: Any, u: Any, believed: Any = None) -> StateFeedback:
    """The law of a gain that `trimtab design VEHICLE --lqr --out FILE` has written.

    Args:
        file: the certificate.
        x: a state record of the vehicle: for its fields; of the numbers, those count that the file does not say.
        u: an input record, likewise.
        believed: the vehicle for which the gain was designed; the log then tells where it differs from the one flown.

    Raises: InputError for a file that is none, or of another vehicle.
    """
    return feedback_law(read_certificate(Path(file))[0], x, u, believed)


def feedback_law(certificate: Certificate, x: Any, u: Any, believed: Any = None) -> StateFeedback:
    """The law of a certificate; arguments as of `read_feedback`."""
    integrals = [n for n in certificate.states if n.startswith(INTEGRAL)]
    states = [n for n in certificate.states if n not in integrals]
    columns, fields, turned, places = _feedback_columns(x, states)
    K = np.zeros((len(certificate.inputs), sum(size for _, size in fields)))
    K[:, columns] = certificate.K[:, : len(states)]
    inputs = input_names(u, entry_names(x))
    if tuple(certificate.inputs) != inputs:
        problem = f"its inputs are {', '.join(certificate.inputs)}, the vehicle's {', '.join(inputs)}"
        raise InputError("gain", problem, fix="design it with all inputs of this vehicle")
    trim = {n.removeprefix(STATE): v for n, v in certificate.about.items() if n.startswith(STATE)}
    point = state_from_trim(x, {n: float(v) for n, v in trim.items()})
    own = zip(inputs, np.asarray(record_vector(u)).tolist(), strict=True)
    about: dict[str, Any] = dict(certificate.about)
    u0 = unpack_record(u, np.array([float(about.get(f"{INPUT}{n}", value)) for n, value in own]))
    names = [name for name, _ in fields]
    rows = tuple(int(columns[states.index(n.removeprefix(INTEGRAL))]) for n in integrals)
    return StateFeedback(
        reads=tuple(names),
        K=K,
        x0=np.concatenate([np.ravel(np.asarray(getattr(point, n), float)) for n in names]),
        u0=u0,
        integrated=rows,
        L=certificate.K[:, len(states) :],
        most=MOST * np.asarray(certificate.scale)[len(states) :],
        attitude=next(iter(attitude_fields(x).values()), "") if turned or places else "",
        turned=turned,
        places=places,
        believed=believed,
    )


def design_feedback(
    vehicle: Any, x: Any, u: Any, limits: Mapping[str, float], integrals: Mapping[str, float] | None = None
) -> StateFeedback:
    """The regulator of a vehicle at a trim (x, u), by how large everything may become.

    Args:
        vehicle: as it is believed to be.
        x: state record, at a trim.
        u: input record, likewise.
        limits: each state that is fed back, and each input -> how large it may become; names as of `error_model`.
        integrals: state -> how large the integral of its error may become.

    Source: `design.bryson`.
    """
    linear = linearise(error_model(vehicle, x, u))
    linear = linear.part(states=[n for n in linear.states if n in limits])
    name = type(vehicle).__name__
    return feedback_law(design_certificate(weigh_by_limits(name, linear, limits, integrals)), x, u, vehicle)


def track_course(
    feedback: StateFeedback, model: StateSpaceModel, course: Inversion, *, every: int = 1
) -> CourseTracking:
    """The law that flies an inversion: its state and input as feedforward, the gain on what is off them.

    Args:
        feedback: of the vehicle, about the course's first point.
        model: with which the course was computed; inputs that it has not stay as the feedback has them.
        course: the inversion, evenly spaced.
        every: one node of so many is kept.
    """
    whole = jax.jit(jax.vmap(model.to_record or (lambda x: unpack_record(model.state_record, x))))
    states = whole(jnp.asarray(course.x[::every]))
    fields = [np.asarray(getattr(states, n), float) for n in feedback.reads]
    x = np.concatenate([v.reshape(len(v), -1) for v in fields], axis=1)
    u0 = np.asarray(record_vector(feedback.u0))
    du = np.zeros((len(x), len(u0)))
    names = input_names(feedback.u0, model.states)
    moved = [names.index(n) for n in model.inputs]
    du[:, moved] = course.u[::every] - u0[moved]
    return CourseTracking(feedback, x, du, float(every * (course.times[1] - course.times[0])))


def compensator_law(system: Any, reads: Sequence[str], x0: Any, u0: Any, *, period: int) -> StateSpaceLaw:
    """A compensator of python-control or scipy.signal as a law: u = u0 + system (x - x0).

    Args:
        system: from the errors of what is read to the inputs' changes; a continuous one is discretised by Tustin's
            rule. Positive feedback: a stabilising one has the minus in it.
        reads: fields of the state.
        x0: where these are wanted, their numbers one after another.
        u0: input record there.
        period: at which it steps (100 ns), a multiple of the autopilot's.
    """
    A, B, C, D = discrete_matrices(system, period * SECONDS_PER_UNIT)
    wanted = (int(np.size(record_vector(u0))), int(np.size(x0)))
    if D.shape != wanted:
        problem = f"it has {D.shape[1]} inputs and {D.shape[0]} outputs"
        raise InputError("compensator", problem, fix=f"give one from {wanted[1]} errors to {wanted[0]} inputs")
    return StateSpaceLaw(tuple(reads), A, B, C, D, np.ravel(np.asarray(x0, float)), u0, period)


class StateNumber(NamedTuple):
    """A number of a vehicle's state that a law feeds back. path: below the state.  state: the gain's name of it.

    value: at the trim.  unit: of the state.
    """

    path: str
    state: str
    value: float
    unit: str


def state_numbers(law: StateFeedback, x: Any) -> list[StateNumber]:
    """The numbers that a law of `feedback_law` reads, without those of an attitude. x: a state record."""
    declared = {path: d for path, _, d in leaves(x) if isinstance(d, Quantity)}
    numbers: list[StateNumber] = []
    begin = 0
    for field in law.reads:
        size = int(np.size(getattr(x, field)))
        values = np.asarray(law.x0)[begin : begin + size].tolist()
        begin += size
        names = error_names(x, field)
        if len(names) == size:
            paths = [field] if np.ndim(getattr(x, field)) == 0 else [f"{field}[{i}]" for i in range(size)]
            unit = declared[field].unit
            numbers += [StateNumber(p, n, v, unit) for p, n, v in zip(paths, names, values, strict=True)]
    return numbers


def describe_vehicle(vehicle: Any, x: Any, u: Any) -> dict[str, str]:
    """What a gain's file says of the vehicle it is for: its class, and the units of states and inputs, in order."""
    units = [f"{path} {d.unit}" for own in (x, u) for path, _, d in leaves(own) if isinstance(d, Quantity)]
    return {"vehicle": type(vehicle).__name__, "units": "; ".join(units)}


class _FeedbackColumns(NamedTuple):
    """columns: where each state is among the errors of the fields that hold any.  fields: these, with their sizes.

    turned: those that are velocities of an attitude's outer frame.  places: those that are places there.
    """

    columns: list[int]
    fields: list[tuple[str, int]]
    turned: tuple[str, ...]
    places: tuple[str, ...]


def _feedback_columns(x: Any, states: Sequence[str]) -> _FeedbackColumns:
    columns: dict[str, int] = {}
    fields: list[tuple[str, int]] = []
    begin = 0
    for path, _, declared in leaves(x):
        names = error_names(x, path) if isinstance(declared, Quantity) else ()
        if not any(n in states for n in names):
            continue
        columns |= {n: begin + i for i, n in enumerate(names)}
        fields.append((path, len(names)))
        begin += len(names)
    unknown = [n for n in states if n not in columns]
    if unknown:
        problem = f"it feeds back {unknown[0]!r}, which the vehicle's state does not have"
        raise InputError("gain", problem, choices=columns, fix="give the vehicle's own state record")
    outer = attitude_fields(x)
    own = dict(fields)
    vectors = [(p, d) for p, v, d in leaves(x) if isinstance(d, Quantity) and p in own and np.shape(v) == (3,)]
    turned = tuple(p for p, d in vectors if d.frame in outer and d.unit != "m")
    places = tuple(p for p, d in vectors if d.frame in outer and d.unit == "m")
    return _FeedbackColumns([columns[n] for n in states], fields, turned, places)
