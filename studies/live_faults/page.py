"""Docs page of the campaign, written from its outcomes."""

import re
from collections.abc import Sequence

from studies.live_faults.case import CaseOutcome
from studies.live_faults.verdict import BOUNDS, LIFT_S, SERVO_S, SILENCE_S
from trimtab import __version__

HEADINGS = ("case", "what was done", "what the vehicle did", "what the logs say", "verdict")
WORDS = """# Faults over the live pair

A vehicle and an autopilot as two processes (`trimtab vehicle hovercraft/forward`, `trimtab fly`), signed, over
datagrams or a pair of serial devices, joined by a link that the study disturbs. Each case is a separate flight:
a second after arming, something goes wrong. This page is made by

    trimtab live-faults --real-time --page docs/studies/live-faults.md

and shows the campaign as it ran: {cases} cases, {held} hold, {skipped} skipped, {failed} fail.
With `--only CASE` the command flies that case and updates its row in an existing page; `--out DIR` keeps its logs.

Flown: {runs}.

## In virtual time

    trimtab live-faults                                every case, in a few minutes
    trimtab live-faults --draw 1000 --seed 1           flights drawn at random
    trimtab live-faults --only drawn-1-17              one of them again, bit for bit the same

Without `--real-time` the same cases are flown in one process on one virtual clock ([Testing](../testing.md)): the same
commands, with the clock, disk, network and processes of `trimtab.live.virtual_machine`. The flight takes no longer than
its computation, no other program can disturb it, and the seed decides every packet. The printed verdicts are the same.
`--json` gives the hash of all packets, log rows and events as `digest`. One flight in twenty is flown twice, in two
processes, and the two hashes must be equal. Cases with serial devices and cases without a flight need `--real-time`.

## What holds means

The vehicle's own log is judged, row by row, every millisecond, by code that shares nothing with the firmware:

- no force without a command: {servo:g} ms (a servo frame) after the vehicle has gone to failsafe or is disarmed, the
  fan gives nothing;
- never more than {silence:g} ms without an accepted command, else failsafe;
- {lift:g} s after failsafe the lift fan stops; it stops at once when the vehicle is disarmed;
- failsafe ends only after a request to arm;
- at the end it stands in failsafe or disarmed, without force and lift;
- flying or not, it stays within {bounds}.

In addition, no process may end early or with a traceback, all logs must be readable, and they must say what happened
(fourth column). A case that a flight must survive fails if the vehicle goes to failsafe. A case that must stop it fails
if it does not.

## How it was done

- Fault words are injected live, for a second, or for good, as [`trimtab inject`](../loop/faults.md) does. Those of the
  uplink act between the line and the failsafe, as a real line's do. While its actuators themselves are at fault the
  vehicle obeys nobody, so the first rule rests until they work again.
- The link is a relay in a process of the campaign. It cuts, delays, shortens, flips bits, sends again.
- Wall clock stepped: a library in front of the C library's shifts what the process reads as the time of day, in
  mid-flight. Nothing else on the machine sees it. Both ends use the monotonic clock to fly.
- The *vehicle's* clock restarts in `vehicle-restarted`: the autopilot finds another offset, and the vehicle stays
  disarmed, for an autopilot asks to arm once, at its start.
- `autopilot-restarted`: `trimtab fly` asks to arm by itself when it starts; after a failsafe that is refused until the
  vehicle is at rest and a person has said `--rearm`. An autopilot that flies on never asks again by itself.
- Disk full: a disk of 160 megabytes below the folder of the log, filled to the last byte in mid-flight (root only,
  else skipped).
- Flood: recorded frames, repeated until they make up ten times the bytes that the link usually carries.
- The flights need an idle machine. If a flight fails and a log shows that a process was kept waiting for longer than
  100 ms, or the link or the campaign itself was, it is flown again. If it fails so twice, it is counted separately, as
  "kept waiting": neither failed nor passed. Processes that were stopped on purpose have that time in addition.
- Each autopilot's log is replayed over its frames. All bits must be equal.

## Flights drawn at random

    trimtab live-faults --draw 200 --seed 1                     in virtual time
    trimtab live-faults --real-time --draw 200 --seed 1 --jobs 3

draws, by number and seed alone, an autopilot killed, frozen, replaced, impersonated, mis-clocked or mis-configured, a
vehicle killed, frozen or restarted, a word on sensor, uplink, downlink or actuators, or a bad line; in half of the
flights a passing disturbance is added, at random times. The required ending, and the required and allowed lines of both
logs, follow from the draw, before the flight. A line without a reason in the draw is unexplained. An autopilot that is
refused (clock, scenario, key) flies afterwards with the command that its message suggests.
`--only drawn-1-17` flies one of them again.

## What was found at version 0.1

    trimtab live-faults --real-time --findings

tries each again, flights and other cases (logs that name code, exported C at the least time, the key in firmware,
a mute client, a ground station), and prints what was seen now beside what it was: "mended", "as before", or "kept
waiting".

## Outcomes

{table}
"""


def format_page(outcomes: Sequence[CaseOutcome], run: str, before: str = "", order: Sequence[str] = ()) -> str:
    """Return the page in Markdown.

    Args:
        outcomes: outcomes of the flown cases.
        run: description of the flights from `describe_flights`.
        before: the page so far, whose other rows and runs are kept. Empty: a new page.
        order: names of all cases, in the order of the rows.
    """
    rows = _read_rows(before) | {one.name: _format_row(one) for one in outcomes}
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


def describe_flights(names: Sequence[str], wall: float, cores: int, *, apart: bool) -> str:
    """Return how cases were flown, in words. apart: not all of them together."""
    which = ", ".join(f"`{n}`" for n in names) if apart else f"{len(names)} cases"
    return f"{which} in {wall:.0f} s on {cores} cores (trimtab {__version__})"


def _read_rows(before: str) -> dict[str, str]:
    """Return case -> its row of a page."""
    return {found[1]: found[0] for found in re.finditer(r"^\| `([^`]+)` \|.*\|$", before, re.MULTILINE)}


def _read_runs(before: str) -> list[str]:
    """Return how the rows of a page were flown."""
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
