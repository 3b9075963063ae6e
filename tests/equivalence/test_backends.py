"""Every scenario of the catalogue gives the same numbers on JAX, in C, over lanes and with threads, seed by seed.

The tolerance is that of `compare_logs`: 1e-10 of a signal's size, until the first switch that depends on data. A larger
difference is accepted only if rounding errors cause the same difference in one backend alone. For example, an ideal
climb follows 85 000 ft to 0.005 ft, and the last bit of the altitude is 4e-10 of the small bending rate. The same holds
for switches: a craft that holds its position with steps of its fan for 90 s switches differently after any rounding of
its initial state.
"""

import itertools

import jax
import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.run.replay import compare_logs
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
SEEDS = range(100)
GROWING = ("swarm/formation",)
"""Scenarios in which rounding errors grow without a switch, by a factor of up to 12.6: five craft wait 20 s for the
first that comes near."""
UNSETTLED = ("hovercraft/pose",)
"""Scenarios in which any rounding error changes a switch somewhere: in 10 or 11 of 11 flights in C alone."""
LONG, FLOWN = seconds(30), seconds(1000)
"""Whole flights longer than LONG are flown with fewer seeds, FLOWN in total, because JAX takes minutes for them."""
COSTLY = ("navigation/platform-ranging",)
"""Shorter scenarios that are flown with fewer seeds for the same reason."""
NAMES = list(catalogue.scenario_names())
HERE = ("hovercraft/zero-velocity", "hovercraft/forward", "hovercraft/heading-bang-bang", "navigation/still")
"""Between them they have the laws' switches, links, actuators and filters; the others are with the thorough tests."""
QUICK = [n if n in HERE else pytest.param(n, marks=pytest.mark.thorough) for n in NAMES]


def round_the_start(scenario, seeds):
    """The flights four times, in C, which is quick: the first state rounded up, down, and to either side by turns."""
    for ends in ((np.inf, np.inf), (-np.inf, -np.inf), (np.inf, -np.inf), (-np.inf, np.inf)):
        sides = itertools.cycle(ends)
        beside = jax.tree.map(
            lambda x, sides=sides: np.nextafter(x, next(sides)) if np.asarray(x).dtype.kind == "f" else x,
            scenario.initial,
        )
        yield simulate_many(replace(scenario, initial=beside), seeds=list(seeds), backend="c", threads=2)


def beyond_roundings(name, scenario, apart):
    """Of pairs of logs by seed, signals that differ by more than roundings can make: ratios.

    What a rounding of the first state makes is the most that it makes in any of these flights, which are alike but for
    their noise, and 4 times that is allowed. Backends round otherwise at each step, not once: n roundings of any sign
    make sqrt(n) of one where none of them dies out, as in GROWING. Only for flights without a switch: after one,
    flights part.
    """
    effect = dict.fromkeys(next(iter(apart.values()))[0].paths, 0.0)
    for near in round_the_start(scenario, apart):
        for (_, b), other in zip(apart.values(), near, strict=True):
            effect = {p: max(e, np.abs(other[p] * 1.0 - b[p]).max()) for p, e in effect.items()}
    excess = {}
    for seed, (a, b) in apart.items():
        limit = np.sqrt(len(a.ticks)) if name in GROWING else 4
        worst = compare_logs(a, b).worst
        gaps = {p: w * max(np.abs(a[p]).max(), 1e-3) for p, w in worst.items() if w > 1e-10}
        excess |= {(seed, p): gap / effect[p] for p, gap in gaps.items() if gap > limit * effect[p]}
    return excess


def switches_of_roundings(scenario, lanes, seeds):
    """In how many of these flights a rounding of the first state alone makes a switch differ, at most."""
    flights = [
        {compare_logs(a, b).switch for a, b in zip(lanes, near, strict=True)} - {None}
        for near in round_the_start(scenario, seeds)
    ]
    return max(map(len, flights))


def agree(name, duration, ideal, seeds=SEEDS):
    """Compare seeds; gives the switches that differed, for the record."""
    scenario, _ = catalogue.load_scenario(name)
    scenario = replace(scenario.ideal() if ideal else scenario, duration=duration)
    reference = simulate_many(scenario, seeds=seeds, backend="jax")
    lanes = simulate_many(scenario, seeds=seeds, backend="c", threads=2)
    switches, apart = [], {}
    for seed, (a, b) in enumerate(zip(reference, lanes, strict=True)):
        found = compare_logs(a, b)
        if not found.is_equal:
            print(f"{name}, seed {seed}: {found.number}")
            apart[seed] = (a, b)
        if found.switch is not None:
            switches.append((seed, found.switch))
    if apart:
        assert not beyond_roundings(name, scenario, apart), name
    for seed in (0, len(seeds) // 2, len(seeds) - 1):
        alone = simulate(scenario, seed=seed, backend="c", log_period=ms(10))
        for path in alone.paths:  # scalar code gives the bits of the lanes
            np.testing.assert_array_equal(alone[path], lanes[seed][path], err_msg=f"{name} seed {seed} {path}")
    for switch in switches:
        print(f"{name}: a switch differs at seed {switch[0]}: {switch[1]}")
    flights = {switch for _, switch in switches}  # without noise all seeds are one flight
    most = max(5, switches_of_roundings(scenario, lanes, seeds)) if name in UNSETTLED else 5
    assert len(flights) <= most, switches
    return switches


@pytest.mark.thorough
@pytest.mark.parametrize("name", QUICK)
def test_backends_agree(name):
    agree(name, seconds(1), ideal=False)


@pytest.mark.thorough
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("ideal", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_backends_agree_over_whole_runs(name, ideal):
    scenario, _ = catalogue.load_scenario(name)
    fewer = name in COSTLY or scenario.duration > LONG
    agree(name, scenario.duration, ideal, SEEDS[: max(8, FLOWN // scenario.duration)] if fewer else SEEDS)


def test_thread_count_does_not_change_results():
    scenario, _ = catalogue.load_scenario("hovercraft/heading-bang-bang")
    scenario = replace(scenario, duration=seconds(1))
    one = simulate_many(scenario, seeds=SEEDS, backend="c", threads=1)
    two = simulate_many(scenario, seeds=SEEDS, backend="c", threads=3)
    few = simulate_many(scenario, seeds=[4, 2], backend="c", threads=2)
    for a, b in zip(one, two, strict=True):
        for path in a.paths:
            np.testing.assert_array_equal(a[path], b[path])
    assert few[1].metadata["backend"] == "c"
    np.testing.assert_array_equal(few[1]["truth.heading"], one[2]["truth.heading"])
