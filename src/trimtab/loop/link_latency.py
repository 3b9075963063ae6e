"""Settings of delay, jitter and loss for any link. A link with such a setting is replaced by a `MeasuredLatency`.

    delay     constant latency, which replaces the latency of the link
    jitter    additional random latency, uniformly distributed from 0 to this value
    loss      probability that a packet is lost, independent for each packet

Source: docs page, Axes.
"""

from collections.abc import Mapping

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.imperfections import without
from trimtab.core.record import replace, with_leaf
from trimtab.core.time import ms, parse_time, seconds, to_seconds
from trimtab.core.units import find_size
from trimtab.links.fifo import required_slots
from trimtab.links.latency import NODES, MeasuredLatency, mean_latency, normal_scores
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.scenario import Scenario

LINKS = ("uplink", "downlink")
KINDS = ("delay", "jitter", "loss")
EXPECTED = "autopilot.predictor.uplink_delay"
SETTINGS = tuple(f"{link}.{kind}" for link in LINKS for kind in KINDS)
"""Names of the settings of uplink and downlink, in the order in which the settings are applied."""


def with_link_settings(scenario: Scenario, settings: Mapping[str, str]) -> Scenario:
    """Return the scenario with new delay, jitter or loss of the links.

    settings: name -> text, e.g. {"uplink.delay": "80 ms", "downlink.loss": "5 %"}.

    Raises: InputError for a text that is not a time or a percentage, or for a link whose latency cannot be changed.
    """
    for name in [name for name in SETTINGS if name in settings]:
        link, _, kind = name.partition(".")
        value = _parse_share(name, settings[name]) if kind == "loss" else _parse_delay(name, settings[name])
        scenario = _change_link(scenario, link, kind, value)
    return scenario


def _change_link(scenario: Scenario, link: str, kind: str, value: float) -> Scenario:
    """Return the scenario with a new value of a link's delay (s), jitter (s) or loss (probability)."""
    channel = measured_latency(scenario, link)
    if kind == "loss":
        return replace(scenario, world=replace(scenario.world, **{link: replace(channel, loss=value)}))
    channel = without(channel, "jitter") if kind == "jitter" else replace(channel, latency=np.zeros(NODES))
    latency = np.asarray(channel.latency) + value * (np.ones(NODES) if kind == "delay" else even_latencies())
    slots = required_slots(float(latency[-1]), channel.send_period, channel.period)
    channel = replace(channel, latency=latency, capacity=max(channel.capacity, slots))
    scenario = replace(scenario, world=replace(scenario.world, **{link: channel}))
    if link == "uplink" and scenario.autopilot.predictor is not None:
        scenario = extend_horizon(scenario, seconds(round(value, 3)))
        scenario = with_leaf(scenario, EXPECTED, lambda old, declared: mean_latency(latency))
    return scenario


def _parse_delay(name: str, text: str) -> float:
    try:
        units = parse_time(text)
    except InputError as error:
        raise InputError(
            argument_name("settings", name), error.problem, fix=argument("settings", "80 ms", name)
        ) from None
    if units < 0:
        raise InputError(
            argument_name("settings", name),
            f"must be at least 0, got {text!r}",
            fix=argument("settings", "80 ms", name),
        )
    return float(to_seconds(units))


def _parse_share(name: str, text: str) -> float:
    number = text.strip().removesuffix("%")
    try:
        value = float(number) * ((find_size("%", "1") or 1.0) if number != text.strip() else 1.0)
    except ValueError:
        value = np.nan
    if not 0 <= value <= 1:
        raise InputError(
            argument_name("settings", name),
            f"must be the fraction of packets that are lost, 0 to 100 %, got {text!r}",
            fix=f"{argument('settings', '5 %', name)}, from 0 to 100 %",
        )
    return value


def even_latencies() -> np.ndarray:
    """Return the latency table (NODES,) of a uniform distribution over [0, 1] s.

    The table contains the latency as a function of a standard normal number.
    """
    from scipy.special import ndtr

    return ndtr(normal_scores())


def measured_latency(scenario: Scenario, link: str) -> MeasuredLatency:
    """Return a link as a `MeasuredLatency` with the same delay and packet rate.

    A link that is a `MeasuredLatency` already is returned unchanged.
    """
    channel = getattr(scenario.world, link)
    if isinstance(channel, MeasuredLatency):
        return channel
    if not isinstance(channel, DelayChain | Wire):
        problem = f"a {type(channel).__name__} has no latency that can be changed"
        raise InputError(
            f"world.{link}", problem, fix="use a scenario whose link has a latency, or change a parameter of this link"
        )
    delay = channel.delay() if isinstance(channel, DelayChain) else 0.0
    looks = min(channel.period, scenario.autopilot.period, ms(1))
    return MeasuredLatency(latency=np.full(NODES, delay), send_period=channel.period, period=looks)


def extend_horizon(scenario: Scenario, longest: int) -> Scenario:
    """Return the scenario with the horizon of the predictor increased by `longest` (100 ns).

    If the autopilot has no predictor, the scenario is returned unchanged.
    """
    predictor = scenario.autopilot.predictor
    if predictor is None:
        return scenario
    predictor = replace(predictor, horizon=predictor.horizon + longest)
    return replace(scenario, autopilot=replace(scenario.autopilot, predictor=predictor))
