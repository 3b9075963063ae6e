"""The filter of the bending modes in continuous time, as published, integrated between samples."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.discretisation import discretise
from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.linalg import symmetric
from trimtab.core.record import Scalar, option, part, period, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Frame
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.flexible.discrete import PRINTED_ETA0, PRINTED_Q
from trimtab.estimators.flexible.model import (
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
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput

STABLE = 2.5
"""Largest decay rate times step accepted for RK4, whose stability limit is 2.78."""


@record
class ContinuousModeState:
    """State of the filter. Source: docs page, Flexible modes in continuous time."""

    eta: Any = quantity("1", "Estimated modal state eta1, eta1', eta2, eta2'.", shape=(4,))
    P: Any = quantity("1", "Covariance of the modal state.", shape=(4, 4))
    modal: Scalar = quantity(
        "rad/s^2", "Last measured C eta: pitch acceleration minus the part due to flight and input."
    )
    used: Scalar = quantity("1", "True if the last measurement of C eta can be used.", kind="flag")
    bare: ModelPrediction = part("Prediction of the modes by the model alone.")
    chi: RigidFlight = part("Rigid-body state at the last step.")
    u: HypersonicInput = part("Input that acted in the last step.")
    t: Scalar = quantity("100 ns", "Time of the last step.", kind="time")
    flight_t: Scalar = quantity("100 ns", "Time at which chi was measured.", kind="time")
    started: Scalar = quantity("1", "True once flight and input have been received.", kind="flag")
    innovation: Scalar = quantity("rad/s^2", "Innovation of the last step.")
    S: Scalar = quantity("rad^2/s^4", "Variance of the innovation of one sample, with noise R/dt.")
    nis: Scalar = quantity("1", "NIS: innovation squared over its variance S.")
    updated: Scalar = quantity("1", "True if a measurement was used in the last step.", kind="flag")


@record
class ContinuousModeFilter:
    """Kalman-Bucy filter of the modal state (eta1, eta1', eta2, eta2') with exactly known forcing.

        eta' = A eta + b(chi, u) + L (Q'_m - M/Iyy - C eta - d(chi, u))          L = P C'/R
        P' = A P + P A' + Q - P C' C P/R                                         [1, eq. 9 and below, corrected]

    Over a step, b and the measurement minus its affine part are held constant. eta and P are integrated by RK4, in
    `substeps`. R is a density. The default values are the printed Q and R. They give a gain of practically zero. Large
    gains make the equations stiff, and `check` rejects a step that is too long for P(0). Flights use
    `FlexibleModeFilter`.

    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206. Its P(0) is not printed. The default is an assumption.
    """

    craft: Hypersonic = part("Vehicle model used by the filter.", default=Hypersonic())
    Q: Any = quantity("1", "Process noise, diagonal of its density.", default=PRINTED_Q, shape=(4,), source="[1]")
    R: Scalar = quantity("rad^2/s^3", "Density of the noise of the acceleration.", default=10.0, above=0, source="[1]")
    P0: Any = quantity("1", "Initial variances of the modal state.", default=(1.0, 1.0, 1.0, 1.0), shape=(4,))
    eta0: Any = quantity("1", "Initial estimate of the modal state.", default=PRINTED_ETA0, shape=(4,), source="[1]")
    substeps: int = option("Integration steps per period.", default=1)
    flight: str = option("Name of the sensor that gives the rigid-body state.", default="flight")
    accelerometer: str = option("Name of the angular accelerometer.", default="angular-accelerometer")
    actuators: str = option("Name of the sensor that gives the acting fuel ratio and elevator.", default="actuators")
    period: int = period("Time between samples.", default=ms(5))

    listens = property(listened_sensors)
    step = step_mode_filter
    estimated_flight = estimated_flight

    def check(self) -> None:
        """Raise InputError if a variance is invalid or the step is unstable for the initial gain."""
        check_variances("ContinuousModeFilter", Q=self.Q, P0=self.P0)
        A, C = (np.asarray(m) for m in modal_dynamics(self.craft))
        fastest = float(np.abs(np.linalg.eigvals(A)).max() + 2 * (C * C) @ np.asarray(self.P0, float) / self.R)
        step = to_seconds(self.period) / self.substeps
        if not fastest * step < STABLE:
            problem = f"P(0) and R give rates of {fastest:.3g} 1/s, too fast for steps of {step:.3g} s"
            least = int(np.ceil(fastest * to_seconds(self.period) / STABLE))
            raise InputError(
                "ContinuousModeFilter.substeps", problem, fix=f"set it to at least {least}, or use FlexibleModeFilter"
            )

    def init(self, key: Key) -> ContinuousModeState:
        """Return the initial state, before any measurement."""
        no, zero = jnp.asarray(False), jnp.asarray(0.0)
        A, _ = modal_dynamics(self.craft)
        model = discretise(A, jnp.diag(jnp.asarray(self.Q)), to_seconds(self.period))
        return ContinuousModeState(
            eta=jnp.asarray(self.eta0),
            P=jnp.diag(jnp.asarray(self.P0)),
            modal=zero,
            used=no,
            bare=ModelPrediction(jnp.asarray(self.eta0), model.Ad, model.Bd),
            **first_instant(),
        )

    def integrate(self, eta: Any, P: Any, b: Any, modal: Any, used: Any) -> tuple[Any, Any]:
        """Return eta (4,) and P (4, 4) after a period of constant forcing b (4,). used: True if `modal` is valid."""
        A, C = modal_dynamics(self.craft)
        Q, weight = jnp.diag(jnp.asarray(self.Q)), jnp.where(used, 1 / self.R, 0.0)

        def rate(t: Any, both: Any) -> Any:
            eta, P = both
            L = P @ C * weight
            return A @ eta + b + L * (modal - C @ eta), A @ P + P @ A.T + Q - jnp.outer(L, P @ C)

        h = to_seconds(self.period) / self.substeps
        for _ in range(self.substeps):
            eta, P = rk4(rate, 0.0, (eta, P), h)
        return eta, symmetric(P)

    def advance(self, t: Any, s: ContinuousModeState, frame: Frame) -> ContinuousModeState:
        """Return the state of the filter after one of its periods."""
        samples = read_flight_samples(self.listens, s, frame)
        chi, u, felt, started = samples.chi, samples.u, samples.acceleration, samples.has_started
        eta, P = self.integrate(s.eta, s.P, forcing(self.craft, s.chi, u)[0], s.modal, s.used)
        eta, P = jnp.where(s.started, eta, s.eta), jnp.where(s.started, P, s.P)
        _, d, rigid = forcing(self.craft, chi, u)
        _, C = modal_dynamics(self.craft)
        modal = felt.value.pitch_acceleration - rigid - d
        used = started & samples.flight_usable & felt.valid & jnp.isfinite(modal)
        modal = jnp.where(used, modal, 0.0)
        r = jnp.where(used, modal - C @ eta, 0.0)
        S = C @ P @ C + self.R / to_seconds(self.period)
        return replace(
            s,
            eta=eta,
            P=P,
            modal=modal,
            used=used,
            **next_instant(t, s, samples),
            innovation=r,
            S=S,
            nis=r * r / S,
            updated=used,
        )
