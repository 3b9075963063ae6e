"""[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, table 5.1."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.links.latency import TABLE, bluetooth_link

PRINTED = """
Free2Move/Linksys   2.9/41.0 | 51.04 15.09 22 118 | 39.02 9.23 20 74    | 95.48 18.01 58 157
Free2Move/Free2Move 2.9/41.0 | 66.01 10.22 40 102 | 95.36 12.02 59 141  | 160.21 13.86 124 194
Free2Move/Linksys   2.9/22.0 | 40.81 10.61 22 90  | 34.32 8.18 19 67    | 77.54 14.44 46 110
Free2Move/Free2Move 2.9/22.0 | 62.76 11.13 40 106 | 100.01 13.64 53 161 | 162.98 16.58 113 208
Free2Move/Linksys   2.9/16.2 | 38.83 8.80 20 68   | 32.62 8.49 14 65    | 75.69 13.82 49 126
"""
ROWS = [(pair, path) for pair in TABLE for path in ("up", "down")]


def test_delay_table_matches_the_printed_table_5_1():
    printed = {}
    for line in PRINTED.strip().splitlines():
        pair, *paths = line.split("|")
        rows = [tuple(float(x) for x in path.split()) for path in paths]
        printed[" ".join(pair.lower().split())] = dict(zip(("up", "down", "round trip"), rows, strict=True))
    assert {pair: dict(rows) for pair, rows in TABLE.items()} == printed
    difference = [r["round trip"].mean_ms - r["up"].mean_ms - r["down"].mean_ms for r in TABLE.values()]
    np.testing.assert_allclose(difference, [5.42, -1.16, 2.41, 0.21, 4.24], atol=1e-9)


@pytest.mark.thorough(
    "free2move/linksys 2.9/41.0-up",
    "free2move/linksys 2.9/41.0-down",
    "free2move/free2move 2.9/41.0-up",
    "free2move/free2move 2.9/41.0-down",
    "free2move/linksys 2.9/22.0-up",
    "free2move/linksys 2.9/22.0-down",
    "free2move/free2move 2.9/22.0-up",
    "free2move/free2move 2.9/22.0-down",
    "free2move/linksys 2.9/16.2-up",
)
@pytest.mark.parametrize(("pair", "path"), ROWS)
def test_drawn_latencies_have_the_measured_mean_and_spread(pair, path):
    """Mean and standard deviation within 2 %. No packet is faster than the smallest measured latency less 2 ms."""
    link = bluetooth_link(pair, path)
    link.check()
    latency, lost = jax.jit(jax.vmap(lambda k: link.draw(key(1), k)))(jnp.arange(100_000))
    row, drawn = TABLE[pair][path], np.asarray(latency) * 1e3
    assert drawn.mean() == pytest.approx(row.mean_ms, rel=0.02)
    assert drawn.std() == pytest.approx(row.sd_ms, rel=0.02)
    assert drawn.min() > row.min_ms - 2
    beyond = (drawn > row.max_ms).mean()  # a largest value out of a few hundred
    assert 1e-4 < beyond < 1e-2
    assert not np.asarray(lost).any()


def test_send_periods_match_the_thesis():
    up, down = (bluetooth_link("free2move/linksys 2.9/22.0", path) for path in ("up", "down"))
    assert (up.send_period, up.period, down.send_period, down.period) == (ms(20), ms(1), ms(6), ms(1))
    other = bluetooth_link("free2move/linksys 2.9/22.0", "down", loss=0.02, send_period=ms(12), period=ms(2))
    assert (other.send_period, other.period, other.loss) == (ms(12), ms(2), 0.02)
    other.check()


def test_gamma_shape_matches_the_reconstructed_values():
    """2.9/22.0 up: shift 20 ms, k 3.85, scale 5.41; down: 17, 4.48, 3.86."""
    for path, shift, k, scale in (("up", 20, 3.85, 5.41), ("down", 17, 4.48, 3.86)):
        row = TABLE["free2move/linksys 2.9/22.0"][path]
        assert row.min_ms - 2 == shift
        assert ((row.mean_ms - shift) / row.sd_ms) ** 2 == pytest.approx(k, abs=0.005)
        assert row.sd_ms**2 / (row.mean_ms - shift) == pytest.approx(scale, abs=0.005)


def test_unknown_pairs_and_paths_are_refused_with_the_choices():
    with pytest.raises(
        InputError, match=r"no pair of modules 'linksys'.*\nChoices: .*free2move/free2move 2\.9/22\.0"
    ) as caught:
        bluetooth_link("linksys", "up")
    assert caught.value.choices == tuple(TABLE)
    with pytest.raises(InputError, match=r"Fix: write 'free2move/linksys 2\.9/22\.0'"):
        bluetooth_link("free2move/linksys 2.9/22", "up")
    with pytest.raises(InputError, match=r"no path 'round trip': a round trip is two links.*\nChoices: up, down"):
        bluetooth_link("free2move/linksys 2.9/22.0", "round trip")
