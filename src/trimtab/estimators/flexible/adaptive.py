"""Estimate the bending modes and their frequencies from the pitch acceleration, starting from uncertain frequencies.

A single filter with eta and the frequencies in one state becomes overconfident. At rest eta_i = N_i/w_i^2: the
accelerometer measures only w_i^2 eta_i, so all pairs (eta_i, w_i) on a curve explain the measurement equally well. The
estimate of a linearised filter moves with the noise, and the filter uses another tangent of that curve at each step.
The filter's covariance therefore shrinks along the curve without information. In the scaled displacements

    s_i = (w_i/w_i0)^2 eta_i        s_i' = (w_i/w_i0)^2 eta_i'        lam_i = ln(w_i/w_i0)

the curve is a straight line along lam_i, with the same direction everywhere, and lam_i has an effect only while the
modes vibrate:

    r_i = N_i - w_i0^2 s_i - 2 zeta_i w_i0 exp(-lam_i) s_i'      s_i'' = exp(2 lam_i) eta_i''(r_1, r_2)

For constant lam_i these equations are exact, and linear in s. w_i0 are the nominal frequencies of the given vehicle.

Source: derived from [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for
hypersonic flight vehicle", Aerospace 2022, 9(4), 206, eq. 1, with the coupling as interpreted in the vehicle model.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.discretisation import discretise
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Frame, is_new
from trimtab.core.time import format_time, ms, to_seconds
from trimtab.estimators import kalman
from trimtab.estimators.flexible.discrete import PRINTED_ETA0
from trimtab.estimators.flexible.model import (
    FlexibleFlight,
    ModalFrequencies,
    ModelPrediction,
    RigidFlight,
    check_variances,
    first_instant,
    flexible_flight,
    forcing,
    listened_sensors,
    modal_dynamics,
    next_instant,
    read_flight_samples,
    step_mode_filter,
)
from trimtab.estimators.inertial.sensor_watch import NEVER
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput

TERMS = 6
"""Number of terms of the exponential series that propagates the modes over a step. The remainder is (w dt)^7/5040, e.g.
4e-11 at 22 rad/s and 5 ms."""
OF_MODE = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1]])
"""Matrix (4, 2): 1 where the row's quantity (s1, s1', s2, s2') belongs to the column's mode (1, 2), else 0."""
SHARE = 0.5
"""Standard deviation of the frequency within each hypothesis, as a fraction of the total initial standard deviation.
The rest of the deviation is represented by the spacing between hypotheses."""
HYPOTHESIS_SPACING = math.sqrt(1.5 * (1 - SHARE**2))
PROBABILITY_MIN = 1e-6
"""Approximate lower limit of a hypothesis's probability, so that each hypothesis can recover."""
CORNERS = np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
M = len(CORNERS)
"""Number of hypotheses: all combinations of a low, a nominal and a high frequency of the two modes."""


def stretch_factors(x: Any) -> Any:
    """Return the factor (w_i/w_i0)^2 of each of s1, s1', s2, s2' (4,), for x = (s1, s1', s2, s2', lam1, lam2)."""
    return OF_MODE @ jnp.exp(2 * x[4:])


def modal_accelerations(craft: Hypersonic, x: Any) -> tuple[Any, Any, Any]:
    """Return pitch acceleration Q' (rad/s^2), eta1'' and eta2'' caused by the modes' own motion x (6,)."""
    back1, back2 = craft.modes.restoring_forces(x[0], x[1] * jnp.exp(-x[4]), x[2], x[3] * jnp.exp(-x[5]))
    return craft.modes.solve_accelerations(craft.Iyy, 0.0, back1, back2)


def propagate_modes(craft: Hypersonic, x: Any, b: Any, dt: Any) -> Any:
    """Return the filter state x (6,) after dt (s) under a constant forcing b (4,) of the modal state.

    The equations are linear in s and are solved by an exponential series.
    """
    by, still = stretch_factors(x), jnp.zeros(2)

    def rate(s: Any) -> Any:
        _, first, second = modal_accelerations(craft, jnp.concatenate([s, x[4:]]))
        return jnp.stack([s[1], by[1] * first, s[3], by[3] * second])

    start = rate(x[:4]) + by * b
    total = start
    for k in range(TERMS, 1, -1):
        total = start + dt / k * rate(total)
    return x + dt * jnp.concatenate([total, still])


def vibration(craft: Hypersonic, x: Any, P: Any, b: Any) -> tuple[Any, Any]:
    """Return the vibration of each mode, eta_i''^2 + w_i^2 eta_i'^2 (2,), and the uncertainty of each mode in the same
    unit (2,), from the covariance P (6, 6)."""
    _, first, second = modal_accelerations(craft, x)
    by, w0 = stretch_factors(x), jnp.stack([craft.modes.w1, craft.modes.w2])
    w = w0 * jnp.exp(x[4:])
    rate = jnp.stack([x[1] / by[1], x[3] / by[3]])
    moves = jnp.stack([first + b[1], second + b[3]]) ** 2 + (w * rate) ** 2
    displacement, velocity = jnp.stack([P[0, 0], P[2, 2]]), jnp.stack([P[1, 1], P[3, 3]])
    return moves, (w0 / w) ** 4 * w**2 * (w**2 * displacement + velocity)


def disturbance_direction(craft: Hypersonic, x: Any) -> Any:
    """Return the derivative of the filter state x (6,) due to a pitching moment that alone causes 1 rad/s^2 of
    pitch."""
    q_rate, first, second = craft.modes.solve_accelerations(craft.Iyy, craft.Iyy, 0.0, 0.0)
    by, still = stretch_factors(x), jnp.zeros_like(q_rate)
    return jnp.stack([still, by[1] * first / q_rate, still, by[3] * second / q_rate, still, still])


def unstretch(x: Any, P: Any) -> tuple[Any, Any]:
    """Return the vector (eta1, eta1', eta2, eta2', lam1, lam2) and its covariance (6, 6), to first order.

    x: state (s1, s1', s2, s2', lam1, lam2) of the filter, with the scaled displacements s_i = (w_i/w_i0)^2 eta_i.
    P: covariance of x.
    """
    soft = 1 / stretch_factors(x)
    eta = soft * x[:4]
    top = jnp.concatenate([jnp.eye(4) * soft, -2 * eta[:, None] * OF_MODE], axis=1)
    G = jnp.concatenate([top, jnp.eye(6)[4:]])
    return jnp.concatenate([eta, x[4:]]), G @ P @ G.T


def mixture_mean(x: Any, P: Any, p: Any) -> tuple[Any, Any]:
    """Return mean (6,) and covariance (6, 6) of (eta1, eta1', eta2, eta2', lam1, lam2) over all hypotheses.

    Each hypothesis has a state x (m, 6), a covariance P (m, 6, 6) and a probability p (m,).
    """
    y, V = jax.vmap(unstretch)(x, P)
    mean = p @ y
    off = y - mean
    spread = V + off[:, :, None] * off[:, None, :]
    return mean, (p @ spread.reshape(-1, 36)).reshape(6, 6)


@record
class AdaptiveModeState:
    """State of the adaptive filter of the bending modes. Source: docs page, Adaptive flexible modes."""

    x: Any = quantity("1", "Filter state of each hypothesis: s1, s1', s2, s2', ln w1/w1_0, ln w2/w2_0.", shape=(M, 6))
    P: Any = quantity("1", "Covariance of each hypothesis's state.", shape=(M, 6, 6))
    p: Any = quantity("1", "Probability of each hypothesis.", shape=(M,))
    Qd: Any = quantity("1", "Covariance of the process noise of one period, at nominal frequencies.", shape=(4, 4))
    mean: Any = quantity(
        "1", "Mean over the hypotheses of eta1, eta1', eta2, eta2', ln w1/w1_0, ln w2/w2_0.", shape=(6,)
    )
    spread: Any = quantity("1", "Covariance of the mean estimate, including the spread of hypotheses.", shape=(6, 6))
    w: Any = quantity("rad/s", "Estimated natural frequencies of modes 1 and 2.", shape=(2,))
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
    learned: Scalar = quantity("1", "True if the frequencies were corrected in the last step.", kind="flag")
    bounded: Scalar = quantity("1", "True if a frequency was held at its bound in the last step.", kind="flag")


@record
class AdaptiveFlexibleModeFilter:
    """Nine extended Kalman filters of modal state and both natural frequencies, weighted by their likelihood.

        x = (s1, s1', s2, s2', ln w1/w1_0, ln w2/w2_0)      s_i = (w_i/w_i0)^2 eta_i      p_m ~ p_m N(r_m; 0, S_m)

    p_m, r_m and S_m are the probability of filter m, its innovation and the variance of this innovation. A single
    filter is not enough: if the frequencies are 10 % off, mode 2 is near the expected frequency of mode 1, and the
    filter converges to the wrong mode. Of nine filters that start at frequencies about 10 % apart, one converges to the
    right modes. The estimate is the weighted mean of the filters. The covariance of the estimate includes the spread of
    the filters.

    - Frequencies and probabilities change only while the vibration of the modes is at least `excitation` standard
      deviations of its uncertainty. Otherwise the uncertainty of the frequencies is considered, but the frequencies are
      not corrected. **At rest the frequencies can't be estimated.**
    - An innovation with NIS above `gate` is attributed to an unknown moment (a jolt), not to noise. The square of the
      innovation is added to the measurement variance R, the covariance P grows by the effect of this moment on the
      modes, and the frequencies are not corrected.
    - The frequencies of each filter follow a slow random walk. The standard deviation of a frequency does not grow
      above its initial value, and the frequency stays within `bound`.

    Not modelled: damping and coupling that differ from those of the vehicle model; noise of the measured rigid-body
                  state.
    Source:  beyond [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for
             hypersonic flight vehicle", Aerospace 2022, 9(4), 206; [4] Bar-Shalom, Li, Kirubarajan, "Estimation with
             applications to tracking and navigation", Wiley 2001, section 11.6 (static multiple models).
    """

    craft: Hypersonic = part("Vehicle model used by the filter, with nominal frequencies.", default=Hypersonic())
    Q: Any = quantity("1", "Diagonal of the process noise density.", default=(1e-5, 0.1, 1e-5, 0.1), shape=(4,))
    R: Scalar = quantity("rad^2/s^4", "Noise variance of one sample of the pitch acceleration.", default=1e-4, above=0)
    P0: Any = quantity(
        "1", "Initial variances of the modal state at known frequencies.", default=(1.0, 100.0, 1.0, 100.0), shape=(4,)
    )
    eta0: Any = quantity(
        "1", "Initial modal state, at nominal frequencies.", default=PRINTED_ETA0, shape=(4,), source="[1]"
    )
    deviation: Any = quantity("1", "Initial standard deviations of ln w1 and ln w2.", default=(0.1, 0.1), shape=(2,))
    walk: Any = quantity("1/s", "Densities of the random walks of ln w1 and ln w2.", default=(1e-6, 1e-6), shape=(2,))
    bound: Scalar = quantity(
        "1", "Largest factor by which an estimated frequency may differ from nominal.", default=1.25, above=1
    )
    excitation: Scalar = quantity(
        "1",
        "Smallest vibration at which the frequencies are corrected, in standard deviations of the estimated vibration.",
        default=3.0,
        low=0,
    )
    gate: Scalar = quantity(
        "1", "NIS above which an innovation is attributed to a jolt (an unknown moment).", default=16.0, above=0
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

    listens = property(listened_sensors)
    step = step_mode_filter

    def check(self) -> None:
        """Raise InputError if a variance, the bound or the period is invalid."""
        name = "AdaptiveFlexibleModeFilter"
        check_variances(name, Q=self.Q, P0=self.P0)
        for field, pair in {"deviation": self.deviation, "walk": self.walk}.items():
            values = np.asarray(pair, float)
            if not (np.isfinite(values).all() and (values >= 0).all()):
                problem = f"both values must be finite and at least 0, got {values.tolist()}"
                raise InputError(f"{name}.{field}", problem, fix="give two finite numbers of at least 0")
        for field, value in {"R": self.R, "bound": self.bound, "excitation": self.excitation}.items():
            if not math.isfinite(value):
                raise InputError(
                    f"{name}.{field}", f"the value must be finite, got {value}", fix="give a finite number"
                )
        outermost = math.exp(HYPOTHESIS_SPACING * float(np.max(self.deviation)))
        if outermost >= self.bound:
            problem = (
                "the frequencies of the hypotheses differ from nominal by a factor of up to "
                f"{outermost:.3g}, which must be below {float(self.bound):g}"
            )
            raise InputError(f"{name}.bound", problem, fix="raise the bound, or choose a smaller `deviation`")
        fastest = float(max(self.craft.modes.w1, self.craft.modes.w2) * self.bound)
        if fastest * to_seconds(self.period) >= 0.5:
            problem = f"the period {format_time(self.period)} is too long for a mode of {fastest:g} rad/s"
            raise InputError(
                f"{name}.period", problem, fix=f"set the period below {format_time(int(0.5 / fastest * 1e7))}"
            )

    def init(self, key: Key) -> AdaptiveModeState:
        """Return the filter's initial state, before any measurement."""
        no, deviation = jnp.asarray(False), jnp.asarray(self.deviation)
        A, _ = modal_dynamics(self.craft)
        model = discretise(A, jnp.diag(jnp.asarray(self.Q)), to_seconds(self.period))
        lam = CORNERS * HYPOTHESIS_SPACING * deviation
        x = jnp.concatenate([jnp.broadcast_to(jnp.asarray(self.eta0), (M, 4)), lam], axis=1)
        P = jnp.diag(jnp.concatenate([jnp.asarray(self.P0), (SHARE * deviation) ** 2]))
        P, p = jnp.broadcast_to(P, (M, 6, 6)), jnp.full(M, 1 / M)
        mean, spread = mixture_mean(x, P, p)
        return AdaptiveModeState(
            x=x,
            P=P,
            p=p,
            Qd=model.Qd,
            mean=mean,
            spread=spread,
            w=self._frequencies(mean),
            bare=ModelPrediction(jnp.asarray(self.eta0), model.Ad, model.Bd),
            **first_instant(),
            seen=np.int64(NEVER),
            learned=no,
            bounded=no,
        )

    def predict(self, x: Any, P: Any, Qd: Any, b: Any) -> tuple[Any, Any]:
        """Return the state x (6,) and covariance P (6, 6) of one hypothesis after one period of constant forcing b
        (4,)."""
        dt, by, still = to_seconds(self.period), stretch_factors(x), jnp.zeros((4, 2))
        F = jax.jacfwd(lambda x: propagate_modes(self.craft, x, b, dt))(x)
        room = (SHARE * jnp.asarray(self.deviation)) ** 2 - jnp.stack([P[4, 4], P[5, 5]])
        grown = jnp.minimum(jnp.asarray(self.walk) * dt, jnp.maximum(room, 0.0))
        noise = jnp.block([[Qd * by[:, None] * by, still], [still.T, jnp.diag(grown)]])
        return propagate_modes(self.craft, x, b, dt), kalman.predict_covariance(P, F, noise)

    def update(self, x: Any, P: Any, modal: Any, b: Any) -> tuple[Any, ...]:
        """Update one hypothesis with a pitch acceleration (rad/s^2) caused by the modes, under a forcing b (4,) of the
        modal state.

        Returns: x, P, innovation, variance of the innovation, log-likelihood, flags (2,) that are True for each
        frequency that was corrected, and a flag that is True if a frequency was held at its bound.
        """
        expected = modal_accelerations(self.craft, x)[0]
        H = jax.jacfwd(lambda x: modal_accelerations(self.craft, x)[0])(x)
        r = modal - expected
        S = H @ P @ H + self.R
        noise = r * r <= self.gate * S
        moves, doubt = vibration(self.craft, x, P, b)
        learns = noise & (moves > self.excitation**2 * doubt)
        consider = jnp.concatenate([jnp.ones(4), jnp.where(learns, 1.0, 0.0)])
        moment = jnp.where(noise, 0.0, r * r)
        correction = kalman.update(x, P, r[None], H[None], (self.R + moment)[None, None], consider=consider)
        shaken = to_seconds(self.period) * disturbance_direction(self.craft, x)
        most = jnp.log(self.bound)
        lam = jnp.clip(correction.x[4:], -most, most)
        likely = -(jnp.log(S) + jnp.minimum(r * r / S, self.gate)) / 2
        new_P = correction.P + moment * shaken[:, None] * shaken
        return jnp.concatenate([correction.x[:4], lam]), new_P, r, S, likely, learns, jnp.any(lam != correction.x[4:])

    def advance(self, t: Any, s: AdaptiveModeState, frame: Frame) -> AdaptiveModeState:
        """Return the state of the filter one period later."""
        samples = read_flight_samples(self.listens, s, frame)
        chi, u, felt, started = samples.chi, samples.u, samples.acceleration, samples.has_started
        b, d, rigid = forcing(self.craft, chi, u)
        between = (forcing(self.craft, s.chi, u)[0] + b) / 2
        x, P = jax.lax.map(lambda one: self.predict(one[0], one[1], s.Qd, between), (s.x, s.P))
        x, P = jnp.where(s.started, x, s.x), jnp.where(s.started, P, s.P)
        modal = felt.value.pitch_acceleration - rigid - d
        finite = jnp.isfinite(modal)
        used = started & samples.flight_usable & finite & felt.valid & is_new(felt, s.seen) & self.corrects
        felt_modal = jnp.where(finite, modal, 0.0)
        correction = jax.lax.map(lambda one: self.update(one[0], one[1], felt_modal, b), (x, P))
        new_x, new_P, r, S, likely, learns, bounded = correction
        x, P = jnp.where(used, new_x, x), jnp.where(used, new_P, P)
        innovation = s.p @ r
        variance = s.p @ (S + (r - innovation) ** 2)
        innovation = jnp.where(finite, innovation, 0.0)
        learned = used & (s.p @ jnp.where(jnp.any(learns, axis=1), 1.0, 0.0) > 0.5)
        p = jnp.where(learned, update_probabilities(s.p, likely), s.p)
        mean, spread = mixture_mean(x, P, p)
        return replace(
            s,
            x=x,
            P=P,
            p=p,
            mean=mean,
            spread=spread,
            w=self._frequencies(mean),
            **next_instant(t, s, samples),
            seen=jnp.where(used, felt.t, s.seen),
            innovation=innovation,
            S=variance,
            nis=innovation * innovation / variance,
            updated=used,
            learned=learned,
            bounded=used & (s.p @ jnp.where(bounded, 1.0, 0.0) > 0.5),
        )

    def estimated_flight(self, state: AdaptiveModeState) -> FlexibleFlight:
        """Return the estimate: the mean over the hypotheses, with standard deviations that include the spread of the
        hypotheses."""
        sigma = jnp.sqrt(jnp.maximum(jnp.stack([state.spread[i, i] for i in range(6)]), 0.0))
        frequencies = ModalFrequencies(
            w1=state.w[0],
            w2=state.w[1],
            w1_sigma=state.w[0] * sigma[4],
            w2_sigma=state.w[1] * sigma[5],
            learned=state.learned,
            bounded=state.bounded,
        )
        return replace(flexible_flight(state, state.mean[:4], sigma[:4] ** 2), frequencies=frequencies)

    def _frequencies(self, mean: Any) -> Any:
        return jnp.stack([self.craft.modes.w1, self.craft.modes.w2]) * jnp.exp(mean[4:])


def update_probabilities(p: Any, likely: Any) -> Any:
    """Return the probabilities (m,) of the hypotheses after a measurement with the log-likelihoods `likely` (m,).

    No probability falls below about PROBABILITY_MIN.
    """
    p = p * jnp.exp(likely - jnp.max(likely))
    p = jnp.maximum(p / jnp.sum(p), PROBABILITY_MIN)
    return p / jnp.sum(p)
