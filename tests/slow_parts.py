"""Slow tests in sixteen parts: which tests are in which, whose turn it is, and when each last ran.

    python tests/slow_parts.py choose                     part and slice whose turn it is
    python tests/slow_parts.py record PART COMMIT RESULT  that a part ran: into slow_parts.json and docs/slow-tests.md
    python tests/slow_parts.py deal RESULTS.xml           all parts anew, from times of tests (pytest --junitxml)

A part is a fixed set of files, or, of a file with very many slow tests, those whose names have a certain remainder: so
it doesn't matter what else is collected. Tests of ever more random inputs are marked slow(of=50) and cut in as many
slices: each commit runs the one that its hash says.

The part whose last run is the oldest is due. One that ran is recorded with the change that comes next; until then each
commit moves on by one, so that sixteen commits in a row run all parts whether anybody records them or not. A part that
the hash alone chose would be left out for long: of sixteen random parts ten are different, on average.
"""

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zlib import crc32

ROOT = Path(__file__).parents[1]
TABLE, PAGE = Path(__file__).with_suffix(".json"), ROOT / "docs" / "slow-tests.md"
PARTS, SLICES = 16, 50
WIDE = 90.0
"""A file that takes longer (s) is dealt test by test."""


def read_table(path: Path = TABLE) -> dict[str, Any]:
    """files: path -> [part, seconds], part 0 where tests are dealt by name.  ran: part -> [date, commit, result]."""
    return json.loads(path.read_text(encoding="utf-8"))


def part_of(test: str, files: dict[str, Any]) -> int:
    """The part, from 1 to PARTS, of a test by its pytest name; of a file that is not in the table by its name."""
    file = test.partition("::")[0]
    part = files.get(file, [0, 0.0])[0]
    return part or crc32(test.encode()) % PARTS + 1


def due_part(ran: dict[str, list[str]], commits_since: int) -> int:
    """Whose turn it is: the oldest run first, and one further with each commit since the last record."""
    order = sorted(range(1, PARTS + 1), key=lambda k: (ran.get(str(k), [""])[0], k))
    return order[commits_since % PARTS]


def ask_git(*arguments: str) -> str:
    """What git says of this working tree, or nothing where there is none."""
    command = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def choose() -> tuple[int, int]:
    """Part and slice of the commit that is checked out."""
    head = ask_git("rev-parse", "HEAD") or "0"
    recorded = ask_git("log", "-1", "--format=%H", "--", str(TABLE))
    since = int(ask_git("rev-list", "--count", "--first-parent", f"{recorded}..HEAD") or 0) if recorded else 0
    return due_part(read_table()["ran"], since), int(head[:12], 16) % SLICES


def deal(seconds: dict[str, float]) -> dict[str, list[Any]]:
    """Part and seconds of each file: the longest first, each to the part that has least."""
    loads = [sum(s for s in seconds.values() if s > WIDE) / PARTS] * PARTS
    files: dict[str, list[Any]] = {}
    for file, s in sorted(seconds.items(), key=lambda item: (-item[1], item[0])):
        part = 0 if s > WIDE else loads.index(min(loads)) + 1
        files[file] = [part, round(s, 1)]
        if part:
            loads[part - 1] += s
    return dict(sorted(files.items()))


def read_seconds(results: Path) -> dict[str, float]:
    """Seconds of each file in pytest's JUnit file."""
    seconds: dict[str, float] = defaultdict(float)
    for case in ElementTree.parse(results).iter("testcase"):
        seconds[str(case.get("classname")).replace(".", "/") + ".py"] += float(case.get("time", 0))
    return seconds


def page_rows(table: dict[str, Any]) -> list[str]:
    """The rows of the page: what is in each part, how long it takes, when it last ran."""
    wide = sum(s for part, s in table["files"].values() if not part) / PARTS
    rows = ["| part | minutes on one core | last ran | commit | result | files |", "|---|---|---|---|---|---|"]
    for k in range(1, PARTS + 1):
        own = {file: s for file, (part, s) in table["files"].items() if part == k}
        date, commit, result = table["ran"].get(str(k), ["not recorded", "", ""])
        names = " ".join(f"`{file.removeprefix('tests/')}`" for file in own)
        minutes = f"{(wide + sum(own.values())) / 60:.0f}"
        rows.append(f"| {k} | {minutes} | {date} | {commit} | {result} | {names} |")
    names = " ".join(f"`{file.removeprefix('tests/')}`" for file, (part, _) in table["files"].items() if not part)
    return [*rows, f"| each | | | | | a sixteenth of each of {names} |"]


def write_table(table: dict[str, Any]) -> None:
    """The table, and its rows on the page."""
    rows = {name: [f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in part.items()] for name, part in table.items()}
    parts = [f" {json.dumps(name)}: {{\n" + ",\n".join(lines) + "\n }" for name, lines in rows.items()]
    TABLE.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition("<!-- parts -->\n")
    after = rest.partition("<!-- end of parts -->")[2]
    listing = "\n".join(page_rows(table))
    PAGE.write_text(f"{before}<!-- parts -->\n{listing}\n<!-- end of parts -->{after}", encoding="utf-8")


def main(arguments: list[str]) -> int:
    """The command."""
    match arguments:
        case ["choose"]:
            print(*choose())
        case ["record", part, commit, *result]:
            table = read_table()
            date = ask_git("log", "-1", "--format=%cd", "--date=format:%Y-%m-%d %H:%M", commit)
            table["ran"][str(int(part))] = [date or "?", commit[:10], " ".join(result)]
            write_table(table)
        case ["deal", results]:
            table = read_table()
            table["files"] |= deal(table_seconds(table) | read_seconds(Path(results)))
            write_table(table)
        case _:
            print(__doc__)
            return 2
    return 0


def table_seconds(table: dict[str, Any]) -> dict[str, float]:
    """What is known of each file that is still there."""
    return {file: s for file, (_, s) in table["files"].items() if (ROOT / file).is_file()}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
