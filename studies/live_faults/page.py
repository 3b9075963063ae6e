"""Docs page of the campaign, written from its outcomes."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from studies.live_faults.case import CaseOutcome
from studies.live_faults.verdict import BOUNDS, LIFT_S, SERVO_S, SILENCE_S
from trimtab import __version__

HEADINGS = ("case", "what was done", "what the vehicle did", "evidence in the logs", "verdict")
WORDS = """# Faults over the live pair

This page shows what happens to a vehicle in flight when its link, its processes or its machine fail. Read it before you
trust the live pair with a craft of your own. [Fly](../live/fly.md) and [Vehicle](../live/vehicle.md) explain the two
programs.

The pair is a vehicle (`trimtab vehicle hovercraft/forward`) and an autopilot (`trimtab fly`). They talk over signed
datagrams or a pair of serial devices. The study disturbs the link between them. Each case is a separate flight. One
second after arming, something goes wrong. These two commands write this page:

    trimtab live-faults --page docs/studies/live-faults.md
    trimtab live-faults --real-time --only CASE --page docs/studies/live-faults.md

The second command flies the cases with serial devices, which exist in real time only.

The page shows the campaign as it ran: {cases} cases, {held} hold, {skipped} skipped, {failed} fail.
With `--only CASE` the command flies that case and updates its row of the page. `--out DIR` keeps the logs.

Flown: {runs}.

## Virtual time and real time

    trimtab live-faults                                every case, in a few minutes
    trimtab live-faults --draw 1000 --seed 1           flights drawn at random
    trimtab live-faults --only drawn-1-17              repeat one of these flights, bit for bit

A flight in virtual time runs in one process on one virtual clock ([Testing](../testing.md)). Vehicle and autopilot are
the same programs as in real time, but they use the clock, disk, network and processes of
`trimtab.flight.virtual_machine`. The seed decides every packet, and no other program can disturb the flight. `--json`
prints the hash of all packets, log rows and events as `digest`. The campaign flies one flight in twenty twice, in two
processes. Both hashes must be equal.

Flights with serial devices, and cases that are not flights, need `--real-time`.

## What holds means

The vehicle's own log is judged, row by row, every millisecond, by code that shares nothing with the firmware:

- no force without a command: {servo:g} ms (a servo frame) after the vehicle has gone to failsafe or is disarmed, the
  fan gives nothing;
- never more than {silence:g} ms without an accepted command, else failsafe;
- {lift:g} s after failsafe the lift fan stops; it stops at once when the vehicle is disarmed;
- failsafe ends only after a request to arm;
- at the end the vehicle is in failsafe or disarmed, without force and lift;
- at all times the vehicle stays within {bounds}.

In addition, no process may end early or with a traceback. All logs must be readable and must say what happened (fourth
column). A fault that the vehicle must survive fails if the vehicle goes to failsafe. A fault that must stop the vehicle
fails if the vehicle flies on.

## How the faults are made

- Fault words are injected in flight, for one second or for good, by the mechanism of
  [`trimtab inject`](../loop/faults.md). Faults of the uplink act between the link and the failsafe, as on a real link.
  The first rule above does not apply while the actuators themselves are at fault, because the vehicle then obeys
  no command.
- The study controls the link between the two ends. It cuts the link, it delays, truncates and repeats packets, and it
  inverts bits.
- A stepped wall clock changes the time of day that one process reads, in flight. Both ends fly by the monotonic clock.
- In `vehicle-restarted` the clock of the *vehicle* restarts. The autopilot measures another offset, and the vehicle
  stays disarmed, because an autopilot asks to arm only once, when it starts.
- In `autopilot-restarted` a new `trimtab fly` asks to arm when it starts. After a failsafe the vehicle refuses this
  until it is at rest and a person has given `--rearm`.
- A full disk is filled to the last byte in flight. In real time it is a disk of 160 megabytes below the folder of the
  log. Only root can make it; other users skip the case.
- A flood repeats recorded frames. It has ten times the bytes that the link usually carries.
- The log of each autopilot is replayed with the frames that it received. All bits must be equal.

In real time the flights need an idle machine. A flight that failed is repeated if the log shows that a process, the
line or the campaign waited longer than 100 ms for the processor. A flight that fails twice for this reason counts as
"kept waiting", neither as passed nor as failed.

## Flights drawn at random

    trimtab live-faults --draw 1000 --seed 1
    trimtab live-faults --real-time --draw 200 --seed 1 --jobs 3

Number and seed of a flight decide what goes wrong in it. An autopilot is killed, frozen, starved, replaced,
impersonated, or started with a wrong clock or wrong settings. A vehicle is killed, frozen, starved or restarted. The
process of its outputs is killed, frozen or starved. A disk is full, or a disk or a terminal hangs. A sensor, the
uplink, the downlink or the actuators fail. The link is bad or cut. Half of the flights have a second, passing
disturbance. In a quarter of the flights two parts stall, up to a second apart.

The draw also decides, before the flight, how the flight must end and which lines both logs must and may contain. Any
other line is counted as unexplained. After a refusal (clock, scenario, key) the autopilot flies with the command that
the refusal suggests. `--only drawn-1-17` repeats one flight.

In virtual time a driver reads the port of the outputs once a millisecond, in every flight. It must apply the safe
values at the latest 100 ms after the vehicle or the process of its outputs stopped, and 250 ms after the last packet of
an autopilot arrived. The check allows 1 ms for the period of the driver, 2 ms for a packet in transit, and the delay
of an injected fault of the uplink. The longest times that were seen are printed at the end.

## Outcomes

{table}
"""


def write_page(
    file: Path, outcomes: Sequence[CaseOutcome], names: Sequence[str], wall: float, *, apart: bool, is_real: bool
) -> None:
    """Write a new page of all cases, or update the rows of some cases in the existing page.

    Args:
        file: the page.
        outcomes: outcomes of the flown cases.
        names: names of all cases, in the order of the rows.
        wall: duration of the campaign (s).
        apart: True if only these cases were flown, not all.
        is_real: True for real time, False for virtual time.
    """
    before = file.read_text("utf-8") if apart and file.exists() else ""
    flown = [one.name for one in outcomes if not one.skipped]
    run = describe_flights(flown, wall, os.cpu_count() or 1, apart=apart, is_real=is_real)
    file.write_text(format_page(outcomes, run, before, names), "utf-8")


def format_page(outcomes: Sequence[CaseOutcome], run: str, before: str = "", order: Sequence[str] = ()) -> str:
    """Return the page in Markdown.

    Args:
        outcomes: outcomes of the flown cases.
        run: description of the flights from `describe_flights`.
        before: the existing page. The new page keeps its runs and the rows that outcomes do not replace. A skipped case
            replaces no row. Empty: a new page.
        order: names of all cases, in the order of the rows.
    """
    rows = {one.name: _format_row(one) for one in outcomes if one.skipped} | _read_rows(before)
    rows |= {one.name: _format_row(one) for one in outcomes if not one.skipped}
    rows = {name: rows[name] for name in [*order, *rows] if name in rows and (name in order or not order)}
    verdicts = [row.rpartition(" | ")[2].removesuffix(" |") for row in rows.values()]
    units = {"yaw rate": "rad/s"}
    names = {p.removeprefix("truth.").replace("_", " "): limit for p, limit in BOUNDS.items()}
    return WORDS.format(
        cases=len(rows),
        held=verdicts.count("holds"),
        skipped=sum(v.startswith("skipped") for v in verdicts),
        failed=sum(v.startswith("**fails**") for v in verdicts),
        runs="; ".join([*_read_runs(before), run]),
        servo=SERVO_S * 1e3,
        silence=SILENCE_S * 1e3,
        lift=LIFT_S,
        bounds=", ".join(f"{n} {limit:g} {units.get(n, 'm/s')}" for n, limit in names.items()),
        table="\n".join([_format_line(HEADINGS), _format_line("---" for _ in HEADINGS), *rows.values()]),
    )


def describe_flights(names: Sequence[str], wall: float, cores: int, *, apart: bool, is_real: bool) -> str:
    """Return a description of how the named cases were flown. apart: True if only these cases were flown, not all."""
    which = ", ".join(f"`{n}`" for n in names) if apart else f"{len(names)} cases"
    kind = "real" if is_real else "virtual"
    return f"{which} in {kind} time in {wall:.0f} s on {cores} cores (trimtab {__version__})"


def _read_rows(before: str) -> dict[str, str]:
    """Return case -> its row of a page."""
    return {found[1]: found[0] for found in re.finditer(r"^\| `([^`]+)` \|.*\|$", before, re.MULTILINE)}


def _read_runs(before: str) -> list[str]:
    """Return the descriptions of the flights from which a page was written."""
    found = re.search(r"^Flown: (.*)\.$", before, re.MULTILINE)
    return found[1].split("; ") if found else []


def _format_row(one: CaseOutcome) -> str:
    verdict = {"holds": "holds", "skipped": f"skipped: {one.skipped}"}.get(
        one.verdict, f"**fails**: {'; '.join(one.problems)}"
    )
    return _format_line((f"`{one.name}`", one.does, one.happened, "<br>".join(one.said), verdict))


def _format_line(cells: object) -> str:
    texts = (" ".join(str(c).replace("|", "\\|").split()) for c in cells)  # type: ignore[attr-defined]
    return f"| {' | '.join(texts)} |"
