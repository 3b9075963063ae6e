"""Linear theory for a stability map: delay margin, jitter margin and critical packet loss, as far as each applies.

The theory needs the total delay of a signal in the loop: the time in transit on the links, and the time for which the
signal is held between packets and between actuator frames.

Source: docs page, Stability maps. The theorems are those of `design`.
"""

from collections.abc import Callable
from math import gcd
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.search.axes import Axis, with_values
from trimtab.analysis.campaign.search.stability_map import StabilityMap, values_at
from trimtab.core.errors import InputError, argument
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Quantity, leaves
from trimtab.core.time import UNITS_PER_SECOND, to_seconds
from trimtab.design.loop_transfer import FeedbackLoop, loop_of_law
from trimtab.design.margins import critical_loss, delay_margin, jitter_margin
from trimtab.links.latency import MeasuredLatency, normal_scores
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.scenario import Scenario

DRAWS = 4096
"""Number of quantiles by which the distribution of a link's latency is represented."""
FINE = 30
"""Approximate number of points along an axis at which the theory is evaluated."""
FEW = 8
"""Approximate number of points along an axis that changes the linear loop. The theory needs a linearisation at each."""
FAR = 10.0
"""Value used for a delay or jitter margin (s) that is unlimited."""


class LoopDelay(NamedTuple):
    """Delay from measurement to actuator force (s): minimum, mean over time, and maximum."""

    least: float
    mean: float
    most: float


def loop_delay(scenario: Scenario) -> LoopDelay:
    """Compute the delay from measurement to actuator force in a scenario's loop.

    A link's latency ends at the receiver's next sampling instant. If the actuators accept commands only in frames
    that are synchronous with the packets, the latency ends at the next frame. A signal held for a time h is delayed by
    h/2 on average and by at most h. Not included: queueing of packets, lost packets, and the dynamics of estimator and
    actuators.

    Raises: InputError if the latency of a link is not known.
    """
    world = scenario.world
    frame = optional_member(world.actuators, "frame") or world.actuators.period
    sampled = max([world.downlink.period, *(s.period for s in world.sensors.values())])
    if isinstance(world.downlink, MeasuredLatency):
        sampled = max(sampled, world.downlink.send_period)
    sent = max(_send_period(world.uplink), scenario.autopilot.period)
    in_time = sent % frame == 0
    look = frame if in_time else world.uplink.period
    down = _latencies("downlink", world.downlink, max(world.downlink.period, scenario.autopilot.period))
    up = _latencies("uplink", world.uplink, look)
    waits = sampled - gcd(sampled, sent) + (0 if in_time else frame - gcd(sent, frame))
    hold = to_seconds(waits + max(sent, frame))
    return LoopDelay(
        least=float(down.min() + up.min()),
        mean=float(down.mean() + up.mean() + hold / 2),
        most=float(down.max() + up.max() + hold),
    )


def _send_period(channel: Any) -> int:
    return channel.send_period if isinstance(channel, MeasuredLatency) else channel.period


def _latencies(name: str, channel: Any, look: int) -> Any:
    """Return equally probable latencies (k,) of a link in s, rounded up to the receiver's sampling instants."""
    if isinstance(channel, MeasuredLatency):
        from scipy.special import ndtri

        even = ndtri((np.arange(DRAWS) + 0.5) / DRAWS)
        drawn = np.interp(np.array([-np.inf, *even, np.inf]), normal_scores(), np.asarray(channel.latency, float))
    elif isinstance(channel, DelayChain):
        drawn = np.array([channel.delay()])
    elif isinstance(channel, Wire):
        drawn = np.zeros(1)
    else:
        problem = f"the latency of a {type(channel).__name__} is not known"
        raise InputError(f"world.{name}", problem, fix="use a Wire, a DelayChain or a MeasuredLatency")
    units = np.round(drawn * UNITS_PER_SECOND).astype(np.int64)
    return -(-units // look) * look / UNITS_PER_SECOND


class StabilityCriterion(NamedTuple):
    """Stability criterion over the plane of a map.

    name: name of the criterion.  x, y: values on the map's axes (nx,), (ny,).  margin: stability margin (nx, ny) in s,
    or as a probability for packet loss; positive on the stable side, 0 on the boundary.
    """

    name: str
    x: Any
    y: Any
    margin: Any

    def zero_lines(self) -> list[Any]:
        """Return the curves on which the margin is zero: arrays (k, 2) of values of x and y."""
        from contourpy import contour_generator

        return list(contour_generator(self.x, self.y, self.margin.T).lines(0.0))


def linear_loop(scenario: Scenario) -> FeedbackLoop:
    """Return the loop of a scenario's law and vehicle, linearised about the law's equilibrium.

    Raises: InputError if the law has no `equilibrium`, if the loop can't be linearised (see `loop_of_law`), or if the
    law gets its input from a predictor.
    """
    if scenario.autopilot.predictor is not None:
        problem = "the law has a predictor, so the margins of the loop without predictor do not apply"
        raise InputError(
            "theory",
            problem,
            fix=f"leave theory out: {argument('theory', False)}; or map  {argument('settings', 'off', 'predictor')}",
        )
    law = scenario.autopilot.law
    rest = optional_member(law, "equilibrium")
    if rest is None:
        fix = "pass a loop function: loop=lambda scenario: of_law(vehicle, law, state)"
        raise InputError("theory", f"{type(law).__name__} has no equilibrium to linearise about", fix=fix)
    return loop_of_law(scenario.world.vehicle, law, rest())


def stability_criteria(
    diagram: StabilityMap, loop: Callable[[Scenario], FeedbackLoop] = linear_loop
) -> tuple[StabilityCriterion, ...]:
    """Return the criteria that apply to a map.

    "delay margin" and "jitter margin" apply if an axis is a link's delay or jitter. The delay margin limits the loop's
    mean delay. The jitter margin limits the difference between its maximum and minimum delay. "packet loss" applies if
    an axis is the uplink's loss and the loop has one state. Each packet is assumed to be lost with the link's loss
    probability, and not sent again.

    Args:
        diagram: the map.
        loop: function from a scenario to its linear loop.

    Raises: InputError if no criterion applies, or if the loop cannot be linearised.
    """
    kinds = {axis.kind for axis in (diagram.x, diagram.y)}
    if not kinds - {""}:
        problem = f"neither {diagram.x.name!r} nor {diagram.y.name!r} is the delay, jitter or loss of a link"
        raise InputError("theory", problem, fix="leave theory out, or map a delay: axis_of_link('delay', …)")
    x, y = _refine_axis(diagram.x), _refine_axis(diagram.y)
    known: dict[bytes, _Margins] = {}
    margins: dict[str, Any] = {}
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            scenario = with_values(diagram.scenario, values_at(diagram.scenario, diagram.x, diagram.y, a, b))
            key = _loop_key(scenario)
            if key not in known:
                known[key] = _Margins.of(loop(scenario))
            for name, spare in _remaining_margins(known[key], scenario, kinds).items():
                margins.setdefault(name, np.full((len(x), len(y)), np.nan))[i, j] = spare
    if not margins:
        problem = "the packet-loss criterion needs a loop with one state, but this loop has more states"
        raise InputError("theory", problem, fix="leave theory out, or map a delay: axis_of_link('delay', …)")
    return tuple(StabilityCriterion(name, x, y, spare) for name, spare in margins.items())


class _Margins(NamedTuple):
    """Linear loop. delay: delay margin (s), 0 if it is unstable. jitter: constant delay -> jitter margin (s)."""

    loop: FeedbackLoop
    delay: float
    jitter: dict[float, float]

    @staticmethod
    def of(loop: FeedbackLoop) -> "_Margins":
        return _Margins(loop, 0.0 if loop.unstable_poles() else min(delay_margin(loop).delay, FAR), {})

    def allowed_jitter(self, least: float) -> float:
        """Return the jitter margin (s) in addition to a constant delay `least`; negative beyond the delay margin."""
        if least >= self.delay:
            return self.delay - least
        if least not in self.jitter:
            self.jitter[least] = min(jitter_margin(self.loop, delay=least), FAR)
        return self.jitter[least]


def _remaining_margins(margins: _Margins, scenario: Scenario, kinds: set[str]) -> dict[str, float]:
    spare: dict[str, float] = {}
    if kinds & {"delay", "jitter"}:
        under_way = loop_delay(scenario)
        spare["delay margin"] = margins.delay - under_way.mean
        spare["jitter margin"] = margins.allowed_jitter(under_way.least) - (under_way.most - under_way.least)
    channel, loop = scenario.world.uplink, margins.loop
    if "loss" in kinds and len(loop.A) == 1 and isinstance(channel, MeasuredLatency):
        a = float(np.exp(loop.A[0, 0] * to_seconds(channel.send_period)))
        spare["packet loss"] = float(critical_loss(a, retransmissions=0) - np.asarray(channel.loss))
    return spare


def _refine_axis(axis: Axis) -> Any:
    """Return the values of an axis at which the theory is evaluated, including the values of the coarse grid."""
    coarse = np.asarray(axis.values, float)
    each = max((FINE if axis.kind else FEW) // (len(coarse) - 1), 1)
    return np.interp(np.arange((len(coarse) - 1) * each + 1) / each, np.arange(len(coarse)), coarse)


def _loop_key(scenario: Scenario) -> bytes:
    """Return a cache key for the linear loop: all numeric parameters of vehicle and law."""
    both = (*leaves(scenario.world.vehicle), *leaves(scenario.autopilot.law))
    return b"".join(np.asarray(v).tobytes() for _, v, declared in both if isinstance(declared, Quantity))
