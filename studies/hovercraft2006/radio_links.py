"""Radio links: measured latencies, and the delay of the simulated loop.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 5.3.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from trimtab.core.record import to_arrays
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.links.latency import TABLE, bluetooth_link
from trimtab.links.wire import DelayChain
from trimtab.study import Row, at_most, band, within

SECTION = "5.3"
DRAWS = 100_000
PLACE = "[1] table 5.1"


def rows() -> Iterator[Row]:
    """Every column of the table of latencies against drawn packets, and the loop's delay."""
    for pair, paths in TABLE.items():
        drawn = {path: _draw_latencies(pair, path) for path in ("up", "down")}
        for path in ("up", "down"):
            yield from _path(f"{pair} {path}", paths[path], drawn[path])
        yield from _round_trip(f"{pair} round trip", paths["round trip"], drawn["up"] + drawn["down"])
    down, up = DelayChain(ms(6), 6).delay(), DelayChain(ms(20), 2).delay()
    place = "[1] section 6.1"
    whole = (down + up) * 1e3
    yield within(
        "loop/delay", "delay of both chains, 6 x 6 ms and 2 x 20 ms", 76.0, whole, place, tolerance=1e-9, unit="ms"
    )
    note = "The printed chains give 76 ms; the mean waits for the next sample, 3 and 10 ms, come on top."
    yield within(
        "loop/nearly", "the same, in words", 80.0, whole, place, tolerance=5.0, unit="ms", basis="text", note=note
    )


def _path(name: str, row: Any, drawn: Any) -> Iterator[Row]:
    about = {"relative": 0.02, "unit": "ms"}
    where = f"table-5.1/{name}"
    yield within(f"{where}/mean", f"{name}, mean", row.mean_ms, drawn.mean(), PLACE, **about)
    yield within(f"{where}/sd", f"{name}, standard deviation", row.sd_ms, drawn.std(), PLACE, **about)
    shape = "The distribution is reconstructed: its moments are printed, its tails are not."
    few = "an extreme of a few hundred packets"
    faster = float((drawn < row.min_ms).mean())
    what = f"{name}, share of packets faster than the least, {row.min_ms:g} ms"
    yield at_most(f"{where}/min", what, few, faster, PLACE, high=1e-2, basis="text", note=shape)
    slower = float((drawn > row.max_ms).mean())
    what = f"{name}, share of packets slower than the greatest, {row.max_ms:g} ms"
    yield band(f"{where}/max", what, few, slower, PLACE, low=1e-4, high=1e-2, basis="text", note=shape)


def _round_trip(name: str, row: Any, drawn: Any) -> Iterator[Row]:
    note = "Measured by itself: the source's columns do not add up, so that no two independent links can give it."
    about = {"unit": "ms", "must_hold": False, "note": note, "tolerance": 0.005}
    where = f"table-5.1/{name}"
    yield within(f"{where}/mean", f"{name}, mean", row.mean_ms, drawn.mean(), PLACE, **about)
    yield within(f"{where}/sd", f"{name}, standard deviation", row.sd_ms, drawn.std(), PLACE, **about)
    out = float(((drawn < row.min_ms) | (drawn > row.max_ms)).mean())
    what = f"{name}, share of up + down outside {row.min_ms:g} … {row.max_ms:g} ms"
    yield at_most(f"{where}/range", what, "none", out, PLACE, high=0.05, basis="text")


def _draw_latencies(pair: str, path: str) -> Any:
    """Latencies in ms, (DRAWS,)."""
    link, own = to_arrays(bluetooth_link(pair, path)), key(1 if path == "up" else 2)
    latency, _ = jax.jit(jax.vmap(lambda k: link.draw(own, k)))(np.arange(DRAWS))
    return np.asarray(latency) * 1e3
