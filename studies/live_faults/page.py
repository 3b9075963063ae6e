"""Docs page of the campaign, written from its outcomes."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from studies.live_faults.case import CaseOutcome
from studies.live_faults.verdict import BOUNDS, LIFT_S, SERVO_S, SILENCE_S
from trimtab import __version__

HEADINGS = ("case", "injected fault or event", "reaction of the vehicle", "evidence in the logs", "verdict")
WORDS = """# Faults in live flight

This page shows how a vehicle in flight reacts when its link, its processes or its computer fail. It is for users who
want to fly a craft of their own. Read [Fly](../live/fly.md) and [Vehicle](../live/vehicle.md) first. These two pages
explain the programs that are tested here.

The two programs are a vehicle (`trimtab vehicle hovercraft/forward`) and an autopilot (`trimtab fly`). Together they
are called the live pair. They exchange signed datagrams, or are connected by a pair of serial devices. Each case of the
study is a separate flight of the live pair with one fault. In most cases the fault occurs one second after arming.
These two commands write this page:

    trimtab live-faults --page docs/studies/live-faults.md
    trimtab live-faults --real-time --only CASE --page docs/studies/live-faults.md

The first command flies all cases in virtual time ([below](#virtual-time-and-real-time)). The second command flies a
case with serial devices, which is possible only in real time.

Result of all cases: {cases} cases, {held} hold, {skipped} skipped, {failed} fail.

With `--only CASE`, the command flies only the case `CASE` and updates the row of this case in the table. `--out DIR`
stores the logs of the flights. The next paragraph lists the cases that were flown by the same command, and the duration
of the command.

Flown: {runs}.

## Virtual time and real time

    trimtab live-faults                                every case, in a few minutes
    trimtab live-faults --draw 1000 --seed 1           flights drawn at random
    trimtab live-faults --only drawn-1-17              repeat one of these flights, bit for bit

By default, the flights are in virtual time. A flight in virtual time runs in one process on one virtual clock
([Testing](../testing.md)). Vehicle and autopilot are the same programs as in real time, but they use the clock, disk,
network and processes of `trimtab.flight.virtual_machine`. The seed determines every packet, and other programs on the
machine cannot disturb the flight. With `--json`, the command prints a hash of all packets, log rows and events as
`digest`. As a check, one flight in twenty is flown twice, in two processes, and the two hashes must be equal.

Flights with serial devices, and cases that are not flights, need `--real-time`.

## Criteria

A case holds if the vehicle meets the following criteria. They are checked in every row of the vehicle's log (one row
every millisecond), by code that shares nothing with the firmware:

- without a command the fan produces no force: its thrust is zero {servo:g} ms (one servo frame) after the vehicle went
  to failsafe or was disarmed;
- the vehicle never flies for more than {silence:g} ms without an accepted command, because it then goes to failsafe;
- the lift fan is off {lift:g} s after the start of failsafe, and immediately after the vehicle is disarmed;
- failsafe ends only after a request to arm;
- at the end of the flight the vehicle is in failsafe or disarmed, with zero thrust and the lift fan off;
- at all times the vehicle stays within {bounds}.

Two more criteria apply to the processes and the logs. No process may end early or with a traceback. All logs must be
readable and must contain evidence of the fault (fourth column of the table).

For each fault, the study also defines whether the vehicle must continue the flight or must go to failsafe. The case
fails if the vehicle does the opposite.

## Injected faults

- **Faults of sensors, links and actuators** (such as `uplink off`) are injected in flight in the same way as by
  [`trimtab inject`](../loop/faults.md), for one second or permanently. Faults of the uplink act between the link and
  the failsafe, as on a real link. The first criterion above does not apply while the actuators have a fault, because
  faulty actuators do not obey commands.
- **Faults of the transmission.** The study controls the link between vehicle and autopilot. It cuts the link, delays,
  truncates and repeats packets, and inverts bits. A flood repeats recorded frames at ten times the usual data rate. On
  a serial line, these faults act on pieces: blocks of bytes that the study reads at once from one device and writes to
  the other device.
- **Wall clock.** A step of the wall clock changes the time of day that one process reads in flight. Such a step should
  not affect the control, because vehicle and autopilot use the monotonic clock for control.
- **Restart of the vehicle** (`vehicle-restarted`). The clock of the vehicle restarts too, and the autopilot measures
  the new offset of this clock. The vehicle stays disarmed, because an autopilot asks to arm only once, when it starts.
- **Restart of the autopilot** (`autopilot-restarted`). A new `trimtab fly` asks to arm when it starts. After a
  failsafe, the vehicle refuses this request until the vehicle is at rest and a person has given `--rearm`.
- **Full disk.** The disk that contains the log is filled to the last byte in flight. In real time, the folder of the
  log is on a separate disk of 160 megabytes, which the study creates. Only root can create this disk, so the case is
  skipped for other users.
- **Replay of the log.** After each flight, the autopilot's log is replayed with the frames that the autopilot received.
  All outputs of the replay must be equal to those of the flight, bit for bit.

In real time, the machine must be idle during the flights. A failed flight is repeated if the log shows that a process,
the link or the study itself waited longer than 100 ms for the processor. If the repeated flight fails for the same
reason, the verdict of the case is "kept waiting". Such a case counts neither as passed nor as failed.

## Flights drawn at random

    trimtab live-faults --draw 1000 --seed 1
    trimtab live-faults --real-time --draw 200 --seed 1 --jobs 3

These commands fly the live pair with faults that are drawn at random. The fault of a flight depends only on the number
of the flight and the seed. The possible faults are:

- an autopilot that is killed, frozen, deprived of the processor (starved), replaced, impersonated, or started with a
  wrong clock or wrong settings;
- a vehicle that is killed, frozen, starved or restarted;
- a process for the vehicle's outputs that is killed, frozen or starved;
- a full disk, or a disk or terminal that hangs;
- a failed sensor, uplink, downlink or actuator;
- a bad or cut link.

Half of the flights have a second, temporary disturbance. In a quarter of the flights, two processes or devices stall,
with at most one second between the two stalls.

Before each flight, the study determines how the flight must end, which messages the two logs must contain, and which
messages they may contain. If a log contains any other message, the message is reported as unexplained, and the flight
fails. If the vehicle refuses an autopilot because of its clock, scenario or key, the autopilot is started again with
the command that the error message suggests. `--only drawn-1-17` repeats one flight.

In virtual time, a simulated driver of the actuators reads the vehicle's outputs once a millisecond in every flight. The
driver must apply the safe values at the latest 100 ms after the vehicle or the process that applies its outputs has
stopped, and at the latest 250 ms after the last packet of an autopilot has arrived. The check allows 1 ms for the
period of the driver, 2 ms for a packet in transit, and the delay of an injected fault of the uplink. At the end, the
command prints the longest of these times.

## Outcomes

The third column of the table lists the changes of the vehicle's mode, with the cause in brackets and the time since
arming. The last entry of this column is the largest surge speed in the flight.

The fourth column quotes messages of the logs, and states how signals of the logs changed. `vehicle-1` and `autopilot-1`
are the vehicle and the autopilot of the case. `vehicle-2` and `autopilot-2` are a vehicle and an autopilot that were
started later. `refused-1` is an autopilot that the vehicle refused.

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
