"""Linear control laws about a trim point, for any vehicle: from a gain file, or from a compensator of another tool."""

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
from trimtab.loop.structure import check_record, check_vehicle

STATE, INPUT = "x0 ", "u0 "
"""Prefixes of the entries in a certificate that contain the trim values of the states ("x0 ") and inputs ("u0 ")."""
INTEGRAL_FACTOR = 5.0
"""Anti-windup bound of each error integral in the law, as a multiple of the integral's limit in the gain's design."""


def read_feedback(file: Path | str, x: Any, u: Any, assumed: Any = None) -> StateFeedback:
    """Return the control law that uses the gain in a file written by `trimtab design VEHICLE --lqr --out FILE`.

    Args:
        file: path of the file, which contains a certificate (gain, trim point and proof of stability).
        x: example of the vehicle's state record. States without a trim value in the file keep the value in this record.
        u: example of the vehicle's input record. Inputs without a trim value in the file keep the value in this record.
        assumed: vehicle model for which the gain was designed. The log reports where this model differs from the true
            vehicle.

    Raises: InputError if the file does not contain a certificate, or contains the certificate of another vehicle.
    """
    return feedback_law(read_certificate(Path(file))[0], x, u, assumed)


def feedback_law(certificate: Certificate, x: Any, u: Any, assumed: Any = None) -> StateFeedback:
    """Return the control law that uses the gain in a certificate. x, u, assumed: see `read_feedback`."""
    integrals = [n for n in certificate.states if n.startswith(INTEGRAL)]
    states = [n for n in certificate.states if n not in integrals]
    columns, fields, turned, places = _feedback_columns(x, states)
    K = np.zeros((len(certificate.inputs), sum(size for _, size in fields)))
    K[:, columns] = certificate.K[:, : len(states)]
    inputs = input_names(u, entry_names(x))
    if tuple(certificate.inputs) != inputs:
        problem = f"the gain's inputs are {', '.join(certificate.inputs)}, but the vehicle's are {', '.join(inputs)}"
        raise InputError("gain", problem, fix="design the gain with all inputs of this vehicle")
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
        most=INTEGRAL_FACTOR * np.asarray(certificate.scale)[len(states) :],
        attitude=next(iter(attitude_fields(x).values()), "") if turned or places else "",
        turned=turned,
        places=places,
        design_model=assumed,
    )


def design_feedback(
    vehicle: Any, x: Any, u: Any, limits: Mapping[str, float], integrals: Mapping[str, float] | None = None
) -> StateFeedback:
    """Return a linear-quadratic regulator of a vehicle at a trim point (x, u), with weights from allowed deviations.

    Args:
        vehicle: model of the vehicle.
        x: state record at the trim point.
        u: input record at the trim point.
        limits: name of each state that is fed back, and of each input -> largest allowed deviation. The names are those
            that `error_model` returns.
        integrals: name of a state -> largest allowed integral of the state's error.

    Source: Bryson's rule, `design.bryson`.
    """
    check_record("vehicle", vehicle)
    check_vehicle(vehicle, x, u)
    linear = linearise(error_model(vehicle, x, u))
    linear = linear.part(states=[n for n in linear.states if n in limits])
    name = type(vehicle).__name__
    return feedback_law(design_certificate(weigh_by_limits(name, linear, limits, integrals)), x, u, vehicle)


def track_course(
    feedback: StateFeedback, model: StateSpaceModel, course: Inversion, *, every: int = 1
) -> CourseTracking:
    """Return the law that tracks a trajectory computed by model inversion.

    The law adds the trajectory's inputs (feedforward) and the feedback of the deviations from the trajectory's states.

    Args:
        feedback: linear law of the vehicle about the first point of the trajectory.
        model: model with which the trajectory was computed. Inputs that are not in this model keep their trim values of
            the feedback law.
        course: trajectory, i.e. the result of the inversion, with equal time steps.
        every: number N; the law uses every Nth point of the trajectory.
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
    """Return the law u = u0 + system (x - x0) for a compensator of python-control or scipy.signal.

    Args:
        system: compensator. Its inputs are the errors x - x0, its outputs the changes u - u0. A continuous compensator
            is discretised by Tustin's rule. The compensator must contain the minus sign of negative feedback.
        reads: fields of the vehicle's state from which x is built.
        x0: set-points of all numbers in these fields, in one list.
        u0: input record at the set-point.
        period: period of the compensator (100 ns), a multiple of the autopilot's period.
    """
    A, B, C, D = discrete_matrices(system, period * SECONDS_PER_UNIT)
    wanted = (int(np.size(record_vector(u0))), int(np.size(x0)))
    if D.shape != wanted:
        problem = f"inputs of the compensator: {D.shape[1]}, outputs: {D.shape[0]}"
        raise InputError(
            "compensator",
            problem,
            fix=f"use a compensator with inputs (errors): {wanted[1]}, outputs (inputs of the vehicle): {wanted[0]}",
        )
    return StateSpaceLaw(tuple(reads), A, B, C, D, np.ravel(np.asarray(x0, float)), u0, period)


class StateNumber(NamedTuple):
    """State variable that a law feeds back.

    path: path in the vehicle's state record.  state: name of the state in the gain file.  value: value at the trim
    point.  unit: unit of the value.
    """

    path: str
    state: str
    value: float
    unit: str


def state_numbers(law: StateFeedback, x: Any) -> list[StateNumber]:
    """Return the state variables that a law made by `feedback_law` reads, without those of an attitude.

    x: example of the vehicle's state record.
    """
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
    """Return the description of a vehicle for a gain file: the class, and the names and units of states and inputs."""
    units = [f"{path} {d.unit}" for own in (x, u) for path, _, d in leaves(own) if isinstance(d, Quantity)]
    return {"vehicle": type(vehicle).__name__, "units": "; ".join(units)}


class _FeedbackColumns(NamedTuple):
    """Columns of a law's gain matrix.

    columns: column of each state that is fed back.  fields: name and number of columns of each state field that
    contains such a state.  turned: fields that are vectors, but not positions, in the outer frame of the vehicle's
    attitude, e.g. velocities.  places: fields that are positions in this outer frame.
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
        problem = f"the gain feeds back {unknown[0]!r}, which is not a state of the vehicle"
        raise InputError(
            "gain", problem, choices=columns, fix="use the state record of the vehicle for which the gain was designed"
        )
    outer = attitude_fields(x)
    own = dict(fields)
    vectors = [(p, d) for p, v, d in leaves(x) if isinstance(d, Quantity) and p in own and np.shape(v) == (3,)]
    turned = tuple(p for p, d in vectors if d.frame in outer and d.unit != "m")
    places = tuple(p for p, d in vectors if d.frame in outer and d.unit == "m")
    return _FeedbackColumns([columns[n] for n in states], fields, turned, places)
