"""How long a signal of a scenario is under way around the loop: links, and what is held between packets and frames.

Source: docs page, Delay of a loop.
"""

from math import gcd
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.time import UNITS_PER_SECOND, to_seconds
from trimtab.links.delay_chain import DelayChain
from trimtab.links.latency import MeasuredLatency, scores
from trimtab.links.wire import Wire
from trimtab.loop.scenario import Scenario

DRAWS = 4096
"""Quantiles over which rounded latencies are averaged."""


class LoopDelay(NamedTuple):
    """Age (s), from measurement to force: the least there ever is, its mean over time, and the most."""

    least: float
    mean: float
    most: float


def loop_delay(scenario: Scenario) -> LoopDelay:
    """The delay of a scenario's loop.

    A latency counts until the instant at which the receiving end looks; where the actuators latch in frames that the
    packets keep time with, until the next frame. Signals that are held for a time h are h/2 late on the mean and h at
    most. Not counted: packets that wait for one another, lost ones, and what estimator and actuators add in dynamics.

    Raises: InputError for links whose latency is not known.
    """
    world = scenario.world
    frame = getattr(world.actuators, "frame", world.actuators.period)
    sampled = max([world.downlink.period, *(s.period for s in world.sensors.values())])
    if isinstance(world.downlink, MeasuredLatency):
        sampled = max(sampled, world.downlink.send_period)
    sent = max(_send_period(world.uplink), scenario.autopilot.period)
    in_time = sent % frame == 0
    look = frame if in_time else world.uplink.period
    down = _latencies("downlink", world.downlink, max(world.downlink.period, scenario.autopilot.period))
    up = _latencies("uplink", world.uplink, look)
    waits = sampled - gcd(sampled, sent) + (0 if in_time else frame - gcd(sent, frame))
    held = to_seconds(waits + max(sent, frame))
    return LoopDelay(
        least=float(down.min() + up.min()),
        mean=float(down.mean() + up.mean() + held / 2),
        most=float(down.max() + up.max() + held),
    )


def _send_period(channel: Any) -> int:
    return channel.send_period if isinstance(channel, MeasuredLatency) else channel.period


def _latencies(name: str, channel: Any, look: int) -> Any:
    """Latencies (k,) in s, equally likely, rounded up to the instants at which somebody looks."""
    if isinstance(channel, MeasuredLatency):
        from scipy.special import ndtri

        even = ndtri((np.arange(DRAWS) + 0.5) / DRAWS)
        drawn = np.interp(np.array([-np.inf, *even, np.inf]), scores(), np.asarray(channel.latency, float))
    elif isinstance(channel, DelayChain):
        drawn = np.array([channel.delay()])
    elif isinstance(channel, Wire):
        drawn = np.zeros(1)
    else:
        problem = f"the latency of a {type(channel).__name__} is not known"
        raise InputError(f"world.{name}", problem, fix="give a Wire, a DelayChain or a MeasuredLatency")
    units = np.round(drawn * UNITS_PER_SECOND).astype(np.int64)
    return -(-units // look) * look / UNITS_PER_SECOND
