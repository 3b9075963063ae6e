"""Packet link that repeats recorded latencies, and files of recorded latencies."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, period, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample
from trimtab.core.time import ms
from trimtab.core.user_file import read_user_text
from trimtab.links.fifo import Fifo, check_ring, deliver, empty_fifo

HEADER = "sent_s,latency_s"


@record
class LatencyTrace:
    """Packet link that repeats the latencies of a recording, packet by packet, with delivery in order.

        latency of the k-th packet sent = latency[k mod n];  arrival_k = max(arrival_(k-1), send_k + latency_k)

    At most one packet is sent per `send_period`, and only if its sample is newer than the last sample sent. The
    recorded times of sending are not used. The recording only defines the sequence of latencies and losses.

    Frames:  those of the transmitted values.    Not modelled: change of latency with the load of the link.
    Valid:   `send_period` >= `period`; ring buffer longer than the longest latency (see `check`).
    Source:  docs page.
    """

    latency: Scalar = quantity(
        "s",
        "Latency of each recorded packet, 0 for a lost packet.",
        low=0,
        off={
            "delay": lambda link: np.zeros_like(link.latency, np.float64),
            "jitter": lambda link: np.full(np.shape(link.latency), mean_received_latency(link)),
            "loss": lambda link: np.where(link.lost, mean_received_latency(link), link.latency),
        },
    )
    lost: Scalar = quantity(
        "1",
        "True for each recorded packet that was lost.",
        kind="flag",
        off={"loss": lambda link: np.zeros_like(link.lost)},
    )
    send_period: int = period("Time between packets.", default=ms(20))
    period: int = period("Period at which the receiving end polls the link.", default=ms(1))
    capacity: int = option("Number of slots of the ring buffer, one per send period.", default=64)

    def check(self) -> None:
        """Raise InputError if the recording is empty or inconsistent, or if the ring buffer is too short for the
        longest latency."""
        latency, lost = np.asarray(self.latency), np.asarray(self.lost)
        if latency.ndim != 1 or not latency.size or lost.shape != latency.shape:
            raise InputError(
                "LatencyTrace.latency",
                f"latencies of shape {latency.shape} and losses of shape {lost.shape} must be lists of equal length",
                fix="make the link with LatencyTrace.of(read_trace(path))",
            )
        if not np.isfinite(latency).all() or latency.min() < 0:
            k = int(np.argmin(np.isfinite(latency) & (latency >= 0)))
            raise InputError(
                "LatencyTrace.latency",
                f"packet {k} has the latency {latency[k]} s, must be at least 0",
                fix="set a latency of at least 0; mark a lost packet in `lost`",
            )
        check_ring("LatencyTrace", self.capacity, float(latency.max()), self.send_period, self.period)

    @classmethod
    def of(cls, trace: "Trace", **settings: Any) -> "LatencyTrace":
        """Return a link that repeats a recording. settings: values of the other fields, e.g. ``send_period=ms(6)``."""
        return cls(latency=trace.latency_s, lost=trace.lost, **settings)

    def init(self, key: Key, like: Sample) -> Fifo:
        """Return the initial state, without packets, for samples with the structure of `like`. The key is not used."""
        return empty_fifo(None, like, self.capacity)

    def step(self, t: Any, state: Fifo, sample: Sample) -> tuple[Fifo, Sample]:
        """Return the new state, and the sample at the receiving end at integer time t."""
        latency, lost = jnp.asarray(self.latency), jnp.asarray(self.lost)
        k = state.sent % latency.shape[0]
        return deliver(
            t,
            state,
            sample,
            lambda: (latency[k], lost[k]),
            send_period=self.send_period,
            period=self.period,
        )


def mean_received_latency(link: LatencyTrace) -> float:
    """Return the mean latency (s) of the packets that were not lost."""
    received = np.asarray(link.latency, np.float64)[~np.asarray(link.lost, np.bool_)]
    return float(received.mean()) if received.size else 0.0


class Trace(NamedTuple):
    """Recording of n packets: time of sending (s, never decreasing), latency (s, 0 for a lost packet), and True for a
    lost packet."""

    sent_s: np.ndarray[Any, Any]
    latency_s: np.ndarray[Any, Any]
    lost: np.ndarray[Any, Any]


def write_trace(path: str | Path, trace: Trace) -> None:
    """Write a recording as a CSV file, from which `read_trace` returns exactly the same numbers. A lost packet has an
    empty latency."""
    rows = zip(trace.sent_s, trace.latency_s, trace.lost, strict=True)
    lines = [HEADER, *(f"{float(sent)!r},{'' if lost else repr(float(latency))}" for sent, latency, lost in rows)]
    _parse_trace(str(path), lines)
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_trace(path: str | Path) -> Trace:
    """Read a recording: CSV text with the header ``sent_s,latency_s`` and one line per packet, in the order sent.

    An empty latency marks a lost packet. Any other text that is not a time in seconds raises InputError, which names
    the file and the line.
    """
    try:
        text = read_user_text(path)
    except FileNotFoundError:
        fix = f"record one: trimtab link-test URI --out DIR; or write CSV text, first line {HEADER}"
        raise InputError(f"{path}", "file not found", fix=fix) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}", f"the file cannot be read as text ({error})", fix="use a CSV text file") from None
    return _parse_trace(str(path), text.splitlines())


def _parse_trace(path: str, lines: list[str]) -> Trace:
    if not any(line.strip() for line in lines):
        raise InputError(path, "the file is empty", fix=f"write the header {HEADER} and at least two packets")
    if lines[0].replace(" ", "").removeprefix("\ufeff") != HEADER:
        raise InputError(f"{path}, line 1", f"the header is {lines[0]!r}", fix=f"write {HEADER}")
    rows = [(n, line) for n, line in enumerate(lines[1:], start=2) if line.strip()]
    packets: list[tuple[float, float, bool]] = []
    for n, line in rows:
        where, fields = f"{path}, line {n}", line.split(",")
        if len(fields) != 2:
            raise InputError(
                where,
                f"the line {line!r} has {len(fields)} fields, but must have 2",
                fix="write decimals with a point, e.g. 0.02,0.041",
            )
        sent, lost = _parse_number(where, "sent_s", fields[0]), not fields[1].strip()
        latency = 0.0 if lost else _parse_number(where, "latency_s", fields[1])
        if latency < 0:
            fix = "write a latency of at least 0, or nothing after the comma for a lost packet"
            raise InputError(where, f"the latency must be at least 0, got {latency} s", fix=fix)
        if packets and sent < packets[-1][0]:
            problem = f"sent at {sent} s, before the packet above it ({packets[-1][0]} s)"
            raise InputError(where, problem, fix="sort the lines by sent_s")
        packets.append((sent, latency, lost))
    if len(packets) < 2:
        raise InputError(
            path, f"packets in the file: {len(packets)}, must be at least 2", fix="record at least two packets"
        )
    sent_s, latency_s, losses = zip(*packets, strict=True)
    return Trace(np.array(sent_s), np.array(latency_s), np.array(losses))


def _parse_number(where: str, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        fix = "write a number of seconds, e.g. 0.041" + ("; nothing for a lost packet" if column == "latency_s" else "")
        raise InputError(where, f"{column} is {text.strip()!r}, not a finite number", fix=fix)
    return value
