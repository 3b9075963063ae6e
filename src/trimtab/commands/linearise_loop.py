"""`trimtab linearise SCENARIO --closed-loop`: poles and margins of the whole sampled loop."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.output import check_picture, draw_plot, new_table, print_files, print_json, print_table
from trimtab.core.errors import InputError
from trimtab.design.loop_map import STABLE, LoopMap, LoopMargins, loop_margins
from trimtab.design.poles import participation
from trimtab.run.loop_linearisation import linearise_loop
from trimtab.run.plant import Plant

SHOWN = 0.05
"""Minimum participation of a state in a mode. States with less are not shown."""
CUT = 1e-5
"""Distance between two poles of the sampled loop below which the two poles belong to one group."""


def print_loop(
    plant: Plant,
    *,
    direct: bool,
    off: Iterable[str],
    settle: float | None,
    round_time: float | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Linearise the closed loop of a scenario, and print or draw its poles and margins."""
    if plant.scenario is None:
        fix = "name a scenario, e.g.  trimtab linearise hovercraft/forward --closed-loop"
        raise InputError("--closed-loop", f"{plant.name} is a vehicle without a loop", fix=fix)
    if picture is not None and round_time is not None:
        problem = "a closed path has no Bode plot, because each frequency couples to all others"
        raise InputError("--plot", problem, fix="leave --plot out, or --round")
    check_picture(picture, None)
    loop = linearise_loop(plant.scenario, direct=direct, off=off, settle=settle, round_time=round_time)
    margins = loop_margins(loop) if loop.growth() <= 1 + STABLE else None
    if margins is not None and round_time is not None:
        margins = margins._replace(
            crossings={}
        )  # phase margins need a single frequency, but a closed path couples each frequency to its harmonics
    files: list[Path] = []
    if picture is not None:
        from trimtab.plots.bode import plot_bode  # matplotlib is imported only to draw a picture

        files = draw_plot(picture, plot_bode, loop, title=plant.name)
    if as_json:
        print_json(_loop_json(plant.name, loop, margins), files)
        return
    _print_loop(plant.name, loop, margins)
    print_files(files)


def loop_modes(loop: LoopMap) -> list[tuple[complex, complex, list[tuple[str, float]]]]:
    """Return for each mode, slowest first: discrete pole, equivalent continuous pole (1/s) and participating states."""
    whole = loop.transition()
    names = [n for n, idle in zip(loop.states, loop.idle, strict=True) if not idle]
    modes = []
    for pole in loop.poles():
        if abs(pole) <= loop.deadbeat or pole.imag < -1e-9:
            continue
        share = participation(whole, pole, min(CUT, 0.1 * abs(pole)))
        pairs = sorted(zip(names, share.tolist(), strict=True), key=lambda pair: -pair[1])
        modes.append((complex(pole), complex(np.log(complex(pole)) / loop.period), [p for p in pairs if p[1] >= SHOWN]))
    return modes


def _loop_json(name: str, loop: LoopMap, margins: LoopMargins | None) -> dict[str, Any]:
    modes = [
        {"z": [z.real, z.imag], "pole": [s.real, s.imag], "states": dict(states)} for z, s, states in loop_modes(loop)
    ]
    result: dict[str, Any] = {
        "scenario": name,
        "period": loop.period,
        "tick": loop.tick,
        "states": len(loop.states),
        "is_stable": margins is not None,
        "modes": modes,
    }
    if margins is not None:
        result |= margins._asdict()
    return result


def _print_loop(name: str, loop: LoopMap, margins: LoopMargins | None) -> None:
    click.echo(f"{name}: sampled closed loop with {len(loop.states)} states and a period of {loop.period:g} s")
    table = new_table(">|z|", ">continuous [1/s]", ">rad/s", ">damping", "states, by participation")
    for z, s, states in loop_modes(loop):
        text = f"{s.real:+.5g}" + (f" ± {abs(s.imag):.5g}i" if abs(s.imag) > 1e-9 else "")
        damping = f"{-s.real / abs(s):.3f}" if abs(s) > 1e-12 else "-"
        words = ", ".join(f"{_plain_name(n)} {v:.2f}" for n, v in states[:5])
        table.add_row(f"{abs(z):.6f}", text, f"{abs(s):.4g}", damping, words)
    print_table(table)
    fast = sum(abs(p) <= loop.deadbeat for p in loop.poles())
    if fast:
        click.echo(f"and {fast} poles at zero, which belong to packets in transit and held values")
    if margins is None:
        click.echo(f"NOT stable: the state grows by a factor of {loop.growth():.6g} in {loop.period:g} s")
        return
    up = "without upper limit" if math.isinf(margins.gain_up) else f"up to {margins.gain_up:.4g}"
    down = "without lower limit" if margins.gain_down == 0 else f"down to {margins.gain_down:.4g}"
    click.echo(
        f"all commands changed together: stable for a gain factor {up}, {down}; additional delay: "
        + _delay_text(margins, loop)
    )
    for command, crossings in margins.crossings.items():
        for frequency, phase in crossings:
            click.echo(
                f"{command} alone: gain crosses 1 at {frequency:.4g} rad/s, phase margin {math.degrees(phase):.1f} deg"
            )


def _delay_text(margins: LoopMargins, loop: LoopMap) -> str:
    if math.isinf(margins.delay):
        return "stable with 1 s and more"
    return f"stable with {margins.delay * 1e3:g} ms, unstable with {(margins.delay + loop.tick) * 1e3:g} ms"


def _plain_name(name: str) -> str:
    return name.replace("s.x.", "").replace("s.", "world.", 1).replace("a.", "autopilot.", 1)
