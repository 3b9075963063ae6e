"""Radio links: measured latencies, and the delay of the simulated loop.

The thesis prints mean, standard deviation, least and greatest latency of each path, but not the number of packets.
The simulated links are built from the mean, the standard deviation and the least latency. Their draws predict the
greatest latency of some hundred packets, and the round trip over two links.
[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 5.3.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from studies.hovercraft2006._flights import load_scenario
from studies.hovercraft2006._pictures import Panel, draw_panels
from trimtab.core.record import to_arrays
from trimtab.core.rng import key
from trimtab.core.time import to_seconds
from trimtab.links.latency import TABLE, bluetooth_link
from trimtab.study import Row, band, overlaps, within

SECTION = "5.3"
DRAWS = 100_000
PACKETS = 300
"""Number of packets of a measurement. It is reconstructed from the printed greatest latencies."""
PLACE = "[1] table 5.1"
NOT_ADDITIVE = ("free2move/linksys 2.9/41.0", "free2move/linksys 2.9/16.2")
"""Pairs of radios whose printed mean round trip exceeds the sum of the means of uplink and downlink."""
SUM = "Sum of two independent paths. The round trip was measured separately, so three sampling errors add up."


def rows() -> Iterator[Row]:
    """Yield the printed latencies compared with drawn packets, and the delay of the loop."""
    for pair, paths in TABLE.items():
        draws = {path: _draw_latencies(pair, path) for path in ("up", "down")}
        for path in ("up", "down"):
            yield from _path_rows(f"{pair} {path}", paths[path], draws[path])
        yield from _round_trip_rows(pair, paths, draws["up"] + draws["down"])
    world = load_scenario("forward").world
    delay = 1e3 * to_seconds(sum(link.steps * link.period for link in (world.downlink, world.uplink)))
    note = "Six steps of 6 ms and two of 20 ms. The mean waits for the next sample, 3 and 10 ms, are not included."
    what = "delay of the links of the simulated autopilot"
    text: dict[str, Any] = {"unit": "ms", "basis": "text", "note": note}
    yield band("loop/nearly", what, "nearly 80", delay, "[1] section 6.1", low=75.0, high=80.0, **text)


def _path_rows(name: str, printed: Any, draws: Any) -> Iterator[Row]:
    given: dict[str, Any] = {"relative": 0.02, "unit": "ms", "basis": "input"}
    where = f"table-5.1/{name}"
    yield within(f"{where}/mean", f"{name}, mean", printed.mean_ms, draws.mean(), PLACE, **given)
    yield within(f"{where}/sd", f"{name}, standard deviation", printed.sd_ms, draws.std(), PLACE, **given)
    note = "The distribution's tail is reconstructed, and so is the number of packets."
    greatest = draws[: DRAWS // PACKETS * PACKETS].reshape(-1, PACKETS).max(axis=1)
    yield overlaps(
        f"{where}/max",
        f"{name}, greatest of {PACKETS} packets, 2 … 98 % of measurements",
        (printed.max_ms, printed.max_ms),
        np.quantile(greatest, (0.02, 0.98)),
        PLACE,
        unit="ms",
        basis="printed",
        note=note,
    )


def _round_trip_rows(pair: str, paths: Any, draws: Any) -> Iterator[Row]:
    """Yield round trips, compared within three standard errors of three samples of PACKETS."""
    printed, name = paths["round trip"], f"{pair} round trip"
    error = 3 * math.sqrt(sum(paths[p].sd_ms ** 2 for p in paths) / PACKETS)
    adds = pair not in NOT_ADDITIVE
    note = (
        SUM
        if adds
        else "The printed means do not add up: their sum is 4 or 5 ms too small, more than the sampling error."
    )
    about: dict[str, Any] = {"unit": "ms", "tolerance": error, "must_hold": adds, "note": note}
    yield within(f"table-5.1/{name}/mean", f"{name}, mean", printed.mean_ms, draws.mean(), PLACE, **about)
    about |= {"tolerance": error / math.sqrt(2), "must_hold": True, "note": SUM}
    what = f"{name}, standard deviation"
    yield within(f"table-5.1/{name}/sd", what, printed.sd_ms, draws.std(), PLACE, **about)


def _draw_latencies(pair: str, path: str) -> Any:
    """Draw latencies (ms) of one path of a pair of radios, (DRAWS,)."""
    link, own = to_arrays(bluetooth_link(pair, path)), key(1 if path == "up" else 2)
    latency, _ = jax.jit(jax.vmap(lambda k: link.draw(own, k)))(np.arange(DRAWS))
    return np.asarray(latency) * 1e3


def figures(folder: Path) -> Iterator[Path]:
    """Plot figure 5.4: mean round trip against the rate of the downlink, printed and drawn."""
    curves = []
    for radios, mark in (("free2move/linksys", "o"), ("free2move/free2move", "s")):
        pairs = [p for p in TABLE if p.startswith(radios)]
        rates = [float(p.rpartition("/")[2]) for p in pairs]
        draws = [(_draw_latencies(p, "up") + _draw_latencies(p, "down")).mean() for p in pairs]
        curves += [
            (rates, [TABLE[p]["round trip"].mean_ms for p in pairs], f"{radios}, table 5.1", f"{mark}-"),
            (rates, draws, f"{radios}, drawn", f"{mark}:"),
        ]
    panel = Panel("", "downlink (kb/s)", "mean round trip (ms)", tuple(curves), (0, 180))
    yield draw_panels(folder / "fig-5.4.png", "[1] fig. 5.4: round trip", [panel])
