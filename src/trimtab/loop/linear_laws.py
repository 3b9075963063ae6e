"""Linear laws about a trim for any vehicle, from the certificate of a gain or from a compensator of another tool."""

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
"""Prefixes of the entries in a certificate that give the trim: values of states and of inputs."""
INTEGRAL_FACTOR = 5.0
"""Bound of each integral in the law, as a multiple of the integral's limit in the design."""


def read_feedback(file: Path | str, x: Any, u: Any, assumed: Any = None) -> StateFeedback:
    """Return the control law with the gain in a file from `trimtab design VEHICLE --lqr --out FILE`.

    Args:
        file: the file, which contains a certificate (gain, trim and proof of stability).
        x: example of the vehicle's state record. It defines the fields, and each value that is not in the file.
        u: example of the vehicle's input record. It defines the fields, and each value that is not in the file.
        assumed: vehicle model for which the gain was designed. The log reports how it differs from the true vehicle.

    Raises: InputError if the file is not a certificate, or is the certificate of another vehicle.
    """
    return feedback_law(read_certificate(Path(file))[0], x, u, assumed)


def feedback_law(certificate: Certificate, x: Any, u: Any, assumed: Any = None) -> StateFeedback:
    """Return the law from the gain in a certificate. The other arguments are those of `read_feedback`."""
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
    """Return the regulator of a vehicle at a trim (x, u), designed from the largest allowed deviations.

    Args:
        vehicle: model of the vehicle.
        x: state record, at a trim.
        u: input record, at the trim.
        limits: each state that is fed back, and each input -> largest allowed deviation. The names are those of
            `error_model`.
        integrals: state -> largest allowed integral of its error.

    Source: `design.bryson`.
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
    """Return the law that follows the trajectory of an inversion: feedforward of its inputs, feedback of the
    deviations.

    Args:
        feedback: linear law of the vehicle, about the first point of the trajectory.
        model: model with which the trajectory was computed. Inputs that the model lacks keep the values of the feedback
            law.
        course: result of the inversion, with equal time steps.
        every: N, to use only every Nth node of the trajectory.
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
    """Return a compensator of python-control or scipy.signal as a law: u = u0 + system (x - x0).

    Args:
        system: compensator from the errors of the fields in `reads` to the changes of the inputs. A continuous
            compensator is discretised by Tustin's rule. The feedback is positive: a stabilising compensator contains
            the minus sign.
        reads: fields of the state.
        x0: set-points of the fields in `reads`, all numbers in one list.
        u0: input record at the set-point.
        period: period of the compensator (100 ns), a multiple of the autopilot's.
    """
    A, B, C, D = discrete_matrices(system, period * SECONDS_PER_UNIT)
    wanted = (int(np.size(record_vector(u0))), int(np.size(x0)))
    if D.shape != wanted:
        problem = f"the compensator has {D.shape[1]} inputs and {D.shape[0]} outputs"
        raise InputError(
            "compensator", problem, fix=f"give a compensator from {wanted[1]} errors to {wanted[0]} inputs"
        )
    return StateSpaceLaw(tuple(reads), A, B, C, D, np.ravel(np.asarray(x0, float)), u0, period)


class StateNumber(NamedTuple):
    """Number of the vehicle's state that a law feeds back.

    path: path in the state record.  state: name in the gain.  value: value at the trim.  unit: unit of the number.
    """

    path: str
    state: str
    value: float
    unit: str


def state_numbers(law: StateFeedback, x: Any) -> list[StateNumber]:
    """Return the numbers of the state that a law of `feedback_law` reads, except those of an attitude.

    x: example of a state record.
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
    """Return the description of a vehicle in a gain's file: its class, and names and units of its states and inputs."""
    units = [f"{path} {d.unit}" for own in (x, u) for path, _, d in leaves(own) if isinstance(d, Quantity)]
    return {"vehicle": type(vehicle).__name__, "units": "; ".join(units)}


class _FeedbackColumns(NamedTuple):
    """Columns of the gain. columns: index of each fed-back state among the errors of the fields.

    fields: fields that contain fed-back states, with sizes.  turned: fields that are velocities in the outer frame of
    an attitude.  places: fields that are positions in that frame.
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
        problem = f"the gain feeds back {unknown[0]!r}, which the vehicle's state does not have"
        raise InputError(
            "gain", problem, choices=columns, fix="give the state record of the vehicle for which the gain was designed"
        )
    outer = attitude_fields(x)
    own = dict(fields)
    vectors = [(p, d) for p, v, d in leaves(x) if isinstance(d, Quantity) and p in own and np.shape(v) == (3,)]
    turned = tuple(p for p, d in vectors if d.frame in outer and d.unit != "m")
    places = tuple(p for p, d in vectors if d.frame in outer and d.unit == "m")
    return _FeedbackColumns([columns[n] for n in states], fields, turned, places)
