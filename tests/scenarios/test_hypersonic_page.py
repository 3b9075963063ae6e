"""Every figure of docs/scenarios-hypersonic.md except those of the board, recomputed and found on the page."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms, seconds
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios import catalogue

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.timeout(900),
    pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here"),
]
PAGE = Path(__file__).parents[2] / "docs" / "scenarios-hypersonic.md"
NOISE = "world.sensors.angular-accelerometer.noise"
SEEDS = range(20)
STRUCK = 20.0
"""When impulses and steps begin (s)."""


def says(text):
    """Print a statement and assert that the page contains it."""
    print(text)
    assert " ".join(text.split()) in " ".join(PAGE.read_text(encoding="utf-8").split())


@cache
def flown(name, **choices):
    """Return one flight, seed 0, every 50 ms."""
    scenario, rest = catalogue.load_scenario(f"hypersonic/{name}", choices)
    assert not rest
    return simulate(scenario, seed=0, log_period=ms(50))


def rms(x):
    return np.sqrt(np.mean(np.square(x), axis=-1))


def errors(log):
    """Return the rms errors of altitude (ft) and speed (ft/s) after 20 s."""
    late = log.t > 20
    return rms(log["law.h_error"][late]), rms(log["law.V_error"][late])


def test_climb_errors_match_the_page():
    for name, change, digits in (
        ("climb-small", "+1 000 ft, +200 ft/s", 4),
        ("climb-large", "+5 000 ft, +1 000 ft/s", 3),
    ):
        h, V = errors(flown(name))
        says(f"| `{name}` | {change} | {h:.3f}, {V:.{digits}f} |")


@cache
def batch(filter):
    """Return errors of h and V and the elevator (deg) of the large climb: 20 seeds with noise, then one without."""
    scenario, _ = catalogue.load_scenario("hypersonic/noise", {"filter": filter})
    spread = {NOISE: np.array([0.01] * len(SEEDS) + [0.0])}
    signals = ("law.h_error", "law.V_error", "actuators.u.delta_e")
    options = {"signals": signals, "log": True, "log_period": ms(50), "spread": spread}
    found = simulate_batch(scenario, seeds=[*SEEDS, 0], **options)
    late = found.ticks > seconds(20)
    return tuple(found.log[s][:, late] for s in signals)


def moved(elevator):
    """Return the smallest and largest rms over seeds of the difference from the climb without noise."""
    added = rms(elevator[:-1] - elevator[-1])
    return np.rad2deg(added.min()), np.rad2deg(added.max())


def test_noise_figures_match_the_page():
    h, V, elevator = batch("tuned")
    h, V = rms(h[:-1]), rms(V[:-1])
    says(f"| h: {h.min():.3f} to {h.max():.3f}; V: at most {V.max():.4f} (20 seeds) |")
    says("noise moves the elevator by {:.2f} to {:.2f}° rms".format(*moved(elevator)))
    h, _, elevator = batch("adaptive")
    low, high = (f"{m:.2f}" for m in moved(elevator))
    assert low == high
    says(f"estimates the frequencies, and noise moves the elevator by {low}° only")
    h, without = rms(h[:-1]), rms(h[-1])
    says(f"An altitude error of {h.min():.2f} to {h.max():.2f} ft rms remains ({without:.2f} ft without noise)")


def test_tracking_error_without_mode_filter_matches_the_page():
    h, _ = errors(flown("noise", filter="none"))
    says(f"tracks as well as `tuned` ({h:.3f} ft under noise")


def test_frequency_mismatch_table_matches_the_page():
    rows = {
        f: [errors(flown("modal-mismatch", filter=f, frequency=q))[0] for q in ("0.90", "1.10")]
        for f in ("tuned", "adaptive")
    }
    says("| `tuned` | {:.3f} | {:.3f} |".format(*rows["tuned"]))
    says("| `adaptive` | {:.2f} | {:.2f} |".format(*rows["adaptive"]))
    for kind in ("accurate", "printed", "none"):
        for q in ("0.90", "1.10"):
            log = flown("modal-mismatch", filter=kind, frequency=q)
            print(kind, q, errors(log), log["law.saturated"][log.t > 100].mean())
            assert np.abs(log["law.h_error"]).max() > 5000
    says("| `accurate`, `printed`, `none` | vehicle lost | vehicle lost |")


def test_frequency_mismatch_over_seeds_matches_the_page():
    found = []
    for q in ("0.90", "1.10"):
        scenario, _ = catalogue.load_scenario("hypersonic/modal-mismatch", {"frequency": q})
        runs = simulate_batch(scenario, seeds=SEEDS, signals=("law.h_error",), log=True, log_period=ms(50))
        found.append(rms(runs.log["law.h_error"][:, runs.ticks > seconds(20)]))
        print(q, found[-1].min(), found[-1].max())
    says(f"noise | h: {np.min(found):.3f} to {np.max(found):.3f} for either sign (20 seeds) |")


def test_model_mismatch_remedies_match_the_page():
    def of(**choices):
        h, V = errors(flown("mismatch", **{"integral": "off"} | choices))
        return h, V

    says("| none (`integral=off`) | {:.1f} | {:.2f} |".format(*of()))
    says("| {:.1f}, {:.2f} (explained [below](".format(*of(integral="on")))
    says("`robust=published`), with which u_h halves the gain | {:.1f} | {:.2f} |".format(*of(robust="published")))
    says("`robust=minus`) | {:.1f} | {:.2f} |".format(*of(robust="minus")))
    says("`robust=smooth`) | {:.1f} | {:.2f} |".format(*of(robust="smooth")))
    says("`robust=sign`) | {:.1f} | {:.2f} |".format(*of(robust="sign")))
    end = abs(flown("mismatch", integral="on")["law.h_error"][-1])
    says("| integrals (`integral=on`, the default) | {:.1f} | {:.2f} |".format(*of(integral="on")))
    says(f"With integrals, the altitude error at the end of the flight is {end:.2f} ft.")


def test_impulse_and_step_gust_figures_match_the_page():
    peaks, gone = [], []
    for kind in ("moment", "normal-force"):
        log = flown("impulse", kind=kind)
        h = np.abs(log["law.h_error"])
        peaks.append(h.max())
        gone.append(log.t[h > 1][-1] + 0.05 - STRUCK)  # from the next row on
    step, better = (flown("step-gust", integral=i)["law.h_error"][-1] for i in ("off", "on"))
    says(f"altitude error at the end {abs(better):.2f} ft; with `integral=off` {abs(step):.1f} ft")
    says(f"peak {peaks[0]:.1f} ft ({peaks[1]:.0f} ft), below 1 ft after {gone[0]:.0f} s ({gone[1]:.0f} s)")


def test_internal_motion_figures_match_the_page():
    linear, table = flown("climb-large", internal="linear", integral="off"), flown("climb-large")
    h, end = errors(linear)[0], abs(linear["law.h_error"][-1])
    says(f"| `linear` | `off` | {h:.1f} ft rms, {end:.1f} ft at the end |")
    left = [errors(flown("climb-large", internal=form))[0] for form in ("linear", "quasi-static")]
    says(f"| `linear` | `on` | {left[0]:.1f} ft rms |")
    says(f"| `quasi-static` | `on` | {left[1]:.2f} ft rms |")
    preview = errors(flown("climb-large", internal="preview"))[0]
    assert f"{preview:.3f}" == f"{errors(table)[0]:.3f}"
    says("`internal=preview` tracks as well as the table computed before the flight")
