"""`trimtab calibrate link`: latency table of a simulated link, from recorded delays."""

from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.special import ndtri

from trimtab.commands.calibrate_bench import ADD, DATA, DRAW
from trimtab.commands.calibrate_files import CalibrationReport, finish_calibration
from trimtab.commands.options import JSON
from trimtab.core.errors import InputError
from trimtab.flight.line_delays import DelayModel, fit_delay_model
from trimtab.links.latency import gamma_table, normal_scores
from trimtab.links.latency_trace import Trace, read_trace
from trimtab.loop.calibration import Calibration, Covariance, Entry
from trimtab.plots.calibration import FitCurve, FitPanel

PACKETS_MIN = 50
"""Minimum number of received packets for a latency table."""
SHORTEST, LONGEST = 1e-6, 5.0
"""Minimum and maximum plausible median latency (s)."""
TREND, CHANGE = 0.8, 0.1
"""Largest accepted correlation of the latencies with the times of sending, and largest accepted change of the latency
from the first to the last packets, as a fraction of the median. A trace is rejected if both are exceeded."""
APART = 0.2
"""Difference between the measured and the fitted share of packets, at one latency, above which a note is printed."""
ROUNDED = 0.1
"""Largest step between two latencies, as a fraction of the median, that counts as the resolution of the clock."""
FAR = 10.0
"""Multiple of the 99 % quantile above which a latency is reported as an outlier."""


@click.command(name="link")
@DATA
@click.option(
    "--way", type=click.Choice(("up", "down")), required=True, help="Direction: up (to vehicle) or down (from vehicle)."
)
@ADD
@DRAW
@JSON
def calibrate_link(data: Path, way: str, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate the delays of a radio link.

    DATA is a recording of `trimtab link-test --out` (columns sent_s and latency_s).
    """
    trace = read_trace(data)
    notes = _check_trace(f"file {data.name!r}", trace)
    model = fit_delay_model(trace)
    calibration = _calibrate_link(data.name, way, trace, model)
    received = np.sort(trace.latency_s[~trace.lost])
    n, table = len(received), calibration.entries[f"world.{way}link.latency"].value
    share = (np.arange(n) + 0.5) / n
    fitted = np.interp(ndtri(share), normal_scores(), table)
    curve = FitCurve(100 * share, 1e3 * received, 1e3 * fitted, np.ones(n, bool), 100 * share, 1e3 * fitted)
    panel = FitPanel(f"{way}link", "share of packets (%)", "latency (ms)", [curve], f"{100 * model.loss:.2g} % lost")
    apart = _find_misfit(received, fitted, share)
    if apart > APART:
        text = (
            f"the latencies do not follow the fitted distribution: the shares of packets differ by {100 * apart:.0f} %"
        )
        notes = (*notes, f"{text}. See the picture of --plot; measure again with one load and one route")
    notes = (*notes, "to use this table in a scenario, add --set links=measured if the scenario has this choice")
    report = CalibrationReport(data.name, len(trace.lost), (), (panel,), notes)
    finish_calibration("link", calibration, report, out, plot, as_json)


def _find_misfit(received: Any, fitted: Any, shares: Any) -> float:
    """Return the largest difference between the measured and the fitted share of packets up to a latency.

    The shares are compared between two values of the clock, where rounding does not change them.

    Args:
        received: sorted latencies (n,).
        fitted: latencies (n,) up to which the fitted distribution has the shares (n,).
        shares: shares of packets, which rise from 0 to 1.
    """
    values = np.unique(received)
    half = min(float(np.min(np.diff(values))), ROUNDED * float(np.median(received))) / 2
    ends = np.concatenate([values - half, values + half])
    measured = np.searchsorted(received, ends) / len(received)
    return float(np.max(np.abs(np.interp(ends, fitted, shares) - measured)))


def _check_trace(where: str, trace: Trace) -> tuple[str, ...]:
    """Return notes on outliers of the recorded latencies; raise InputError for an implausible recording."""
    received = trace.latency_s[~trace.lost]
    if len(received) < PACKETS_MIN:
        problem = f"{len(received)} packets arrived, too few for a distribution"
        raise InputError(where, problem, fix=f"record at least {PACKETS_MIN} packets, preferably 300")
    if not SHORTEST <= np.median(received) <= LONGEST:
        problem = f"the median latency must be between {1e6 * SHORTEST:g} us and {LONGEST:g} s,"
        problem += f" got {np.median(received):.3g} s"
        raise InputError(where, problem, fix="check the unit: sent_s and latency_s are both in seconds")
    _refuse_unchanged(where, trace)
    same = (np.diff(trace.sent_s) == 0) & (np.diff(trace.latency_s) == 0) & (np.diff(trace.lost.astype(int)) == 0)
    if same.any():
        problem = f"the packet sent at {trace.sent_s[int(np.argmax(same))]:.9g} s appears twice"
        raise InputError(where, problem, fix="remove one of the two lines")
    most = float(np.quantile(received, 0.99))
    wild = np.flatnonzero(~trace.lost & (trace.latency_s > FAR * most))
    if not len(wild):
        return ()
    k = int(wild[np.argmax(trace.latency_s[wild])])
    calm = np.delete(trace.latency_s, wild)[~np.delete(trace.lost, wild)]
    text = (
        f"the packet sent at {trace.sent_s[k]:.6g} s took {trace.latency_s[k]:.3g} s;"
        f" 99 % of the packets took at most {most:.2g} s."
    )
    text += f" Such packets ({len(wild)}) raise the deviation to {np.std(received):.2g} s, from {np.std(calm):.2g} s."
    return (f"{text} Remove the lines of these packets from the file if the delays are not real",)


def _refuse_unchanged(where: str, trace: Trace) -> None:
    """Raise InputError if times or latencies are all equal, or if the latencies rise or fall all the time."""
    sent, latency = trace.sent_s[~trace.lost], trace.latency_s[~trace.lost]
    for name, values in (("sent_s", sent), ("latency_s", latency)):
        if np.ptp(values) == 0:
            problem = f"{name} is {values[0]:.6g} in each line"
            fix = "write measured times, with a resolution that shows how they differ, e.g. 0.1 ms"
            raise InputError(where, problem, fix=fix)
    first, last = (float(np.median(part)) for part in (latency[: len(latency) // 10], latency[-(len(latency) // 10) :]))
    changes = abs(last - first) > CHANGE * np.median(latency)
    if changes and abs(np.corrcoef(sent, latency)[0, 1]) > TREND:
        problem = "the latencies change with sent_s, "
        problem += f"from {first:.3g} s in the first packets to {last:.3g} s in the last"
        fix = "write latencies, not times of arrival; use one clock; and reduce the load if the link is overloaded"
        raise InputError(where, problem, fix=fix)


def _calibrate_link(file: str, way: str, trace: Trace, model: DelayModel) -> Calibration:
    """Return a calibration with a link's latency table, delay parameters with standard errors, and packet loss."""
    received = trace.latency_s[~trace.lost]
    n, packets, spread = len(received), len(trace.lost), max(float(np.std(received)), 1e-300)
    about: dict[str, Any] = {"source": f"{file}: {packets} packets", "procedure": f"{way}link"}
    z = (received - received.mean()) / spread
    kurtosis, skewness = max(float(np.mean(z**4)), 1.1), float(np.mean(z**3))
    errors = np.array([model.sd / np.sqrt(n), model.sd * np.sqrt((kurtosis - 1) / (4 * n))])
    rho = float(np.clip(skewness / np.sqrt(kurtosis - 1), -0.99, 0.99))
    loss_error = float(np.sqrt(max(model.loss * (1 - model.loss), 1 / packets) / packets))
    table = gamma_table(model.mean, model.sd, model.shift)
    mean, deviation = f"{way}link.mean", f"{way}link.deviation"
    entries = {
        f"world.{way}link.latency": Entry(table.tolist(), "s", **about),
        f"world.{way}link.loss": Entry(model.loss, "1", loss_error, **about),
        mean: Entry(model.mean, "s", float(errors[0]), freedom=n - 1, **about),
        deviation: Entry(model.sd, "s", float(errors[1]), freedom=n - 1, **about),
        f"{way}link.shift": Entry(model.shift, "s", **about),
    }
    P = np.outer(errors, errors) * np.array([[1.0, rho], [rho, 1.0]])
    return Calibration(entries, (Covariance((mean, deviation), P.tolist(), f"{way}link"),))
