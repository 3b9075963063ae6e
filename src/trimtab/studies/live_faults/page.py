"""The docs page of the campaign, written from its outcomes."""

from collections.abc import Sequence

from trimtab import __version__
from trimtab.studies.live_faults.case import Outcome
from trimtab.studies.live_faults.verdict import BOUNDS, LIFT_S, SERVO_S, SILENCE_S

HEADINGS = ("case", "what was done", "what the vehicle did", "what the logs say", "verdict")
WORDS = """# Faults over the live pair

A vehicle and an autopilot as two processes (`trimtab vehicle hovercraft/forward`, `trimtab fly`), signed, over
datagrams or a pair of serial devices, and between them a line that is ours to spoil. Each case is a flight of its own:
a second after arming something goes wrong. This page is made by

    trimtab live-faults --page docs/studies/live-faults.md

and shows that campaign as it ran: {cases} cases, {held} hold, {skipped} skipped, {failed} fail; {wall:.0f} s on
{cores} cores (trimtab {version}). `--only CASE` repeats one, `--out DIR` keeps its logs.

## What holds means

The vehicle's own log is judged, row by row, every millisecond, by code that shares nothing with the firmware:

- no force without a command: {servo:g} ms (a servo frame) after the vehicle has gone to failsafe or is disarmed, the
  fan gives nothing;
- never more than {silence:g} ms without a command that was taken, else failsafe;
- {lift:g} s after failsafe the lift fan stops; it stops at once when the vehicle is disarmed;
- failsafe is left only where somebody asks to arm;
- at the end it stands in failsafe or disarmed, without force and lift;
- flying or not, it stays within {bounds}.

Besides: no process ends by itself or with a traceback, all logs can be read, and they say what happened (fourth
column). A case that a flight must survive fails where the vehicle goes to failsafe all the same; one that must stop it
fails where it doesn't.

## How it was done

- Fault words are injected live, for a second, as [`trimtab inject`](../loop/faults.md) does. Those of the uplink act
  between the line and the failsafe, as a real line's do. While its actuators themselves are at fault the vehicle obeys
  nobody, so the first rule rests until they work again.
- The line is a relay in a process of the campaign; it cuts, delays, shortens, turns bits, sends again.
- Wall clock stepped: a library in front of the C library's shifts what the process reads as the time of day, in
  mid-flight. Nothing else on the machine sees it. All that flies counts by the monotonic clock.
- The *vehicle's* clock begins anew in `vehicle-restarted`: the autopilot finds another offset, and the vehicle stays
  disarmed, for an autopilot asks to arm once, at its start.
- `autopilot-restarted`: `trimtab fly` arms by itself when it starts. That start is a person's explicit request, so it
  clears a latched failsafe. An autopilot that flies on never arms again by itself.
- Disk full: a disk of eight megabytes below the folder of the log, filled to the last byte in mid-flight (root only,
  else skipped).
- Flood: recorded frames, again and again, until they make up ten times the bytes that the line usually carries.

## Outcomes

{table}
"""


def page(outcomes: Sequence[Outcome], wall: float, cores: int) -> str:
    """The page, in Markdown."""
    count = {v: sum(o.verdict == v for o in outcomes) for v in ("holds", "skipped", "fails")}
    units = {"yaw rate": "rad/s"}
    names = {p.removeprefix("truth.").replace("_", " "): limit for p, limit in BOUNDS.items()}
    return WORDS.format(
        cases=len(outcomes),
        held=count["holds"],
        skipped=count["skipped"],
        failed=count["fails"],
        wall=wall,
        cores=cores,
        version=__version__,
        servo=SERVO_S * 1e3,
        silence=SILENCE_S * 1e3,
        lift=LIFT_S,
        bounds=", ".join(f"{n} {limit:g} {units.get(n, 'm/s')}" for n, limit in names.items()),
        table=table(outcomes),
    )


def table(outcomes: Sequence[Outcome]) -> str:
    """One line an outcome."""
    lines = [_line(HEADINGS), _line("---" for _ in HEADINGS)]
    for one in outcomes:
        said = "<br>".join(one.said)
        verdict = {"holds": "holds", "skipped": f"skipped: {one.skipped}"}.get(
            one.verdict, f"**fails**: {'; '.join(one.problems)}"
        )
        lines.append(_line((f"`{one.name}`", one.does, one.happened, said, verdict)))
    return "\n".join(lines)


def _line(cells: object) -> str:
    texts = (" ".join(str(c).replace("|", "\\|").split()) for c in cells)  # type: ignore[attr-defined]
    return f"| {' | '.join(texts)} |"
