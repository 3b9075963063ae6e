"""Discrete filter that estimates the hypersonic vehicle's bending modes from its pitch acceleration."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.discretisation import discretise
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Frame, is_new
from trimtab.core.time import format_time, ms, to_seconds
from trimtab.estimators import kalman
from trimtab.estimators.flexible.model import (
    AccelerometerOffset,
    FlexibleFlight,
    ModelPrediction,
    RigidFlight,
    check_variances,
    estimated_flight,
    first_instant,
    forcing,
    listened_sensors,
    modal_dynamics,
    next_instant,
    read_flight_samples,
    step_mode_filter,
)
from trimtab.estimators.inertial.sensor_watch import NEVER
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput

PRINTED_ETA0 = (1.5122, 0.0, 1.122, 0.0)
PRINTED_Q = (1e-5, 1e-5, 1e-5, 1e-5)
EQUAL_Q = (1e-5, 100.0, 1e-5, 100.0)
TUNED_Q = (1e-5, 500.0, 1e-5, 6.0)
"""Process noise densities of the modal state. In closed loop, they lead to less elevator motion, smaller errors and
wider stability margins than EQUAL_Q (docs, Flexible modes)."""


@record
class ModalModel:
    """Discrete linear model of the bending modes, computed once. Source: docs page, Flexible modes."""

    C: Any = quantity("1", "Derivative of the pitch acceleration with respect to the modal state.", shape=(4,))
    Ad: Any = quantity("1", "Transition matrix of the modal state over one period (4, 4).", shape=(4, 4))
    Bd: Any = quantity(
        "1",
        "Input matrix (4, 4): effect on the modal state of a forcing that is constant over one period.",
        shape=(4, 4),
    )
    Qd: Any = quantity("1", "Covariance of the process noise of one period (4, 4).", shape=(4, 4))


@record
class FlexibleModeState:
    """State of the discrete filter of the bending modes. Source: docs page, Flexible modes."""

    model: ModalModel = part("Discrete model of the bending modes.")
    eta: Any = quantity("1", "Modal state eta1, eta1', eta2, eta2'.", shape=(4,))
    offset: Scalar = quantity("rad/s^2", "Estimated offset of the accelerometer.")
    P: Any = quantity("1", "Covariance of modal state and offset.", shape=(5, 5))
    bare: ModelPrediction = part("Prediction of the modes by the model alone.")
    chi: RigidFlight = part("Measured rigid-body state at the last step.")
    u: HypersonicInput = part("Fuel ratio and elevator that acted in the last step.")
    t: Scalar = quantity("100 ns", "Time of the filter's last step.", kind="time")
    seen: Scalar = quantity("100 ns", "Time at which the last used acceleration was measured.", kind="time")
    flight_t: Scalar = quantity("100 ns", "Time at which the rigid-body state was measured.", kind="time")
    started: Scalar = quantity("1", "True once the rigid-body state and the input have been received.", kind="flag")
    innovation: Scalar = quantity("rad/s^2", "Innovation of the pitch acceleration in the last step.")
    S: Scalar = quantity("rad^2/s^4", "Variance of the innovation of the pitch acceleration.")
    nis: Scalar = quantity("1", "NIS: innovation squared, divided by its variance.")
    updated: Scalar = quantity("1", "True if a measurement was used in the last step.", kind="flag")


@record
class FlexibleModeFilter:
    """Discrete Kalman filter of the modal state (eta1, eta1', eta2, eta2') with exactly known forcing.

        r = (Q'_m - M/Iyy) - C eta - d(chi, u) - o   S = C P C' + R       L = P C'/S
        eta += L r                                   P = (I - L C) P (I - L C)' + R L L'
        eta = Ad eta + Bd b(chi, u)                  P = Ad P Ad' + Qd

    with the rigid-body state chi, the input u and the modal state eta; Ad = expm(A dt), Bd the integral of expm(A t)
    over a period, Qd by Van Loan. The accelerometer's offset o is a fifth state, constant except for a random walk.
    Unlike bending, the offset does not decay, so the filter can separate offset and bending. At an instant t_k the
    filter predicts from t_k-1, with chi(k-1) and the input u that has acted since. It then updates with chi(k) and the
    same u, because the acceleration was sampled before the new command acts. The affine part d must be in the
    innovation: at the trim d is +0.212 rad/s^2, and without d the modal rates are biased. The sample "actuators"
    contains the actual fuel ratio and elevator, **clipped and held**, not the demanded values.

    With the default process noise, the filter tolerates modal frequencies 10 % off, at the price of a larger steady
    error. The noise is large for the slow mode 1 and small for mode 2, whose frequency is critical. With corrects=False
    the filter ignores the measurements. Compare every result with this prediction by the model alone, because **the
    error of the prediction also vanishes**, by structural damping.

    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206, eq. 9 and below, corrected. [1] does not give
             P(0), sampling and noise. Their values are our own choice, see docs page, Flexible modes.
    """

    craft: Hypersonic = part("Vehicle model used by the filter.", default=Hypersonic())
    Q: Any = quantity(
        "1", "Diagonal of the spectral density of the modal state's process noise.", default=TUNED_Q, shape=(4,)
    )
    R: Scalar = quantity("rad^2/s^4", "Noise variance of one sample of the pitch acceleration.", default=1e-4, above=0)
    P0: Any = quantity("1", "Initial variances of the modal state.", default=(1.0, 100.0, 1.0, 100.0), shape=(4,))
    eta0: Any = quantity("1", "Initial estimate of the modal state.", default=PRINTED_ETA0, shape=(4,), source="[1]")
    offset_sigma: Scalar = quantity(
        "rad/s^2",
        "Initial standard deviation of the accelerometer's offset; 0 to estimate no offset.",
        default=0.02,
        low=0,
    )
    offset_walk: Scalar = quantity(
        "rad^2/s^5", "Density of the random walk of the accelerometer's offset.", default=0.0, low=0
    )
    corrects: bool = option(
        "True: correct the estimated modes with measurements. False: predict the modes by the model alone.",
        default=True,
        choices=(True, False),
    )
    flight: str = option("Name of the sensor that measures the rigid-body state.", default="flight")
    accelerometer: str = option("Name of the angular accelerometer.", default="angular-accelerometer")
    actuators: str = option(
        "Name of the sensor that measures the acting fuel ratio and elevator angle.", default="actuators"
    )
    period: int = period("Time between predictions.", default=ms(5))

    @classmethod
    def from_publication(cls, **changes: Any) -> "FlexibleModeFilter":
        """Return the filter with Q = 1e-5 I and R = 10 as published, P(0) = I, no offset. The filter's gain is nearly
        zero."""
        return cls(**{"Q": PRINTED_Q, "R": 10.0, "P0": (1.0,) * 4, "offset_sigma": 0.0} | changes)

    @classmethod
    def with_equal_noise(cls, **changes: Any) -> "FlexibleModeFilter":
        """Return the filter with equal noise on both modal accelerations and no offset, as in the corrected study."""
        return cls(**{"Q": EQUAL_Q, "offset_sigma": 0.0} | changes)

    @classmethod
    def for_exact_model(cls, **changes: Any) -> "FlexibleModeFilter":
        """Return the filter with Q = 1e-5 I, R = 1e-4: best for an exact model, unstable if the modes are 10 % off."""
        return cls(**{"Q": PRINTED_Q, "R": 1e-4, "P0": (1.0,) * 4, "offset_sigma": 0.0} | changes)

    listens = property(listened_sensors)
    step = step_mode_filter

    def check(self) -> None:
        """Raise InputError if a variance is invalid or the period is too long for the discrete model."""
        check_variances("FlexibleModeFilter", Q=self.Q, P0=self.P0)
        if not math.isfinite(self.R):
            raise InputError(
                "FlexibleModeFilter.R",
                f"the noise variance must be finite, got {self.R}",
                fix="give a finite variance, or set corrects=False to ignore measurements",
            )
        A, _ = modal_dynamics(self.craft)
        norm = float(np.abs(np.asarray(A)).sum(1).max()) * to_seconds(self.period)
        if norm >= 16:
            most = format_time(int(self.period * 16 / norm))
            modes = f"{float(self.craft.modes.w1):g} and {float(self.craft.modes.w2):g} rad/s"
            problem = f"the period {format_time(self.period)} is too long for modes of {modes}"
            raise InputError("FlexibleModeFilter.period", problem, fix=f"set the period below {most}")

    def model(self) -> ModalModel:
        """Return the discrete model of one period."""
        A, C = modal_dynamics(self.craft)
        Ad, Bd, Qd = discretise(A, jnp.diag(jnp.asarray(self.Q)), to_seconds(self.period))
        return ModalModel(C, Ad, Bd, Qd)

    def init(self, key: Key) -> FlexibleModeState:
        """Return the filter's initial state, before any measurement."""
        model = self.model()
        return FlexibleModeState(
            model=model,
            eta=jnp.asarray(self.eta0),
            offset=jnp.zeros(()),
            P=jnp.diag(jnp.append(jnp.asarray(self.P0), self.offset_sigma**2)),
            bare=ModelPrediction(jnp.asarray(self.eta0), model.Ad, model.Bd),
            **first_instant(),
            seen=np.int64(NEVER),
        )

    def predict(self, model: ModalModel, x: Any, P: Any, chi: RigidFlight, u: HypersonicInput) -> tuple[Any, Any]:
        """Return modal state and offset x (5,) and covariance P (5, 5) after a period of constant chi and u."""
        b, _, _ = forcing(self.craft, chi, u)
        walk = self.offset_walk * to_seconds(self.period)
        modes, mixed = kalman.predict_covariance(P[:4, :4], model.Ad, model.Qd), model.Ad @ P[:4, 4]
        P = jnp.block([[modes, mixed[:, None]], [mixed[None], P[4:, 4:] + walk]])
        return jnp.append(model.Ad @ x[:4] + model.Bd @ b, x[4]), P

    def update(
        self, model: ModalModel, x: Any, P: Any, chi: RigidFlight, u: HypersonicInput, pitch_acceleration: Any
    ) -> kalman.Update:
        """Update x (5,) and P, in Joseph's form, with a pitch acceleration (rad/s^2) measured under the input u."""
        _, d, rigid = forcing(self.craft, chi, u)
        H = jnp.append(model.C, 1.0)
        r = pitch_acceleration - rigid - H @ x - d
        return kalman.update(x, P, r[None], H[None], jnp.asarray(self.R)[None, None])

    def estimated_flight(self, state: FlexibleModeState) -> FlexibleFlight:
        """Return the flight estimate, including the accelerometer's offset, from a state of the filter."""
        offset = AccelerometerOffset(state.offset, jnp.sqrt(jnp.maximum(state.P[4, 4], 0.0)))
        return replace(estimated_flight(self, state), offset=offset)

    def advance(self, t: Any, s: FlexibleModeState, frame: Frame) -> FlexibleModeState:
        """Return the state of the filter one period later."""
        samples = read_flight_samples(self.listens, s, frame)
        chi, u, felt, started = samples.chi, samples.u, samples.acceleration, samples.has_started
        before = jnp.append(s.eta, s.offset)
        x, P = self.predict(s.model, before, s.P, s.chi, u)
        x, P = jnp.where(s.started, x, before), jnp.where(s.started, P, s.P)
        correction = self.update(s.model, x, P, chi, u, felt.value.pitch_acceleration)
        used = started & samples.flight_usable & correction.accepted & felt.valid & is_new(felt, s.seen)
        used = used & self.corrects
        x = jnp.where(used, correction.x, x)
        return replace(
            s,
            eta=x[:4],
            offset=x[4],
            P=jnp.where(used, correction.P, P),
            **next_instant(t, s, samples),
            seen=jnp.where(used, felt.t, s.seen),
            innovation=correction.innovation[0],
            S=correction.S[0, 0],
            nis=correction.nis,
            updated=used,
        )
