"""Feasibility of a reference for the hovercraft: comparison of the needed forces with the limits of fan and rudder.

The centre of percussion P of the rudder pivot, a = J/(m d) ahead of the centre of mass, is accelerated only along the
nose. So the path of P determines heading, yaw rate and forces. s is the reference acceleration of P minus the
acceleration that friction causes:

    nose along +s or -s       FX = m (n.s + a r^2)       FY = -(J/d) r'  (and the torque of friction)

r and r' are the first two time derivatives of the direction of s. Where s passes through zero the nose keeps its
direction and the thrust reverses. While the demanded thrust is in the dead zone the fan gives no thrust. Then any
heading is allowed, and the velocity change that s demands is lost.

Source: own derivation from the model of [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link",
University of Maryland, 2006, eq. 2.11; flatness of such vehicles: P. Martin, S. Devasia, B. Paden, "A different look at
output tracking: control of a VTOL aircraft", Automatica 32 (1996) 101.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.reference import ReferencePoint, retime
from trimtab.core.rotation import DEG
from trimtab.vehicles.hovercraft import Hovercraft

STEP = 0.02
"""Time (s) between two instants at which the reference is checked."""
JUMP = 0.2
"""Largest jump of the reference's velocity (m/s), at its start, where the craft is at rest, or at its end. The ideal
craft deviates from the reference by about 1 m for each m/s of the jump."""
SLOWEST = 8.0
"""Largest factor by which the search for a feasible reference slows the reference down."""


@record
class ThrustLimits:
    """Limits of fan and rudder that a law assumes. The defaults are those in [1], with the rudder at its stops.

    Source: [1] chapter 4, reconstructed (docs page, Errata).
    """

    push: Scalar = quantity("N", "Maximum forward force.", default=1.3, above=0)
    pull: Scalar = quantity("N", "Maximum backward force.", default=0.6, above=0)
    angle: Scalar = quantity(
        "rad", "Maximum angle between the force and the body's axis.", default=21 * DEG, above=0, high=1.5
    )
    dead_zone: Scalar = quantity(
        "N", "Dead zone of the fan: demanded thrust below which the fan gives no thrust.", default=0.05, low=0
    )
    turn_rate: Scalar = quantity("rad/s", "Maximum yaw rate.", default=1.5, above=0)
    drift: Scalar = quantity("m/s", "Maximum velocity change that may be lost in the dead zone.", default=0.1, above=0)
    reserve: Scalar = quantity(
        "1", "Fraction of the maximum forces that is reserved for feedback.", default=0.2, low=0, high=0.9
    )


class PathMotion(NamedTuple):
    """Motion that a reference demands of the craft at each instant t (s), as arrays (n,).

    heading: in rad, unwrapped.  yaw_rate: in rad/s.  FX, FY: in N.  specific: acceleration that the thrust must
    cause (n, 2), in W (m/s^2).  jump: change of the velocity since the previous instant that is not due to the
    acceleration, in m/s. The craft is at rest before the first instant.
    """

    t: Any
    heading: Any
    yaw_rate: Any
    FX: Any
    FY: Any
    specific: Any
    jump: Any


class _Breach(NamedTuple):
    """Violated limit: its name and description, demand divided by limit (above 1), and time (s)."""

    name: str
    problem: str
    use: float
    t: float


def path_motion(reference: Any, model: Hovercraft, duration: float, slower: float = 1.0) -> PathMotion:
    """Return the motion that a reference of P demands over a duration (s) if it is slowed down by the factor
    `slower`."""
    t = np.linspace(0.0, duration * slower, max(int(duration / STEP), 8) + 1)

    def at(x: Any) -> ReferencePoint:
        return retime(reference.at(x / slower), (1 / slower, 0.0, 0.0, 0.0))

    point = jax.vmap(at)(t)
    velocity, wanted = np.asarray(point.velocity), np.asarray(point.acceleration)
    specific, torque = wanted, np.zeros(len(t))
    heading = _line_of(specific)
    for _ in range(3 if model.friction is not None else 0):
        rate = np.gradient(heading, t)
        drag, torque = _friction_at(model, velocity, heading, rate)
        specific = wanted - drag
        heading = _line_of(specific)
    rate = np.gradient(heading, t)
    nose = np.column_stack([np.cos(heading), np.sin(heading)])
    along = np.sum(nose * specific, axis=1)
    FX = model.mass * (along + model.percussion_arm * rate**2)
    FY = -(model.inertia * np.gradient(rate, t) - torque) / model.arm
    sudden = np.diff(velocity, axis=0) - (wanted[1:] + wanted[:-1]) / 2 * np.diff(t)[:, None]
    jump = np.hypot(*np.vstack([velocity[:1], sudden]).T)
    return PathMotion(t, heading, rate, FX, FY, specific, jump)


def refuse_infeasible(reference: Any, model: Hovercraft, limits: ThrustLimits, duration: float) -> None:
    """Raise InputError if the reference violates a limit within the duration (s).

    Raises:
        InputError: with the limit, the demand, its time, and the slowdown that makes the reference feasible.
    """
    breach = _worst_breach(path_motion(reference, model, duration), model, limits)
    if breach is None:
        return
    problem = f"the hovercraft cannot follow the reference: at {breach.t:.1f} s {breach.problem}"
    if breach.name == "jump":
        fix = "let the reference begin and end at rest: increase its ease, or let its speed rise and fall gradually"
        raise InputError("reference", problem, fix=fix)
    factor = _feasible_tempo(reference, model, limits, duration)
    raise InputError("reference", problem, fix=_slower_text(reference, factor))


def _line_of(specific: Any) -> Any:
    """Return the angle (n,) (rad) of the thrust axis, continuous at thrust reversals, interpolated at zero thrust."""
    size = np.hypot(*specific.T)
    some = np.flatnonzero(size > 1e-6 * max(float(size.max(initial=0.0)), 1e-6))
    if not len(some):
        return np.zeros(len(size))
    angle = np.unwrap(np.arctan2(specific[some, 1], specific[some, 0]), period=np.pi)
    return np.interp(np.arange(len(size)), some, angle)


def _friction_at(model: Hovercraft, velocity: Any, heading: Any, rate: Any) -> tuple[Any, Any]:
    """Return the acceleration of the centre of percussion P by friction (n, 2), in W, and the friction torque (n,)."""
    c, s = np.cos(heading), np.sin(heading)
    surge = c * velocity[:, 0] + s * velocity[:, 1]
    sway = -s * velocity[:, 0] + c * velocity[:, 1] - model.percussion_arm * rate
    X, Y, N = (np.asarray(v) for v in jax.vmap(model.friction.wrench)(surge, sway, rate))
    ahead, across = X / model.mass, Y / model.mass + model.percussion_arm * N / model.inertia
    return np.column_stack([c * ahead - s * across, s * ahead + c * across]), N


def _worst_breach(motion: PathMotion, model: Hovercraft, limits: ThrustLimits) -> _Breach | None:
    """Return the limit that is violated most, or None if no limit is violated."""
    t, FX, FY = motion.t, motion.FX, motion.FY
    thrusts = model.mass * np.hypot(*motion.specific.T) >= limits.dead_zone
    share, edge = 1 - float(limits.reserve), np.tan(float(limits.angle))
    push, pull, rate = float(limits.push) * share, float(limits.pull) * share, float(limits.turn_rate)
    side = edge * np.abs(FX) + float(limits.dead_zone)
    lost = _velocity_loss(motion, thrusts)
    uses = {
        "push": FX / push,
        "pull": -FX / pull,
        "side": np.where(thrusts, np.abs(FY) / side, 0.0),
        "turn": np.where(thrusts, np.abs(motion.yaw_rate) / rate, 0.0),
        "drift": lost / float(limits.drift),
        "jump": motion.jump / JUMP,
    }
    name = max(uses, key=lambda n: float(uses[n].max()))
    k = int(uses[name].argmax())
    kept = f", of which {100 * float(limits.reserve):g} % are reserved for feedback"
    texts = {
        "push": f"the reference needs {FX[k]:.2f} N forward, but the maximum is {float(limits.push):.2f} N{kept}",
        "pull": f"the reference needs {-FX[k]:.2f} N backward, but the maximum is {float(limits.pull):.2f} N{kept}",
        "side": f"the reference needs {abs(FY[k]):.2f} N to the side with {abs(FX[k]):.2f} N along the nose,"
        f" but the rudder turns the force by {float(limits.angle) / DEG:.0f} degrees at most",
        "turn": f"the nose has to turn at {abs(motion.yaw_rate[k]):.2f} rad/s, above the limit of {rate:.2f} rad/s",
        "drift": f"the reference needs thrust in the dead zone, below {float(limits.dead_zone):g} N, and would "
        f"lose {lost[k]:.2f} m/s there",
        "jump": f"the velocity of the reference jumps by {motion.jump[k]:.2f} m/s, above the limit of {JUMP:g} m/s",
    }
    use = float(uses[name][k])
    return _Breach(name, texts[name], use, float(t[k])) if use > 1 else None


def _velocity_loss(motion: PathMotion, thrusts: Any) -> Any:
    """Return the velocity change (m/s) lost since the demanded thrust entered the dead zone (n,)."""
    given = np.cumsum(motion.specific, axis=0) * (motion.t[1] - motion.t[0])
    since = np.maximum.accumulate(np.where(thrusts, np.arange(len(motion.t)), 0))
    return np.where(thrusts, 0.0, np.hypot(*(given - given[since]).T))


def _feasible_tempo(reference: Any, model: Hovercraft, limits: ThrustLimits, duration: float) -> float | None:
    """Return the smallest slowdown factor that makes the reference feasible, rounded up to 0.01; None if above
    SLOWEST."""

    def holds(slower: float) -> bool:
        return _worst_breach(path_motion(reference, model, duration, slower), model, limits) is None

    tempi = np.geomspace(1.05, SLOWEST, 12)
    first = next((k for k, slower in enumerate(tempi) if holds(float(slower))), None)
    if first is None:
        return None
    low, high = float(tempi[first - 1]) if first else 1.0, float(tempi[first])
    while high - low > 0.01:
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return float(np.ceil(high * 100) / 100)


def _slower_text(reference: Any, factor: float | None) -> str:
    if factor is None:
        return f"the reference is infeasible even {SLOWEST:g} times slower: make the path larger, or its bends wider"
    times = {n: getattr(reference, n) for n in ("period", "ease") if hasattr(reference, n)}
    if not times:
        return f"make the reference {factor:.2f} times slower: divide its speeds by this factor, or multiply its times"
    sets = " ".join(
        argument("settings", f"{float(v) * factor:.3g}", f"autopilot.law.reference.{n}") for n, v in times.items()
    )
    return f"the reference is feasible {factor:.2f} times slower: {sets}"
