"""Every shipped scenario, flown on JAX, on C, over lanes and by threads: the same numbers, seed by seed.

The tolerance is `compare_logs`'s: 1e-10 of a signal's size until the first switch on data. Where more is seen, it has
to be what one rounding of the first state makes in a backend alone: an ideal climb follows 85 000 ft to 0.005 ft, and
the last bit of the altitude, fed back, is 4e-10 of a bending rate that small.
"""

import itertools

import jax
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.native.compiler import find_compiler
from trimtab.run.replay import compare_logs
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
SEEDS = range(100)
NAMES = list(catalogue.scenario_names())
HERE = ("hovercraft/zero-velocity", "hovercraft/forward", "hovercraft/heading-bang-bang", "navigation/still")
"""Between them they have the laws' switches, links, actuators and filters; the others are with the slow tests."""
QUICK = [n if n in HERE else pytest.param(n, marks=pytest.mark.slow) for n in NAMES]


def beyond_roundings(scenario, apart):
    """Of pairs of logs by seed, signals that differ by over 4 times what a rounding of the first state makes: ratios.

    The first state is rounded up, down, and to either side by turns; what it makes is the most that it makes in any of
    these flights, which are alike but for their noise. Only for flights without a switch: after one, flights part.
    """
    effect = dict.fromkeys(next(iter(apart.values()))[0].paths, 0.0)
    for ends in ((np.inf, np.inf), (-np.inf, -np.inf), (np.inf, -np.inf), (-np.inf, np.inf)):
        sides = itertools.cycle(ends)
        beside = jax.tree.map(
            lambda x, sides=sides: np.nextafter(x, next(sides)) if np.asarray(x).dtype.kind == "f" else x,
            scenario.initial,
        )
        near = simulate_many(replace(scenario, initial=beside), seeds=list(apart), backend="jax")
        for (a, _), other in zip(apart.values(), near, strict=True):
            effect = {p: max(e, np.abs(other[p] * 1.0 - a[p]).max()) for p, e in effect.items()}
    excess = {}
    for seed, (a, b) in apart.items():
        worst = compare_logs(a, b).worst
        gaps = {p: w * max(np.abs(a[p]).max(), 1e-3) for p, w in worst.items() if w > 1e-10}
        excess |= {(seed, p): gap / effect[p] for p, gap in gaps.items() if gap > 4 * effect[p]}
    return excess


def agree(name, duration, ideal):
    """Compare 100 seeds; gives the switches that differed, for the record."""
    scenario, _ = catalogue.load_scenario(name)
    scenario = replace(scenario.ideal() if ideal else scenario, duration=duration)
    reference = simulate_many(scenario, seeds=SEEDS, backend="jax")
    lanes = simulate_many(scenario, seeds=SEEDS, backend="c", threads=2)
    switches, apart = [], {}
    for seed, (a, b) in enumerate(zip(reference, lanes, strict=True)):
        found = compare_logs(a, b)
        if not found.is_equal:
            print(f"{name}, seed {seed}: {found.number}")
            apart[seed] = (a, b)
        if found.switch is not None:
            switches.append((seed, found.switch))
    if apart:
        assert not beyond_roundings(scenario, apart), name
    for seed in (0, 57, 99):
        alone = simulate(scenario, seed=seed, backend="c", log_period=ms(10))
        for path in alone.paths:  # scalar code gives the bits of the lanes
            np.testing.assert_array_equal(alone[path], lanes[seed][path], err_msg=f"{name} seed {seed} {path}")
    for switch in switches:
        print(f"{name}: a switch differs at seed {switch[0]}: {switch[1]}")
    flights = {switch for _, switch in switches}  # without noise all seeds are one flight
    assert len(flights) <= 5, switches
    return switches


@pytest.mark.parametrize("name", QUICK)
def test_backends_agree(name):
    agree(name, seconds(1), ideal=False)


@pytest.mark.slow
@pytest.mark.parametrize("ideal", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_backends_agree_over_whole_runs(name, ideal):
    scenario, _ = catalogue.load_scenario(name)
    agree(name, scenario.duration, ideal)


def test_threads_change_nothing():
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
