"""Two recordings of `record.py` side by side: what is equal, what differs, and where first.

    python tests/golden/compare.py before after
    python tests/golden/compare.py before after --only runs --all

Exit code 1 where anything that must be equal is not, or was recorded on one side only. Notes are counted, not judged.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

WIDE = 100
"""Characters of a value that are shown."""


class Difference(NamedTuple):
    """Where two recordings part, and what each has there."""

    path: str
    before: str
    after: str


class Compared(NamedTuple):
    """One thing recorded. equal, apart: how many numbers and words; notes: how many of those that may differ, do."""

    group: str
    name: str
    equal: int
    apart: list[Difference]
    notes: list[Difference]


def main() -> int:
    """Print the table, then the differences; exit code 1 where there are any."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("before", type=Path, metavar="BEFORE_DIR")
    asked.add_argument("after", type=Path, metavar="AFTER_DIR")
    asked.add_argument("--only", action="append", metavar="GROUP", help="only this group; repeatable")
    asked.add_argument("--all", action="store_true", help="a line for what is equal too, and every difference")
    asked.add_argument("--notes", action="store_true", help="show the first difference of each note")
    given = asked.parse_args()
    found, missing = compared(given.before, given.after, given.only)
    if not found and not missing:
        print("nothing is recorded there")
        return 1
    _print_table(found, missing)
    _print_differences(found, every=given.all)
    if given.notes:
        _print_notes(found)
    for name, side in missing:
        print(f"only in {side}: {name}")
    if not given.only or "timings" in given.only:
        _print_timings(given.before, given.after)
    return 1 if missing or any(one.apart for one in found) else 0


def compared(before: Path, after: Path, only: list[str] | None) -> tuple[list[Compared], list[tuple[str, str]]]:
    """All that is on both sides, held against each other; and what is on one side only."""
    one, other = _files(before, only), _files(after, only)
    missing = [(name, str(before)) for name in one if name not in other]
    missing += [(name, str(after)) for name in other if name not in one]
    return [_held(one[name], other[name]) for name in one if name in other], missing


def _files(folder: Path, only: list[str] | None) -> dict[str, Path]:
    found = {str(f.relative_to(folder)): f for f in sorted(folder.glob("*/*.json")) if f.parent.name != "timings"}
    return {name: file for name, file in found.items() if not only or file.parent.name in only}


def _held(one: Path, other: Path) -> Compared:
    was, now = json.loads(one.read_text()), json.loads(other.read_text())
    before, after = leaves(was.get("same")), leaves(now.get("same"))
    apart = differences(before, after)
    notes = differences(leaves(was.get("notes")), leaves(now.get("notes")))
    return Compared(one.parent.name, was["name"], len(before) - len(apart), apart, notes)


def leaves(value: Any, path: str = "") -> dict[str, str]:
    """Every number and word by its path, as JSON writes it: floats to the bit, and not-a-number equal to itself."""
    if isinstance(value, dict) and value:
        return {p: text for key, v in value.items() for p, text in leaves(v, f"{path}/{key}").items()}
    if isinstance(value, list) and value:
        return {p: text for k, v in enumerate(value) for p, text in leaves(v, f"{path}[{k}]").items()}
    return {path: json.dumps(value)}


def differences(before: dict[str, str], after: dict[str, str]) -> list[Difference]:
    """In the order of the one recorded before; what is new comes last."""
    found = [Difference(p, v, after.get(p, "nothing")) for p, v in before.items() if after.get(p) != v]
    return found + [Difference(p, "nothing", v) for p, v in after.items() if p not in before]


def _print_table(found: list[Compared], missing: list[tuple[str, str]]) -> None:
    groups = list(dict.fromkeys([*(one.group for one in found), *(name.partition("/")[0] for name, _ in missing)]))
    rows = [("group", "recorded", "equal", "differ", "one side", "values", "notes that differ")]
    for group in groups:
        of = [one for one in found if one.group == group]
        bad = sum(bool(one.apart) for one in of)
        alone = sum(name.partition("/")[0] == group for name, _ in missing)
        values, notes = sum(one.equal + len(one.apart) for one in of), sum(bool(one.notes) for one in of)
        rows.append((group, *(str(n) for n in (len(of) + alone, len(of) - bad, bad, alone, values, notes))))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        print(row[0].ljust(widths[0]), *(text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True)))
    print()


def _print_differences(found: list[Compared], *, every: bool) -> None:
    for one in found:
        if one.apart:
            print(f"DIFFERS  {one.group}: {one.name}: {len(one.apart)} of {one.equal + len(one.apart)} values; first")
            for which in one.apart if every else one.apart[:1]:
                _print_one(which)
        elif every:
            print(f"equal    {one.group}: {one.name}: {one.equal} values")


def _print_notes(found: list[Compared]) -> None:
    for one in [one for one in found if one.notes]:
        print(f"note     {one.group}: {one.name}: {len(one.notes)} differ; first")
        _print_one(one.notes[0])


def _print_one(which: Difference) -> None:
    print(f"    {which.path}")
    for side, text in (("before", which.before), ("after", which.after)):
        print(f"      {side:6} {text[:WIDE]}{' …' if len(text) > WIDE else ''}")


def _print_timings(before: Path, after: Path) -> None:
    """Both sides' times; they depend on the machine's load, which stands beside them."""
    rows = list(_timing_rows(before, after))
    if rows:
        print("\nwall clock and processor time, least and median (s), and the machine's load at its end")
        for row in rows:
            print(row)


def _timing_rows(before: Path, after: Path) -> Iterator[str]:
    for file in sorted(before.glob("timings/*.json")):
        for side, folder in (("before", before), ("after", after)):
            held = folder / "timings" / file.name
            if held.exists():
                found = json.loads(held.read_text())
                of = found["timings"]
                numbers = "  ".join(f"{of[k][m]:7.3f}" for k in ("wall_s", "busy_s") for m in ("min", "median"))
                yield f"  {found['name']:14} {side:6} {numbers}  load {of['load'][0]:.2f}"


if __name__ == "__main__":
    sys.exit(main())
