"""Tests of the link, alone and in a flight: pytest test_my_link.py"""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from trimtab import build, replace, simulate
from trimtab.core.rng import key
from trimtab.core.signals import new_sample

FLOWN = build(f"{Path(__file__).with_name('my_link.py')}:scenario")
LINK = FLOWN.world.uplink


def carry(link: Any, n: int) -> Any:
    """Return n samples at the receiver, with fields of shape (n,). The value of each packet is the packet's number."""

    def step(state: Any, k: Any) -> Any:
        return link.step(k * link.period, state, new_sample(k * link.period, 1.0 * k))

    return jax.lax.scan(step, link.init(key(0), new_sample(np.int64(0), np.float64(0.0))), np.arange(n))[1]


def test_packets_arrive_after_the_delay():
    """Without loss, the output is the sample of `steps` periods ago. Before the first packet, it is not valid."""
    out = carry(replace(LINK, loss=0.0), 20)
    assert not out.valid[: LINK.steps].any()
    np.testing.assert_array_equal(out.value[LINK.steps :], np.arange(20 - LINK.steps))
    np.testing.assert_allclose(out.age[LINK.steps :], LINK.steps * LINK.period * 1e-7)


def test_loss_rate_is_as_declared():
    """The share of lost packets among 4000 is within four standard errors of the declared probability."""
    share = 1 - np.mean(carry(LINK, 4000).fresh)
    assert abs(share - LINK.loss) < 4 * np.sqrt(LINK.loss * (1 - LINK.loss) / 4000) + LINK.steps / 4000


def test_total_loss_gives_no_output():
    """If every packet is lost, the output is never valid."""
    assert not carry(replace(LINK, loss=1.0), 20).valid.any()


def test_hovercraft_reaches_its_speed():
    """A flight, compiled to C, ends within 0.1 m/s of the target. Commands are at least as old as the delay."""
    log = simulate(FLOWN)
    assert abs(log.final["truth.surge_velocity"] - 2.8 / 2.6) < 0.1
    old = log["uplink.age"][log["uplink.valid"]]
    assert old.min() >= 0.04 - 1e-9
    assert old.max() > 0.06
