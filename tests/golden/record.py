"""What trimtab computes, recorded: to hold one state of the source against another.

    python tests/golden/record.py before
    …                                                     the source is changed
    python tests/golden/record.py after --logs before/logs
    python tests/golden/compare.py before after

Whatever trimtab is importable is recorded, through its command line and its front door alone, so that modules may be
moved and renamed in between. Both states must be recorded on one machine: compiled code is the same bits there only.

OUT_DIR holds a folder for each group, in it one JSON file for each thing recorded: "same" must be equal, "notes" may
differ (comments, messages, names of classes), "about" says when and how it was made. OUT_DIR/GROUP/files is what the
commands wrote; OUT_DIR/logs are flights that a later state replays.
"""

import argparse
import json
import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import exports
import flights
import recordings
import refusals
import timings
import verbs
import worlds

import trimtab

GROUPS = {
    "runs": flights.runs,
    "export": exports.export,
    "campaign": worlds.campaign,
    "replay": recordings.replay,
    "json": verbs.verbs,
    "refused": refusals.refused,
    "variants": flights.variants,
    "studies": verbs.studies,
    "timings": timings.timings,
    "jax": flights.jax,
}


def main() -> int:
    """Record the groups that were asked for; exit code 1 where one of them broke off."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("out", type=Path, metavar="OUT_DIR")
    asked.add_argument("--only", action="append", choices=GROUPS, metavar="GROUP", help=f"of {', '.join(GROUPS)}")
    asked.add_argument("--match", default="", metavar="TEXT", help="only what has this in its name")
    asked.add_argument("--logs", type=Path, metavar="DIR", help="replay the logs of this folder, not the ones made now")
    given = asked.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    broken = [group for group in given.only or GROUPS if not record(group, given.out, given.match, given.logs)]
    for group in broken:
        print(f"{group} broke off")
    return 1 if broken else 0


def record(group: str, out: Path, match: str, logs: Path | None) -> bool:
    """Record one group, file by file as it is made; whether it came to its end."""
    files = (out / group / "files").absolute()
    if not match:  # what an earlier recording left there would be found again
        shutil.rmtree(files, ignore_errors=True)
    files.mkdir(parents=True, exist_ok=True)
    began = mark = time.monotonic()
    try:
        for name, entry in _entries(group, files, match, logs):
            now = time.monotonic()
            about = {"seconds": round(now - mark, 2), "load": os.getloadavg(), "version": trimtab.__version__}
            file = out / group / f"{re.sub('[^A-Za-z0-9=.-]+', '-', name)}.json"
            file.write_text(json.dumps({"name": name, **entry, "about": about}, indent=1) + "\n")
            mark = now
    except Exception as error:
        print(f"{group}: {type(error).__name__}: {error}", file=sys.stderr)
        return False
    print(f"{group:10} {time.monotonic() - began:7.1f} s", flush=True)
    return True


def _entries(group: str, files: Path, match: str, logs: Path | None) -> Iterator[tuple[str, dict[str, Any]]]:
    if group == "replay":
        return recordings.replay(files, match, logs)
    return GROUPS[group](files, match)


if __name__ == "__main__":
    sys.exit(main())
