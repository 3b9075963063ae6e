"""Dryden and von Kármán turbulence, with the scale lengths and intensities of the military specification.

The turbulence is frozen while the vehicle flies through it: a wave of length l passes with the frequency V/l. Each
component is white noise through a shaping filter, discretised exactly, so its statistics do not depend on the step.

[1] MIL-F-8785C, "Flying qualities of piloted airplanes", 1980, sections 3.7.1 to 3.7.3. [2] MIL-HDBK-1797, "Flying
qualities of piloted aircraft", 1997, appendix A, 4.9 (calls the same lengths 2 L; gives rational forms of von
Kármán's spectra).
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.discretisation import discretise
from trimtab.core.linalg import semidefinite_root
from trimtab.core.record import Scalar, imperfection, option, part, period, quantity, record
from trimtab.core.rng import Key, normals
from trimtab.core.signals import Gust, Motion, surrounding_air
from trimtab.core.time import ms, to_seconds
from trimtab.environment.discrete_gust import DiscreteGust

FOOT = 0.3048
LOW, HIGH, GROUND = 1000 * FOOT, 2000 * FOOT, 10 * FOOT
"""Heights above ground (m). [1] has one model below LOW and another model above HIGH; between these heights, the two
models are blended. GROUND is the lowest height of the lower model."""
HIGH_LENGTHS: Mapping[str, float] = MappingProxyType({"dryden": 1750 * FOOT, "von-karman": 2500 * FOOT})
"""Scale length (m) of all three components of the turbulence at heights above HIGH. Source: [1] 3.7.2.1."""
HEIGHTS = FOOT * np.array([500, 1750, 3750, 7500, 15e3, 25e3, 35e3, 45e3, 55e3, 65e3, 75e3, 80e3])
LEVELS = np.array([np.log10(0.2), -1, -2, -3, -4, -5, -6])
"""Decimal logarithm of the probability of exceedance for each row of INTENSITIES."""
INTENSITIES = FOOT * np.array(
    [
        [3.2, 2.2, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [4.2, 3.6, 3.3, 1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0],
        [8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0],
        [11.8, 13.0, 16.0, 15.1, 11.6, 9.7, 8.1, 8.2, 7.9, 4.9, 3.2, 2.1],
        [15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1],
        [18.7, 21.5, 28.4, 30.2, 30.7, 31.0, 25.2, 23.1, 17.5, 10.7, 8.4, 7.2],
    ]
)
"""Standard deviation of the turbulence (m/s). There is one row for each of LEVELS and one column for each of HEIGHTS.
Source: [1] figure 7, as tabulated in flight simulators."""
FILTERS: Mapping[str, Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]] = MappingProxyType(
    {
        "dryden": {"along": ((2**0.5,), (1.0, 1.0)), "across": ((1.0, 3**0.5), (1.0, 2.0, 1.0))},
        "von-karman": {
            "along": ((2**0.5, 0.25 * 2**0.5), (1.0, 1.357, 0.1987)),
            "across": ((1.0, 2.7478, 0.3398), (1.0, 2.9958, 1.9754, 0.1539)),
        },
    }
)
"""Numerator and denominator of each filter in powers of s L/V, lowest first. White noise of intensity L/V gives a
component of variance one. Source: [1] 3.7.5 (Dryden); [2] table of the rational forms (von Kármán)."""
LONGEST_STEP, FASTEST_RATE = 0.75, 12.0
"""Two upper limits of the gust's update period: as a fraction of L/V (scale length over airspeed), and as a multiple of
the time constant of an angular rate."""


class TurbulenceScales(NamedTuple):
    """Scales of the turbulence at a position: lengths (3,) (m) and standard deviations (3,) (m/s), along B's axes."""

    lengths: Any
    sigmas: Any


@record
class TurbulenceState:
    """States of the shaping filters, each with a variance of about one. Frames: B. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    begun: Scalar = quantity("1", "True once a first gust has been computed.", kind="flag")
    forward: Any = quantity("1", "Filter state of the velocity component along x.")
    side: Any = quantity("1", "Filter state of the velocity component along y, followed by the state of the yaw rate.")
    down: Any = quantity(
        "1", "Filter state of the velocity component along z, followed by the state of the pitch rate."
    )
    roll: Scalar = quantity("1", "Filter state of the roll rate.")
    distance: Scalar = quantity("m", "Distance flown into the discrete gust.")


@record
class Turbulence:
    """Turbulent air with three velocity components and three angular rates, and an additional single gust.

        u: 1st (Dryden) or 2nd order, v and w: 2nd or 3rd order filters of white noise, with L, sigma, V
        q = -dw/dx, through 1/(1 + 4b s/(pi V));   r = dv/dx, through 1/(1 + 3b s/(pi V));   p: a separate noise

    Lengths and intensities depend on the height. Below 1000 ft the intensities follow from the wind at 20 ft above the
    ground. Above 2000 ft they follow from the probability with which they are exceeded (1e-1 light, 1e-3 moderate, 1e-5
    severe).

    Frames:  B: x forward, y starboard, z down, at all heights (near the ground [1] takes the wind's horizontal axes).
    Valid:   rms far below the airspeed; V of at least 1 m/s; period below 0.75 L/V; heights up to 80 000 ft;
             higher up the values of 80 000 ft are used. The rational forms stay within 5 % of von Kármán's law up to L
             Omega = 10, and fall off faster beyond. Not modelled: patches, non-normal turbulence, thermals.
    Source:  [1] MIL-F-8785C; [2] MIL-HDBK-1797. The signs of q and r are those of the air's rotation, from the gradient
             along x.
    """

    form: str = option("Form of the turbulence spectra.", default="dryden", choices=tuple(FILTERS))
    intensity: Scalar = imperfection(
        "1", "Factor on all standard deviations of the turbulence.", "turbulence", default=1.0
    )
    wind: Scalar = quantity(
        "m/s", "Wind at 20 ft above the ground: 7.7 light, 15.4 moderate, 23.2 severe.", default=15.4, low=0
    )
    exceedance: Scalar = quantity(
        "1",
        "Probability that the intensity of the turbulence is exceeded, 1e-6 to 0.2.",
        default=1e-3,
        low=1e-6,
        high=0.2,
    )
    span: Scalar = quantity("m", "Wing span b. Angular rates of the air are averaged over it.", default=10.0, above=0)
    ground: Scalar = quantity("m", "Height of the ground above sea level.", default=0.0)
    discrete: DiscreteGust = part("Additional single gust.", default=DiscreteGust())
    period: int = period("Time between updates of the gust.", default=ms(5))

    def at(self, height: Any) -> TurbulenceScales:
        """Return scale lengths and standard deviations at a height above the ground (m)."""
        h = jnp.maximum(height, GROUND)
        low, high = self._low(jnp.minimum(h, LOW)), self._high(jnp.maximum(h, HIGH))
        share = jnp.clip((h - LOW) / (HIGH - LOW), 0.0, 1.0)
        mixed = [a + share * (b - a) for a, b in zip(low, high, strict=True)]
        return TurbulenceScales(mixed[0], self.intensity * mixed[1])

    def init(self, key: Key) -> TurbulenceState:
        """Return the initial state: stationary random velocities and roll rate, and zero pitch and yaw rate."""
        along, across = FILTERS[self.form]["along"], FILTERS[self.form]["across"]
        n, m = len(along[1]) - 1, len(across[1]) - 1
        z = normals(key.at("first"), 0, n + 2 * m + 1)
        side, down = (_steady_root(across) @ z[i : i + m] for i in (n, n + m))
        return TurbulenceState(
            key=key.at("noise"),
            begun=jnp.zeros((), np.bool_),
            forward=_steady_root(along) @ z[:n],
            side=jnp.append(side, _output(across) @ side),
            down=jnp.append(down, _output(across) @ down),
            roll=z[-1],
            distance=jnp.zeros(()),
        )

    def step(self, t: Any, state: TurbulenceState, motion: Motion) -> tuple[TurbulenceState, Gust]:
        """Return the state and the gust from integer time t on."""
        air, dt = surrounding_air(motion), to_seconds(self.period)
        through = motion.v_WB_B - air.velocity
        V = jnp.maximum(jnp.sqrt(jnp.maximum(through @ through, 1.0)), 1.0)
        L, sigma = self.at(air.height - self.ground)
        along, across = FILTERS[self.form]["along"], FILTERS[self.form]["across"]
        n, m = state.forward.shape[0], state.side.shape[0]
        z = normals(state.key, t // self.period, n + 2 * m + 1)
        pitch, yaw, roll = (k * self.span / (np.pi * V) for k in (4, 3, 4))
        draws = z[:n], z[n : n + m], z[n + m : -1]
        forward = _advance(along, state.forward, V / L[0], None, dt, draws[0])
        side = _advance(across, state.side, V / L[1], yaw, dt, draws[1])
        down = _advance(across, state.down, V / L[2], pitch, dt, draws[2])
        kept = jnp.exp(-dt / roll)
        new = TurbulenceState(
            key=state.key,
            begun=jnp.ones((), np.bool_),
            forward=jnp.where(state.begun, forward, state.forward),
            side=jnp.where(state.begun, side, state.side),
            down=jnp.where(state.begun, down, state.down),
            roll=jnp.where(state.begun, kept * state.roll + jnp.sqrt(1 - kept * kept) * z[-1], state.roll),
            distance=self.discrete.advance(to_seconds(t) - dt, state.distance, V, dt),
        )
        v, w = _output(across) @ new.side[:-1], _output(across) @ new.down[:-1]
        velocity = sigma * jnp.stack([_output(along) @ new.forward, v, w])
        p = sigma[2] * _roll_share(self.span, L[2]) * new.roll
        q, r = -sigma[2] * (w - new.down[-1]) / (V * pitch), sigma[1] * (v - new.side[-1]) / (V * yaw)
        return new, Gust(velocity=velocity + self.discrete.air(new.distance), rate=jnp.stack([p, q, r]))

    def _low(self, h: Any) -> tuple[Any, Any]:
        """Return lengths and intensities (3,) up to 1000 ft above the ground. Source: [1] figures 10 and 11."""
        feet = h / FOOT
        ratio = 0.177 + 0.000823 * feet
        level, sigma = h / ratio**1.2, 0.1 * self.wind
        across = sigma / ratio**0.4
        return jnp.stack([level, level, h]), jnp.stack([across, across, sigma + 0.0 * h])

    def _high(self, h: Any) -> tuple[Any, Any]:
        """Return lengths and intensities (3,) from 2000 ft up. Source: [1] 3.7.2.1 and figure 7."""
        column = _position(HEIGHTS, h)
        row = _position(-LEVELS, -jnp.log10(self.exceedance))
        table = jnp.asarray(INTENSITIES)
        upper, lower = (_between(table[row[0] + i], column) for i in (0, 1))
        sigma = upper + row[1] * (lower - upper)
        return jnp.full(3, HIGH_LENGTHS[self.form]), jnp.stack([sigma, sigma, sigma])


def _position(table: Any, value: Any) -> tuple[Any, Any]:
    """Return the index of the interval of an increasing table that contains a value, and the fraction within this
    interval.

    Values outside the table are replaced by its first or last element.
    """
    index = jnp.clip(jnp.sum(jnp.asarray(table) <= value) - 1, 0, len(table) - 2)
    low, high = jnp.asarray(table)[index], jnp.asarray(table)[index + 1]
    return index, jnp.clip((value - low) / (high - low), 0.0, 1.0)


def _between(values: Any, position: tuple[Any, Any]) -> Any:
    index, share = position
    return values[index] + share * (values[index + 1] - values[index])


def _system(filter: tuple[tuple[float, ...], tuple[float, ...]]) -> Any:
    """Return the matrix A (n, n) of a filter's controllable form, with time in units of L/V. The noise enters the last
    state."""
    _, denominator = filter
    n = len(denominator) - 1
    A = np.eye(n, k=1)
    A[-1] = -np.array(denominator[:-1]) / denominator[-1]
    return A


def _output(filter: tuple[tuple[float, ...], tuple[float, ...]]) -> Any:
    """Return the output vector C (n,) of a filter's controllable form."""
    numerator, denominator = filter
    n = len(denominator) - 1
    return np.array([*numerator, *[0.0] * (n - len(numerator))]) / denominator[-1]


def _steady_root(filter: tuple[tuple[float, ...], tuple[float, ...]]) -> Any:
    """Return a square root (n, n) of a filter's stationary covariance under white noise of intensity one."""
    A = _system(filter)
    n = len(A)
    B = np.zeros((n, n))
    B[-1, -1] = 1.0
    whole = np.kron(A, np.eye(n)) + np.kron(np.eye(n), A)
    return np.linalg.cholesky(np.linalg.solve(whole, -B.ravel()).reshape(n, n))


def _advance(filter: Any, state: Any, frequency: Any, lag: Any, dt: Any, z: Any) -> Any:
    """Return the state of a filter with corner frequency V/L (1/s) after dt (s), driven by standard normals z.

    lag: time constant (s) with which the state's last element follows the component. None: no such element.
    """
    A0, C = _system(filter), _output(filter)
    r = jnp.minimum(frequency * dt, LONGEST_STEP)
    n = len(A0)
    noise = np.zeros((len(state), len(state)))
    noise[n - 1, n - 1] = 1.0
    A = r * A0
    if lag is not None:
        follows = jnp.minimum(dt / lag, FASTEST_RATE) * np.append(C, -1.0)
        A = jnp.concatenate([jnp.concatenate([A, jnp.zeros((n, 1))], axis=1), follows[None]])
    model = discretise(A, r * noise, 1.0)
    return model.Ad @ state + semidefinite_root(model.Qd) @ z


def _roll_share(span: Any, length: Any) -> Any:
    """Return the ratio of the standard deviations of roll rate (rad/s) and w (m/s). Source: [1] 3.7.5, integrated."""
    corner = np.pi / (4 * span)
    return jnp.sqrt(0.4 * np.pi * corner ** (4 / 3) / length ** (2 / 3))
