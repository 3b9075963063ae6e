"""Flights for the trade-off between elevator activity, tracking and robustness, by settings of filter and gain.

Elevator activity is the part due to noise: a run minus the same run without noise, so that the climb's own demand is
excluded. It is evaluated after SETTLED, which excludes the initial error of the estimate.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from studies.hypersonic2022._linear_loop import DETUNED, NOISE
from trimtab.core.time import ms, to_seconds
from trimtab.design.lqr import lqr
from trimtab.estimators.flexible.discrete import EQUAL_Q, PRINTED_Q, TUNED_Q
from trimtab.laws.stable_inversion import K_FLOWN
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import Batch, simulate_batch
from trimtab.scenarios.hypersonic import noise, step_gust
from trimtab.scenarios.hypersonic._design import ALLOWED, ALLOWED_INPUT, SCALE, error_model

SEEDS = 20
SETTLED, LAST = 20.0, 10.0
"""Start of the statistics (s), and duration at the end of a flight over which the largest error is taken (s)."""
SIGNALS = ("actuators.u.delta_e", "law.h_error", "law.V_error", "law.outside", "truth.eta1", "estimate.state.eta1")
QUIET = "world.sensors.angular-accelerometer.noise"


class Setting(NamedTuple):
    """Setting of filter and law.

    Q: process noise of the filter, diagonal (4,).  R: variance of a sample in the filter.  P0: initial variances of the
    filter (4,).  K: gain of the law (2, 9).
    """

    name: str
    Q: tuple[float, ...]
    R: float = 1e-4
    P0: tuple[float, ...] = (1.0, 100.0, 1.0, 100.0)
    K: Any = K_FLOWN


class Activity(NamedTuple):
    """Performance of one setting, over seeds.

    elevator, h_noise: rms of the part due to noise (rad, ft).  offset: mean of that part in h (ft).
    h, V: rms of the errors (ft, ft/s).
    """

    elevator: Any
    h_noise: Any
    offset: Any
    h: Any
    V: Any


class DetunedErrors(NamedTuple):
    """Robustness of one setting, over DETUNED and seeds, (8, seeds).

    lost: True if the flight left the envelope.  h: rms of the error (ft), infinite if the flight diverged.
    eta1: largest error of mode 1 at the end.
    """

    lost: Any
    h: Any
    eta1: Any


EQUAL = Setting("100 on both modes", EQUAL_Q)
BETTER = Setting("500 on mode 1, 6 on mode 2", TUNED_Q)
ACCURATE = Setting("for an exact model", PRINTED_Q, 1e-4, (1.0,) * 4)
PRINTED = Setting("printed", PRINTED_Q, 10.0, (1.0,) * 4)
EQUAL_SETTINGS = tuple(
    Setting(f"{q:g} on both modes", (1e-5, q, 1e-5, q)) for q in (1.0, 3.0, 10.0, 30.0, 300.0, 1000.0)
)
SEPARATE_SETTINGS = tuple(
    Setting(f"{a:g} on mode 1, {b:g} on mode 2", (1e-5, a, 1e-5, b))
    for a, b in ((10.0, 2.0), (30.0, 3.0), (100.0, 4.0), (200.0, 5.0), (300.0, 5.0), (800.0, 8.0))
)
SCALED = Setting(
    "equal noise, Q, R and P(0) ten times", tuple(10 * q for q in EQUAL_Q), 1e-3, tuple(10 * p for p in EQUAL.P0)
)


def weighted_gain(h: float = 1.0, V: float = 1.0, modes: float = 1e3) -> Any:
    """Return the gain (2, 9) of a regulator with other weights."""
    allowed = np.append(ALLOWED[:5], [modes, 17 * modes] * 2 if modes < 1e3 else ALLOWED[5:])
    linear, _ = error_model()
    R = np.diag((ALLOWED_INPUT * np.array([h, V])) ** -2.0)
    return lqr(linear.A, linear.B, np.diag(allowed**-2.0), R, scale=SCALE).K


def fly_noise(settings: Sequence[Setting], seeds: int = SEEDS, size: float = NOISE) -> list[Activity]:
    """Fly the large climb with noise of this size (rad/s^2), and once without, for each setting."""
    runs = [(s, seed, size) for s in settings for seed in range(seeds)] + [(s, 0, 0.0) for s in settings]
    more = {QUIET: np.array([sigma for _, _, sigma in runs])}
    batch = _fly_settings(noise.scenario(integral="off"), [r[0] for r in runs], [r[1] for r in runs], more)
    late = to_seconds(batch.ticks) > SETTLED
    noisy, n = len(settings) * seeds, len(settings)
    elevator, h, V = (batch.log[path][:noisy, late].reshape(n, seeds, -1) for path in SIGNALS[:3])
    quiet = [batch.log[path][noisy:, None, late] for path in SIGNALS[:2]]
    added = h - quiet[1]
    found = (_rms(elevator - quiet[0]), _rms(added), added.mean(-1), _rms(h), _rms(V))
    return [Activity(*(v[i] for v in found)) for i in range(n)]


def fly_detuned(settings: Sequence[Setting], seeds: int = SEEDS) -> list[DetunedErrors]:
    """Fly the large climb with noise and the plant's modal frequencies 10 % off in each way, for each setting."""
    flown = noise.scenario(integral="off")
    modes, x = flown.world.vehicle.modes, flown.initial
    runs = [(s, seed, at) for s in settings for at in DETUNED for seed in range(seeds)]
    a, b = np.array([at for _, _, at in runs]).T
    more = {"world.vehicle.modes.w1": modes.w1 * a, "world.vehicle.modes.w2": modes.w2 * b}
    more |= {"initial.eta1": float(x.eta1) / a**2, "initial.eta2": float(x.eta2) / b**2}
    batch = _fly_settings(flown, [r[0] for r in runs], [r[1] for r in runs], more)
    t = to_seconds(batch.ticks)
    shape = (len(settings), len(DETUNED), seeds)
    lost = ~(batch.most["law.outside"] == 0).reshape(shape)
    h = _rms(batch.log["law.h_error"][:, t > SETTLED]).reshape(shape)
    off = np.abs(batch.log["estimate.state.eta1"] - batch.log["truth.eta1"])[:, t > t[-1] - LAST].max(axis=1)
    h, off = np.where(np.isfinite(h), h, np.inf), np.where(np.isfinite(off), off, np.inf).reshape(shape)
    return [DetunedErrors(lost[i], h[i], off[i]) for i in range(len(settings))]


def fly_offsets(settings: Sequence[Setting]) -> list[tuple[float, float]]:
    """Return each setting's final errors of h (ft) and V (ft/s) under a constant moment of 5000 lbf, without noise."""
    flown = step_gust.scenario(kind="large-moment", noise="off", integral="off")
    batch = _fly_settings(flown, settings, [0] * len(settings), {})
    return [(float(h[-1]), float(V[-1])) for h, V in zip(*(batch.log[p] for p in SIGNALS[1:3]), strict=True)]


@cache
def trade_curve(seeds: int = SEEDS) -> list[tuple[Setting, Activity]]:
    """Return all settings of the filter with their flights: first equal noise on both modes, then different noise."""
    settings = (*EQUAL_SETTINGS, EQUAL, *SEPARATE_SETTINGS, BETTER)
    return list(zip(settings, fly_noise(settings, seeds), strict=True))


def _fly_settings(flown: Scenario, settings: Sequence[Setting], seeds: Sequence[int], more: dict[str, Any]) -> Batch:
    each = {
        "autopilot.estimator.Q": np.array([s.Q for s in settings]),
        "autopilot.estimator.R": np.array([s.R for s in settings]),
        "autopilot.estimator.P0": np.array([s.P0 for s in settings]),
        "autopilot.law.K": np.array([np.asarray(s.K) for s in settings]),
    }
    return simulate_batch(flown, seeds=seeds, spread=each | more, signals=SIGNALS, log_period=ms(50), log=True)


def _rms(values: Any) -> Any:
    with np.errstate(over="ignore", invalid="ignore"):  # a diverged run
        return np.sqrt(np.mean(values**2, axis=-1))
