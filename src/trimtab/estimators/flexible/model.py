"""Vehicle model of the bending mode filters: a linear model of the hypersonic vehicle with known forcing.

    eta' = A eta + b(chi, u)          Q' - M/Iyy = C eta + d(chi, u)

The modes enter the pitch acceleration and their own accelerations linearly, so A and C are constant for each
interpretation of the coupling. The rigid-body state chi = (h, h', V, alpha, Q) and the input u act through b and d
only. The publication's "extended" Kalman filter is therefore linear.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, section on the observer; d and the forcing in b, omitted there, are included.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record, replace, tree_where
from trimtab.core.signals import Estimate, Frame, Sample
from trimtab.core.time import to_seconds
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput
from trimtab.vehicles.imperial import FOOT


@record
class RigidFlight:
    """Rigid-body state chi, the measured part of the state. Source: [1] eq. 4 and section on the observer, with the
    units of [1].
    """

    h: Scalar = quantity("ft", "Altitude.", frame="W", default=0.0)
    h_rate: Scalar = quantity("ft/s", "Climb rate.", frame="W", default=0.0)
    V: Scalar = quantity("ft/s", "Speed along the path.", default=0.0)
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle", default=0.0)
    q: Scalar = quantity("rad/s", "Pitch rate, nose up.", frame="B", default=0.0)


@record
class ModalState:
    """State of both bending modes. Source: [1] eq. 1."""

    eta1: Scalar = quantity("(slug ft)^1/2", "Displacement of bending mode 1.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Time derivative of the displacement of bending mode 1.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Displacement of bending mode 2.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Time derivative of the displacement of bending mode 2.")


@record
class ModalFrequencies:
    """Natural frequencies of both modes, estimated by a filter. Source: docs page, Adaptive flexible modes."""

    w1: Scalar = quantity("rad/s", "Estimated natural frequency of bending mode 1.")
    w2: Scalar = quantity("rad/s", "Estimated natural frequency of bending mode 2.")
    w1_sigma: Scalar = quantity("rad/s", "Standard deviation of the estimated frequency of mode 1.")
    w2_sigma: Scalar = quantity("rad/s", "Standard deviation of the estimated frequency of mode 2.")
    learned: Scalar = quantity("1", "True if the last measurement corrected the frequencies.", kind="flag")
    bounded: Scalar = quantity("1", "True if an estimated frequency was limited to its bound.", kind="flag")


@record
class AccelerometerOffset:
    """Offset of the angular accelerometer, estimated by a filter. Source: docs page, Flexible modes."""

    value: Scalar = quantity("rad/s^2", "Estimated offset of the angular accelerometer.")
    sigma: Scalar = quantity("rad/s^2", "Standard deviation of the estimated offset.")


@record
class ModelPrediction:
    """Prediction of the modes by the model alone, without measurements. This prediction is the baseline for every
    estimate.

    Source: docs page, Flexible modes.
    """

    eta: Any = quantity("1", "Modal state eta1, eta1', eta2, eta2'.", shape=(4,))
    Ad: Any = quantity("1", "Transition matrix of the modal state over one period (4, 4).", shape=(4, 4))
    Bd: Any = quantity(
        "1",
        "Input matrix (4, 4): effect on the modal state of a forcing that is constant over one period.",
        shape=(4, 4),
    )


@record
class FlexibleFlight:
    """Estimate of a bending mode filter: measured flight, estimated modes, and signals of the filter's performance.

    Source: [1], in the order of the errors e; innovation signals: docs page, Flexible modes.
    """

    h: Scalar = quantity("ft", "Measured altitude.", frame="W")
    h_rate: Scalar = quantity("ft/s", "Measured climb rate.", frame="W")
    V: Scalar = quantity("ft/s", "Measured speed along the path.")
    alpha: Scalar = quantity("rad", "Measured angle of attack.", kind="angle")
    q: Scalar = quantity("rad/s", "Measured pitch rate, nose up.", frame="B")
    eta1: Scalar = quantity("(slug ft)^1/2", "Estimated displacement of bending mode 1.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Estimated time derivative of the displacement of bending mode 1.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Estimated displacement of bending mode 2.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Estimated time derivative of the displacement of bending mode 2.")
    sigma: Any = quantity("1", "Standard deviations of eta1, eta1', eta2, eta2', each in its unit.", shape=(4,))
    innovation: Scalar = quantity(
        "rad/s^2", "Innovation: measured minus predicted pitch acceleration; 0 if not finite."
    )
    S: Scalar = quantity("rad^2/s^4", "Variance of the innovation of the pitch acceleration.")
    nis: Scalar = quantity("1", "NIS: innovation squared, divided by its variance.")
    updated: Scalar = quantity("1", "True if a measurement was used in this step.", kind="flag")
    without_measurement: ModalState = part("Prediction of the modes by the model alone, without measurements.")
    frequencies: Any = part("Estimated ModalFrequencies; () if the filter does not estimate frequencies.", default=())
    offset: Any = part("Estimated AccelerometerOffset; () if the filter does not estimate an offset.", default=())


class FlightSamples(NamedTuple):
    """Inputs of a mode filter at one instant.

    chi, u: rigid-body state and input; the previous values if a sample can't be used.  flight_usable: True if the
    flight sample can be used.  has_started: True once both a flight sample and an input sample have been used.
    flight_t: time at which chi was measured.  acceleration: sample of the pitch acceleration.
    """

    chi: RigidFlight
    u: HypersonicInput
    flight_usable: Any
    has_started: Any
    flight_t: Any
    acceleration: Sample


def modal_dynamics(craft: Hypersonic) -> tuple[Any, Any]:
    """Return A (4, 4) and C (4,) for (eta1, eta1', eta2, eta2'), for any interpretation of the coupling.

    Each column is the response of the vehicle's coupled modal equations to a unit state.
    """
    one = jnp.eye(4)
    back1, back2 = craft.modes.restoring_forces(one[0], one[1], one[2], one[3])
    C, first, second = craft.modes.solve_accelerations(craft.Iyy, jnp.zeros(4), back1, back2)
    return jnp.stack([one[1], first, one[3], second]), C


def forcing(craft: Hypersonic, chi: RigidFlight, u: HypersonicInput) -> tuple[Any, Any, Any]:
    """Return the effects of flight and input: b (4,) on the modes; d and M/Iyy (rad/s^2) on the pitch acceleration."""
    moment = craft.forces.at(chi.h, chi.V, chi.alpha, u.Phi, u.delta_e).M
    N1, N2 = craft.modes.forcing(chi.alpha, u.delta_e)
    q_rate, first, second = craft.modes.solve_accelerations(craft.Iyy, moment, N1, N2)
    still = jnp.zeros_like(first)
    return jnp.stack([still, first, still, second]), q_rate - moment / craft.Iyy, moment / craft.Iyy


def read_flight_samples(listens: tuple[str, ...], state: Any, frame: Frame) -> FlightSamples:
    """Return a mode filter's inputs from the samples of three sensors. The last usable value replaces an unusable
    value.

    listens: names of the sensors of rigid-body state (SI units), pitch acceleration and acting input.
    """
    flight, acceleration, acting = (frame.samples[name] for name in listens)
    z = flight.value
    measured = RigidFlight(z.altitude / FOOT, z.climb / FOOT, z.speed / FOOT, z.alpha, z.pitch_rate)
    usable = flight.valid & _is_finite(measured)
    chi = tree_where(usable, measured, state.chi)
    acted = HypersonicInput(acting.value.Phi, acting.value.delta_e)
    input_usable = acting.valid & _is_finite(acted)
    u = tree_where(input_usable, acted, state.u)
    started = state.started | (usable & input_usable)
    return FlightSamples(chi, u, usable, started, jnp.where(usable, flight.t, state.flight_t), acceleration)


def listened_sensors(form: Any) -> tuple[str, ...]:
    """Return the names of a mode filter's sensors: rigid-body state, pitch acceleration, acting input (`listens`)."""
    return (form.flight, form.accelerometer, form.actuators)


def step_mode_filter(form: Any, t: Any, state: Any, frame: Frame) -> tuple[Any, Estimate]:
    """Return the state and the estimate of a filter of bending modes at integer time t.

    The filter and the prediction by the model alone advance once per period. In between, the last estimate is held.
    """
    due = ~state.started | (t - state.t >= form.period)
    new = form.advance(t, state, frame)
    new = replace(new, bare=_advance_model_prediction(form.craft, state, new.u))
    state = tree_where(due, new, state)
    state = replace(state, updated=due & state.updated)
    age = to_seconds(t - state.flight_t)
    return state, Estimate(t=t, age=age, fresh=state.updated, valid=state.started, state=form.estimated_flight(state))


def first_instant() -> dict[str, Any]:
    """Return the initial values of the state fields that all mode filters share."""
    no, zero = jnp.asarray(False), jnp.asarray(0.0)
    return {
        "chi": jax.tree.map(jnp.asarray, RigidFlight()),
        "u": HypersonicInput(zero, zero),
        "t": np.int64(0),
        "flight_t": np.int64(0),
        "started": no,
        "innovation": zero,
        "S": zero,
        "nis": zero,
        "updated": no,
    }


def next_instant(t: Any, state: Any, samples: FlightSamples) -> dict[str, Any]:
    """Return the values at time t of the state fields that all mode filters share, from new samples."""
    return {
        "chi": samples.chi,
        "u": samples.u,
        "t": jnp.where(samples.has_started, t, state.t),
        "flight_t": samples.flight_t,
        "started": samples.has_started,
    }


def _advance_model_prediction(craft: Hypersonic, state: Any, u: HypersonicInput) -> ModelPrediction:
    """Return the prediction by the model alone after one period during which the input u acted."""
    bare = state.bare
    b, _, _ = forcing(craft, state.chi, u)
    return replace(bare, eta=jnp.where(state.started, bare.Ad @ bare.eta + bare.Bd @ b, bare.eta))


def estimated_flight(form: Any, state: Any) -> FlexibleFlight:
    """Return the estimate of a mode filter from its state: the measured flight and the estimated modes."""
    return flexible_flight(state, state.eta, jnp.stack([state.P[i, i] for i in range(4)]))


def flexible_flight(state: Any, eta: Any, variances: Any) -> FlexibleFlight:
    """Return the estimate of a mode filter with the modal state eta (4,) and its variances (4,)."""
    chi = state.chi
    return FlexibleFlight(
        h=chi.h,
        h_rate=chi.h_rate,
        V=chi.V,
        alpha=chi.alpha,
        q=chi.q,
        eta1=eta[0],
        eta1_rate=eta[1],
        eta2=eta[2],
        eta2_rate=eta[3],
        sigma=jnp.sqrt(jnp.maximum(variances, 0.0)),
        innovation=state.innovation,
        S=state.S,
        nis=state.nis,
        updated=state.updated,
        without_measurement=ModalState(*(state.bare.eta[i] for i in range(4))),
    )


def _is_finite(r: Any) -> Any:
    return jnp.all(jnp.isfinite(jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(r)])))


def check_variances(part: str, **fields: Any) -> None:
    """Raise InputError if a field does not contain finite variances of at least 0. fields: values by name."""
    for name, value in fields.items():
        values = np.asarray(value, float)
        if not (np.isfinite(values).all() and (values >= 0).all()):
            problem = f"the value must be four variances, got {values.tolist()}"
            raise InputError(f"{part}.{name}", problem, fix="give four finite numbers, each at least 0")
