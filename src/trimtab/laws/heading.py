"""Laws that turn to a heading by switching between braking and spinning.

No smooth feedback of the state can hold position and heading of this vehicle (design/stabilisability.py), so these laws
switch. Heading is positive clockwise from north, e = heading - target, and a negative e requires a positive yaw rate.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
section 2.3.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rotation import wrap, wrap_positive
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.laws.spin import (
    ConstantSpin,
    limit_point_value,
    lyapunov,
    safe_reference_bound,
    switching_energy,
)
from trimtab.laws.velocity import ZeroVelocity

READS = ("surge_velocity", "sway_velocity", "yaw_rate", "heading")
DAMP, TURN = 0, 1
"""Indices of the modes of a heading law: damp the motion, or turn to the heading."""
WRAPPING = "Wrapping of the heading error: shortest, none, or modulo (wrap the heading to [0, 2 pi), not the error)."


@record
class HeadingLawState:
    """State of a heading law. Source: [1] section 2.3."""

    mode: Scalar = quantity("1", "Active mode of the law: damp or turn.", kind="mode", modes=("damp", "turn"))
    switches: Scalar = quantity("1", 'Number of switches between the modes "damp" and "turn".', kind="count")
    spin_reference: Scalar = quantity("rad/s", "Yaw rate reference of the turn; 0 before the first turn.", frame="B")


@record
class HeadingOutput:
    """Demand and signals of a heading law. Source: [1] section 2.3."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    mode: Scalar = quantity("1", "Active mode of the law: damp or turn.", kind="mode", modes=("damp", "turn"))
    switches: Scalar = quantity("1", 'Number of switches between the modes "damp" and "turn".', kind="count")
    spin_reference: Scalar = quantity("rad/s", "Yaw rate reference of the turn; 0 before the first turn.", frame="B")
    heading_error: Scalar = quantity(
        "rad", "Heading error: heading minus target heading, wrapped according to the option `wrapping`."
    )
    lyapunov: Scalar = quantity(
        "J",
        'Lyapunov function of the active mode: V in mode "damp", W for the present yaw rate reference in mode "turn".',
    )
    provision: Scalar = quantity(
        "rad/s",
        "Magnitude above which a new yaw rate reference is safe, if the new reference has the sign of the "
        "present reference.",
    )


def heading_error(wrapping: str, heading: Any, target: Any) -> Any:
    """Return the heading error e (rad), heading minus target. Source: [1] figure 6.11, which fits "modulo"."""
    if wrapping == "shortest":
        return wrap(heading - target)
    return (wrap_positive(heading) if wrapping == "modulo" else heading) - target


def _first_state() -> HeadingLawState:
    zero = np.asarray(0, np.int32)
    return HeadingLawState(mode=zero, switches=zero, spin_reference=np.asarray(0.0))


def _decide(
    law: Any, state: HeadingLawState, estimate: Estimate, e: Any, start_at: Any, go_on_at: Any
) -> HeadingLawState:
    """Return the next mode and reference. Both stay constant while the estimate is not valid.

    Args:     e: heading error (rad).    start_at: yaw rate reference (rad/s) if a turn starts now.
              go_on_at: yaw rate reference (rad/s) if a turn continues.
    """
    off = jnp.abs(e) > law.tolerance
    calm = law.damping.lyapunov(estimate.state) < switching_energy(law.turning.model, start_at)
    damping = state.mode == DAMP
    start = damping & off & calm & estimate.valid
    stop = ~damping & (~off | (e * state.spin_reference > 0)) & estimate.valid
    turning = start | (~damping & ~stop)
    aim = jnp.where(damping & off, start_at, jnp.where(turning & ~start, go_on_at, state.spin_reference))
    return HeadingLawState(
        mode=jnp.where(turning, TURN, DAMP).astype(np.int32),
        switches=state.switches + jnp.where(start | stop, 1, 0).astype(np.int32),
        spin_reference=jnp.where(estimate.valid, aim, state.spin_reference),
    )


def _output(
    law: Any, t: Any, before: HeadingLawState, now: HeadingLawState, estimate: Estimate, e: Any
) -> HeadingOutput:
    """Return the demand and signals of the present mode and reference."""
    model, reference = law.turning.model, before.spin_reference
    _, damp = law.damping.step(t, (), estimate)
    _, turn = replace(law.turning, reference=now.spin_reference).step(t, (), estimate)
    turning = now.mode == TURN
    return HeadingOutput(
        demand=tree_where(turning, turn.demand, damp.demand),
        mode=now.mode,
        switches=now.switches,
        spin_reference=now.spin_reference,
        heading_error=e,
        lyapunov=jnp.where(turning, turn.lyapunov, damp.lyapunov),
        provision=safe_reference_bound(model, lyapunov(model, estimate.state, reference), reference),
    )


def _check_law(name: str, law: Any) -> None:
    target = np.asarray(law.target)
    if law.wrapping == "modulo" and not np.all((target >= 0) & (target < 2 * np.pi)):
        problem = f"with wrapping 'modulo' the target must be in [0, 2 pi), got {law.target} rad"
        raise InputError(f"{name}.target", problem, fix="give a target in [0, 2 pi), or set wrapping='shortest'")


@record
class HeadingBangBang:
    """Law that turns to a heading at a constant yaw rate.

        damp:  ZeroVelocity. While |e| > tolerance: r_ref = -sign(e) turn_rate. Then turn once V < eps(r_ref).
        turn:  ConstantSpin at r_ref. Then damp once |e| <= tolerance or e r_ref > 0 (target passed between two
               samples; this exit is reconstructed, see docs Errata).                              [1, section 2.3.3]

    e is the heading error. V and eps are the Lyapunov function of ZeroVelocity and the `switching_energy`.

    Ends:    by chattering at the edge of the tolerance, because the heading drifts in mode "damp".
    Valid:   turn_rate of about 1 rad/s. A faster turn overshoots the target. At 1.5 rad/s one ideal run in a thousand
             oscillates by 120 degrees for ever. At 3 rad/s every third run does.
    Source:  [1] section 2.3.3; gains [1] tables 6.1 and 6.4, reconstructed. The default turn_rate is our own choice.
             The runs in [1] use 1.5 rad/s.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    target: Scalar = quantity("rad", "Target heading.", kind="angle", default=0.0)
    turn_rate: Scalar = quantity("rad/s", "Magnitude of the yaw rate while turning.", default=1.0, above=0)
    tolerance: Scalar = quantity(
        "rad",
        "Heading error below which the target counts as reached.",
        default=np.pi / 180,
        above=0,
        source="[1] 6.1.6",
    )
    damping: ZeroVelocity = part('Law used in mode "damp".', default=ZeroVelocity())
    turning: ConstantSpin = part(
        'Law used in mode "turn". Its parameter `reference` is ignored.', default=ConstantSpin()
    )
    wrapping: str = option(WRAPPING, default="shortest", choices=("shortest", "none", "modulo"))

    def check(self) -> None:
        """Raise InputError if the wrapping is modulo and the target is not in [0, 2 pi)."""
        _check_law("HeadingBangBang", self)

    def init(self, key: Any) -> HeadingLawState:
        """Return the initial state, in mode "damp"."""
        return _first_state()

    def step(self, t: Any, state: HeadingLawState, estimate: Estimate) -> tuple[HeadingLawState, HeadingOutput]:
        """Update mode and reference, and return the demand at time t (unit: 100 ns)."""
        e = heading_error(self.wrapping, estimate.state.heading, self.target)
        now = _decide(self, state, estimate, e, -jnp.sign(e) * self.turn_rate, state.spin_reference)
        return now, _output(self, t, state, now, estimate, e)


@record
class HeadingProportional:
    """Law that turns to a heading at a yaw rate proportional to the heading error.

        damp:  ZeroVelocity. While |e| > tolerance: r_ref = -sign(e) max(k |e|, floor). Then turn once V < eps(r_ref).
        turn:  ConstantSpin at r_ref = -sign(e) max(v, k |e|, floor), v = provision(W, r_ref).
               Then damp once |e| <= tolerance or e r_ref > 0 (reconstructed).            [1, section 2.3, eq. 2.69]

    e is the heading error. V and W are the Lyapunov functions of ZeroVelocity and ConstantSpin.

    Form:    "literal" is as published: no floor, and the reference changes at every step. Nearly all its runs end in
             the bad limit point, with a constant heading error and a sideways slide. The reason is that this form
             allows |r_ref| = v, while the derivation needs |r_ref| > v, so W grows to limit_point_value. "floored"
             keeps |r_ref| at `floor` or above, and lets |r_ref| fall only while W < margin * limit_point_value. |r_ref|
             may rise at any time. So near the bad limit point the reference is constant, and W, which is below
             limit_point_value, cannot grow: the turn leaves the bad limit point.
    Valid:   k of about 1/s. After a minute, 1 % of the ideal runs have an error of 2 degrees or more with k = 1.5/s,
             and 60 % with k = 3/s. These runs oscillate as with HeadingBangBang.
    Source:  [1] section 2.3; gains [1] tables 6.1 and 6.4, reconstructed. Floor and margin are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    target: Scalar = quantity("rad", "Target heading.", kind="angle", default=0.0)
    k: Scalar = quantity(
        "1/s", "Gain k: commanded yaw rate per heading error.", default=1.0, above=0, source="[1] 6.1, figure 6.11"
    )
    tolerance: Scalar = quantity(
        "rad",
        "Heading error below which the target counts as reached.",
        default=np.pi / 180,
        above=0,
        source="[1] 6.1.6",
    )
    floor: Scalar = quantity(
        "rad/s", "Minimum magnitude of the yaw rate reference. Used only with form='floored'.", default=0.8, above=0
    )
    margin: Scalar = quantity(
        "1",
        "Largest value of the Lyapunov function W at which the yaw rate reference may be reduced, as a "
        "fraction of limit_point_value.",
        default=0.7,
        above=0,
        high=1,
    )
    damping: ZeroVelocity = part('Law used in mode "damp".', default=ZeroVelocity())
    turning: ConstantSpin = part(
        'Law used in mode "turn". Its parameter `reference` is ignored.', default=ConstantSpin()
    )
    wrapping: str = option(WRAPPING, default="shortest", choices=("shortest", "none", "modulo"))
    form: str = option(
        "Variant of the law: literal, as published; or floored, to avoid the bad limit point.",
        default="floored",
        choices=("floored", "literal"),
    )

    def check(self) -> None:
        """Raise InputError if the wrapping is modulo and the target is not in [0, 2 pi)."""
        _check_law("HeadingProportional", self)

    def init(self, key: Any) -> HeadingLawState:
        """Return the initial state, in mode "damp"."""
        return _first_state()

    def step(self, t: Any, state: HeadingLawState, estimate: Estimate) -> tuple[HeadingLawState, HeadingOutput]:
        """Update mode and reference, and return the demand at time t (unit: 100 ns)."""
        model, reference = self.turning.model, state.spin_reference
        e = heading_error(self.wrapping, estimate.state.heading, self.target)
        W = lyapunov(model, estimate.state, reference)
        size = self.k * jnp.abs(e)
        if self.form == "floored":
            size = jnp.maximum(size, self.floor)
        next_size = jnp.maximum(safe_reference_bound(model, W, reference), size)
        if self.form == "floored":
            moves = (self.margin * limit_point_value(model, reference) > W) | (next_size > jnp.abs(reference))
            next_size = jnp.where(moves, next_size, jnp.abs(reference))
        now = _decide(self, state, estimate, e, -jnp.sign(e) * size, -jnp.sign(e) * next_size)
        return now, _output(self, t, state, now, estimate, e)
