"""Vehicle model of the bending mode filters: a linear model of the hypersonic vehicle with known forcing.

    eta' = A eta + b(chi, u)          Q' - M/Iyy = C eta + d(chi, u)

The modes enter the pitch acceleration and their own accelerations linearly, so A and C are constant for each
interpretation of the coupling. The rigid-body state chi = (h, h', V, alpha, Q) and the input u act through b and d
only. The publication's "extended" filter is a linear one.

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
    """The measured part of the state, chi. Source: [1] eq. 4 and the observer's section, in its units."""

    h: Scalar = quantity("ft", "Altitude.", frame="W", default=0.0)
    h_rate: Scalar = quantity("ft/s", "Climb rate.", frame="W", default=0.0)
    V: Scalar = quantity("ft/s", "Speed along the path.", default=0.0)
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle", default=0.0)
    q: Scalar = quantity("rad/s", "Pitch rate, nose up.", frame="B", default=0.0)


@record
class ModalState:
    """State of both modes. Source: [1] eq. 1."""

    eta1: Scalar = quantity("(slug ft)^1/2", "Displacement of mode 1.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the displacement of mode 1.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Displacement of mode 2.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the displacement of mode 2.")


@record
class ModalFrequencies:
    """Natural frequencies of both modes, estimated by a filter. Source: docs page, Adaptive flexible modes."""

    w1: Scalar = quantity("rad/s", "Natural frequency of mode 1, estimated.")
    w2: Scalar = quantity("rad/s", "Natural frequency of mode 2, estimated.")
    w1_sigma: Scalar = quantity("rad/s", "Standard deviation of the estimate of w1.")
    w2_sigma: Scalar = quantity("rad/s", "Standard deviation of the estimate of w2.")
    learned: Scalar = quantity("1", "True if this measurement carried information about the frequencies.", kind="flag")
    bounded: Scalar = quantity("1", "True if a frequency was limited to its bound.", kind="flag")


@record
class AccelerometerOffset:
    """Offset of the angular accelerometer, estimated by a filter. Source: docs page, Flexible modes."""

    value: Scalar = quantity("rad/s^2", "Estimated offset of the angular accelerometer.")
    sigma: Scalar = quantity("rad/s^2", "Standard deviation of the estimated offset.")


@record
class ModelPrediction:
    """Prediction of the modes by the model alone, without measurements: the baseline for every estimate.

    Source: docs page, Flexible modes.
    """

    eta: Any = quantity("1", "Modal state eta1, eta1', eta2, eta2'.", shape=(4,))
    Ad: Any = quantity("1", "Transition matrix of the modal state over one period (4, 4).", shape=(4, 4))
    Bd: Any = quantity("1", "Effect of a held forcing over one period (4, 4).", shape=(4, 4))


@record
class FlexibleFlight:
    """Whole state as given by a filter of the modes, with signals of the filter's performance.

    Source: [1], order of its errors e; innovation signals: docs page, Flexible modes.
    """

    h: Scalar = quantity("ft", "Altitude, as measured.", frame="W")
    h_rate: Scalar = quantity("ft/s", "Climb rate, as measured.", frame="W")
    V: Scalar = quantity("ft/s", "Speed along the path, as measured.")
    alpha: Scalar = quantity("rad", "Angle of attack, as measured.", kind="angle")
    q: Scalar = quantity("rad/s", "Pitch rate, as measured.", frame="B")
    eta1: Scalar = quantity("(slug ft)^1/2", "Displacement of mode 1, estimated.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the displacement of mode 1, estimated.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Displacement of mode 2, estimated.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the displacement of mode 2, estimated.")
    sigma: Any = quantity("1", "Standard deviations of the four modal estimates, each in its unit.", shape=(4,))
    innovation: Scalar = quantity(
        "rad/s^2", "Innovation: measured minus predicted pitch acceleration; 0 if not finite."
    )
    S: Scalar = quantity("rad^2/s^4", "Variance of the innovation.")
    nis: Scalar = quantity("1", "NIS: innovation squared over its variance S.")
    updated: Scalar = quantity("1", "True if a measurement was used in this step.", kind="flag")
    without_measurement: ModalState = part("Prediction of the same model without any measurement.")
    frequencies: Any = part("ModalFrequencies of a filter that estimates them, else None.", default=())
    offset: Any = part("AccelerometerOffset of a filter that estimates it, else None.", default=())


class FlightSamples(NamedTuple):
    """Inputs of a mode filter at one instant.

    chi, u: flight and input; the previous ones where the samples cannot be used.  flight_usable: True if the flight
    sample can be used.  has_started: True once both have been received.  flight_t: time at which chi was measured.
    """

    chi: RigidFlight
    u: HypersonicInput
    flight_usable: Any
    has_started: Any
    flight_t: Any
    acceleration: Sample


def modal_dynamics(craft: Hypersonic) -> tuple[Any, Any]:
    """Return A (4, 4) and C (4,) for (eta1, eta1', eta2, eta2'), from the algebraic loop of any `kmode`, by units."""
    one = jnp.eye(4)
    back1, back2 = craft.modes.restoring_forces(one[0], one[1], one[2], one[3])
    C, first, second = craft.modes.solve_accelerations(craft.Iyy, jnp.zeros(4), back1, back2)
    return jnp.stack([one[1], first, one[3], second]), C


def forcing(craft: Hypersonic, chi: RigidFlight, u: HypersonicInput) -> tuple[Any, Any, Any]:
    """Return b (4,), d and M/Iyy (rad/s^2): effect of flight and input on the modes and the pitch acceleration."""
    moment = craft.forces.at(chi.h, chi.V, chi.alpha, u.Phi, u.delta_e).M
    N1, N2 = craft.modes.forcing(chi.alpha, u.delta_e)
    q_rate, first, second = craft.modes.solve_accelerations(craft.Iyy, moment, N1, N2)
    still = jnp.zeros_like(first)
    return jnp.stack([still, first, still, second]), q_rate - moment / craft.Iyy, moment / craft.Iyy


def read_flight_samples(listens: tuple[str, ...], state: Any, frame: Frame) -> FlightSamples:
    """Return the inputs from the named samples of flight (SI), acceleration and acting input, and the last state."""
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
    """Return the names of the sensors of flight, pitch acceleration and acting input: `listens` of every filter."""
    return (form.flight, form.accelerometer, form.actuators)


def step_mode_filter(form: Any, t: Any, state: Any, frame: Frame) -> tuple[Any, Estimate]:
    """Return a filter's state and its estimate at integer time t: `step` of every filter.

    Once a period the filter and the model without measurements advance; in between the last estimate is held.
    """
    due = ~state.started | (t - state.t >= form.period)
    new = form.advance(t, state, frame)
    new = replace(new, bare=_advance_model_prediction(form.craft, state, new.u))
    state = tree_where(due, new, state)
    state = replace(state, updated=due & state.updated)
    age = to_seconds(t - state.flight_t)
    return state, Estimate(t=t, age=age, fresh=state.updated, valid=state.started, state=form.estimated_flight(state))


def first_instant() -> dict[str, Any]:
    """Return the initial fields of every filter's state, before any measurement."""
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
    """Return the fields of every filter's state at time t, once these samples have arrived."""
    return {
        "chi": samples.chi,
        "u": samples.u,
        "t": jnp.where(samples.has_started, t, state.t),
        "flight_t": samples.flight_t,
        "started": samples.has_started,
    }


def _advance_model_prediction(craft: Hypersonic, state: Any, u: HypersonicInput) -> ModelPrediction:
    """Return the prediction of the model alone after one period during which u acted."""
    bare = state.bare
    b, _, _ = forcing(craft, state.chi, u)
    return replace(bare, eta=jnp.where(state.started, bare.Ad @ bare.eta + bare.Bd @ b, bare.eta))


def estimated_flight(form: Any, state: Any) -> FlexibleFlight:
    """Return the estimate in a filter's state: measured values as measured, the modes as estimated."""
    return flexible_flight(state, state.eta, jnp.stack([state.P[i, i] for i in range(4)]))


def flexible_flight(state: Any, eta: Any, variances: Any) -> FlexibleFlight:
    """Return the estimate with modal states (4,) of these variances (4,)."""
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
    """Raise InputError if a field is not four variances; fields: the values by name."""
    for name, value in fields.items():
        values = np.asarray(value, float)
        if not (np.isfinite(values).all() and (values >= 0).all()):
            problem = f"{values.tolist()} must be four variances"
            raise InputError(f"{part}.{name}", problem, fix="give four finite numbers, each at least 0")
