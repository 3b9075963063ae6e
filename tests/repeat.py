"""Run the tests again and again on one commit, and compare the verdict of every test.

    python tests/repeat.py                      20 runs of pytest, every second one beside two busy loops
    python tests/repeat.py --runs 4 tests/core  4 runs of some tests
    python tests/repeat.py --busy 0             20 runs with nothing beside them
    python tests/repeat.py --folder results     20 runs; after an interruption, the same command does the missing runs

Exit status 0: every test had the same verdict in all runs. 1: it had not; the tests and their verdicts are printed.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
RUNS, BUSY = 20, 2
BUSY_LOOP = "while True: pass"
VERDICTS = ("failure", "error", "skipped")
"""Elements of a case in a file of `pytest --junitxml` that tell a verdict; a case without one of them has passed."""


@contextmanager
def busy_loops(number: int) -> Iterator[None]:
    """Keep a number of processes busy."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY_LOOP]) for _ in range(number)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run_once(options: list[str], file: Path) -> dict[str, str]:
    """Run pytest once; return name of a test -> verdict."""
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={file}", *options]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if not file.exists():
        raise SystemExit(f"pytest did not get to its end:\n{done.stdout[-2000:]}")
    return read_verdicts(file)


def read_verdicts(file: Path) -> dict[str, str]:
    """Return name of a test -> verdict, from a file of `pytest --junitxml`."""
    cases = ElementTree.parse(file).getroot().iter("testcase")
    return {
        f"{case.get('classname')}::{case.get('name')}": next(
            (kind for kind in VERDICTS if case.find(kind) is not None), "passed"
        )
        for case in cases
    }


def check_commit(folder: Path) -> None:
    """Note the commit in a new folder of results. Raise SystemExit if the folder holds results of another commit."""
    command = ["git", "rev-parse", "HEAD"]
    commit = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "commit"
    if not file.exists():
        file.write_text(commit, encoding="utf-8")
    elif (other := file.read_text(encoding="utf-8")) != commit:
        raise SystemExit(f"{folder} holds results of commit {other}, not of {commit}. Give another --folder")


def list_differences(runs: list[dict[str, str]]) -> list[str]:
    """Return a line for each test whose verdicts differ between runs."""
    names = sorted({name for run in runs for name in run})
    verdicts = {name: [run.get(name, "missing") for run in runs] for name in names}
    return [f"{name}: {', '.join(each)}" for name, each in verdicts.items() if len(set(each)) > 1]


def main(words: list[str]) -> int:
    """Run, and print a line for each run and the differences; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS, help="Number of runs.  [default: %(default)s]")
    parser.add_argument(
        "--busy", type=int, default=BUSY, help="Busy loops beside every second run.  [default: %(default)s]"
    )
    parser.add_argument(
        "--folder", type=Path, help="Folder of results. Runs whose results are in the folder are not repeated."
    )
    known, options = parser.parse_known_args(words)
    if known.runs < 2:
        parser.error(f"--runs must be at least 2, got {known.runs}")
    runs = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = known.folder or Path(temporary)
        check_commit(folder)
        for k in range(known.runs):
            loops, began = known.busy * (k % 2), time.monotonic()
            file = folder / f"{k + 1}.xml"
            if file.exists():
                runs.append(read_verdicts(file))
                print(f"run {k + 1}: read from {file}", flush=True)
                continue
            with busy_loops(loops):
                runs.append(run_once(options, file))
            counts = Counter(runs[-1].values())
            said = ", ".join(f"{n} {verdict}" for verdict, n in sorted(counts.items()))
            print(f"run {k + 1}, {loops} busy loops: {said} in {time.monotonic() - began:.0f} s", flush=True)
    differences = list_differences(runs)
    print("\n".join(differences) or f"{len(runs[0])} tests had the same verdict in all {known.runs} runs")
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
