"""Numerical integration of the vehicle's true state: methods, tolerances, and steps that end at events.

The default is one classical Runge–Kutta step from each instant of the run to the next. Source: docs page, Integration.
"""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.integrate import dormand_prince, error_ratio, next_step, rk4_with_doubling, rk4_with_error
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Scalar, option, quantity, record, replace, tree_where
from trimtab.core.rosenbrock import rodas
from trimtab.core.rotation_step import rotation_step

STEPS: Mapping[str, tuple[Any, int | None]] = MappingProxyType(
    {
        "rk4": (rk4_with_error, None),
        "rk4-doubling": (rk4_with_doubling, None),
        "rk45": (dormand_prince, 5),
        "rosenbrock": (rodas, 4),
    }
)
"""Integration method -> step function, and order of the method used for step size control (None: fixed step size)."""
HALVINGS = 52
"""Number of bisection steps that locate an event within an integration step. The remaining error is a rounding
error."""


@record
class IntegrationReport:
    """Diagnostics of the integrator since the previous instant of the run. Source: docs page, Integration."""

    integration_error: Scalar = quantity(
        "1",
        "Largest estimated error of an integration step since the previous instant, as a fraction of the tolerance.",
    )
    steps: Scalar = quantity(
        "1", "Number of integration steps since the previous instant, including rejected steps.", kind="count"
    )
    step: Scalar = quantity("s", "Length of the next trial step of the integration.")
    events: Scalar = quantity(
        "1",
        "Number of events (sign changes of the vehicle's `events`) located since the start of the run.",
        kind="count",
    )
    crowded: Scalar = quantity(
        "1", "True if more events occurred since the previous instant than `most_events`.", kind="flag"
    )


@record
class Integration:
    """Integration of the true state from instant to instant: method, tolerances, and limits on steps and events.

        rk4           one step of order four, of fixed length, with an error estimate by an embedded formula
        rk4-doubling  the same step, with an error estimate from two steps of half the length
        rk45          steps of order five, of variable length: for smooth motion with fast phases
        rosenbrock    linearly implicit steps of order four, of variable length: for stiff systems

    For each number x of the state, the estimated error of a step must be at most absolute + relative |x|. With attitude
    "group", the quaternions that the vehicle's QUATERNIONS names are integrated as rotations, so they keep unit length.

    Source:  docs page, Integration.
    """

    method: str = option("Integration method.", default="rk4", choices=tuple(STEPS))
    relative: Scalar = quantity("1", "Relative tolerance of a step, for each number of the state.", default=1e-8, low=0)
    absolute: Scalar = quantity(
        "1", "Absolute tolerance of a step, for each number of the state in its unit.", default=1e-8, above=0
    )
    attitude: str = option(
        "Integration of quaternions. numbers: each component separately. group: as rotations, which keeps unit length.",
        default="numbers",
        choices=("numbers", "group"),
    )
    most_steps: Scalar = quantity(
        "1", "Maximum number of integration steps between two instants.", default=1000, low=1, kind="count"
    )
    most_events: Scalar = quantity(
        "1", "Maximum number of events located between two instants.", default=8, low=0, kind="count"
    )

    def first_report(self, h: Any) -> IntegrationReport:
        """Return the integration report before the first instant. h: length of the first trial step (s)."""
        zero = jnp.zeros((), np.int32)
        return IntegrationReport(jnp.zeros(()), zero, jnp.zeros(()) + h, zero, jnp.zeros((), np.bool_))


PLAIN_STEP = Integration(relative=1e-4, absolute=1e-4)
"""Default integration of a world: one Runge–Kutta step per instant. The tolerances are large, so that the error
estimate exceeds them only if the step is far too long."""


class _Progress(NamedTuple):
    """Progress of the integration between two instants.

    since: time since the first of the two instants (s).  x: state.  size: length of the next trial step (s).  steps:
    number of steps since the first instant.  error: largest error of a step, relative to the tolerance.  located:
    number of events located since the first instant.  is_crowded: True if there were more events than `most_events`.
    """

    since: Any
    x: Any
    size: Any
    steps: Any
    error: Any
    located: Any
    is_crowded: Any


def integrate_truth(
    method: Integration, vehicle: Any, u: Any, t: Any, x: Any, h: Any, before: IntegrationReport
) -> tuple[Any, IntegrationReport]:
    """Return the true state at time t + h (s) for a constant input u, and the integration report.

    An integration step ends where a function in the vehicle's `events` changes its sign. The vehicle's `jump` computes
    the state after the event. before: report of the previous call.
    """
    none = jnp.zeros((), np.int32)
    start = _Progress(jnp.zeros(()), _as_floats(x), before.step, none, jnp.zeros(()), none, jnp.zeros((), np.bool_))
    take = partial(_take_step, method, vehicle, u, t, h)
    if STEPS[method.method][1] is None and optional_member(vehicle, "events") is None:
        end = take(start)
    else:
        end = jax.lax.while_loop(lambda p: p.since < h, take, start)
    report = replace(
        before,
        integration_error=end.error,
        steps=end.steps,
        step=end.size,
        events=before.events + end.located,
        crowded=end.is_crowded,
    )
    return end.x, report


def _take_step(method: Integration, vehicle: Any, u: Any, t: Any, h: Any, p: _Progress) -> _Progress:
    """Return the progress after one integration step.

    The step ends after the trial length, at the next instant or at the first event, whichever comes first. If its error
    exceeds the tolerance, the step is rejected.
    """

    def f(time: Any, at: Any) -> Any:
        return vehicle.dynamics(time, at, u)

    def step(length: Any) -> tuple[Any, Any]:
        x1, error = formula(f, t + p.since, p.x, length)
        return _as_floats(x1), error

    formula, order = STEPS[method.method]
    if method.attitude == "group":
        formula = rotation_step(formula, optional_member(vehicle, "QUATERNIONS"))
    rest = h - p.since
    is_forced = p.steps + 1 >= method.most_steps
    own = rest if order is None else jnp.where(is_forced | (p.size >= rest), rest, p.size)
    reaches = own >= rest
    x1, error = step(own)
    ratio = error_ratio(error, p.x, x1, method.relative, method.absolute)
    if order is None:
        is_taken, size = jnp.ones((), np.bool_), p.size
    else:
        is_taken = is_forced | (ratio <= 1)
        # a step that was shortened to end at the next instant does not reduce the trial length of the step after it
        size = jnp.where(is_taken & reaches & (own < p.size), p.size, next_step(own, ratio, order))
    located, is_crowded = p.located, p.is_crowded
    since = jnp.where(reaches, h, p.since + own)
    if optional_member(vehicle, "events") is not None:
        is_free = is_taken & (p.located < method.most_events)
        by, x1, has_crossed = _stop_at_event(vehicle, t + p.since, p.x, f(t + p.since, p.x), own, x1, is_free, step)
        has_crossed = has_crossed & is_taken
        is_event = has_crossed & is_free
        since = jnp.where(is_event, p.since + by, since)
        located = located + is_event.astype(np.int32)
        is_crowded = is_crowded | (has_crossed & ~is_event)
    return _Progress(
        since=jnp.where(is_taken, since, p.since),
        x=tree_where(is_taken, x1, p.x),
        size=size,
        steps=p.steps + 1,
        error=jnp.where(is_taken, jnp.maximum(p.error, ratio), p.error),
        located=located,
        is_crowded=is_crowded,
    )


def _stop_at_event(
    vehicle: Any, t: Any, x: Any, rate: Any, h: Any, x1: Any, is_free: Any, step: Callable[[Any], tuple[Any, Any]]
) -> tuple[Any, Any, Any]:
    """Return the length (s) of a step up to the first event, the state there, and True if the step contains an event.

    t: time at the start of the step (s).  x: state at the start.  rate: derivative of x at the start.  h: length of the
    complete step (s).  x1: state at the end of the complete step.  is_free: True if an event may end the step.  step:
    function that returns the state, and its error, after a step of a given length (s) from x.
    """

    def values(by: Any, at: Any) -> Any:
        return jnp.concatenate(
            [jnp.ravel(jnp.asarray(g, np.float64)) for g in jax.tree.leaves(vehicle.events(t + by, at))]
        )

    rate = jax.tree.map(lambda v, d: jnp.broadcast_to(jnp.asarray(d, np.float64), jnp.shape(v)), x, rate)
    zero = jnp.zeros(())
    g, slope = jax.jvp(values, (zero, x), (jnp.ones(()), rate))
    before = jnp.where(g == 0, slope, g)  # if a jump has set g to zero, use the sign of the derivative of g
    has_crossed = jnp.any(_crosses(before, values(h, x1)))

    def locate() -> tuple[Any, Any]:
        def halve(_: Any, ends: Any) -> Any:
            low, high = ends
            middle = (low + high) / 2
            is_past = jnp.any(_crosses(before, values(middle, step(middle)[0])))
            return jnp.where(is_past, low, middle), jnp.where(is_past, middle, high)

        _, by = jax.lax.fori_loop(0, HALVINGS, halve, (zero, h))
        to = step(by)[0]
        if (jump := optional_member(vehicle, "jump")) is not None:
            to = _as_floats(jump(t + by, to, _crosses(before, values(by, to))))
        return by, to

    by, to = jax.lax.cond(has_crossed & is_free, locate, lambda: (h, x1))
    return by, to, has_crossed


def _as_floats(x: Any) -> Any:
    return jax.tree.map(lambda v: jnp.asarray(v, np.float64), x)


def _crosses(g: Any, later: Any) -> Any:
    """Return, for each event function, True if its values g and `later` have different signs."""
    return ((g > 0) & (later <= 0)) | ((g < 0) & (later >= 0))
