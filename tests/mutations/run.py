"""Do the tests notice? Each mutation of the lists beside this file is put into a copy, and the tests named are run.

    python tests/mutations/run.py                  all, on one core: over an hour
    python tests/mutations/run.py -k imu -k kalman those whose name or file has one of the words
    python tests/mutations/run.py --tier gate      only the tests of the gate
    python tests/mutations/run.py --tier all       the thorough tests of the named files too

A mutation is killed when a test fails or is in error; one that no test notices survived. Without --tier the tests of
the gate and the real-time tests count. The copy has the tracked files. Compiled programs are kept in a folder of the
copy, or in --cache FOLDER for the next time.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


TIERS = {"gate": "not thorough and not real_time", "timed": "not thorough or real_time", "all": ""}
"""Tier -> pytest's expression of marks for the tests that count."""


class Mutation(NamedTuple):
    """A change that somebody could have made by mistake, and the tests that must not let it pass."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def read_mutations() -> list[Mutation]:
    """Those of all lists, in the order of their files' names."""
    lists = [tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(HERE.glob("*.toml"))]
    return [Mutation(**m | {"tests": tuple(m["tests"])}) for some in lists for m in some["mutation"]]


def copy_tracked_files(to: Path) -> None:
    """What git knows of the working tree, as it stands."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True).stdout
    pack = ["tar", "--null", "--files-from=-", "--ignore-failed-read", "-cf", "-"]
    packed = subprocess.run(pack, cwd=ROOT, input=names, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-xf", "-"], cwd=to, input=packed, check=True)


def run_tests(copy: Path, tests: list[str], tier: str, environment: dict[str, str]) -> tuple[int, str]:
    """pytest's status, and the first line that says what failed."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "-p", "no:cacheprovider", "-m", TIERS[tier], *tests]
    run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    told = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return run.returncode, told[0] if told else (run.stdout.splitlines() or [run.stderr[-200:]])[-1]


def write_newer(path: Path, text: str) -> None:
    """Python keeps what it compiled by a file's time in seconds and its length: no two texts may share both."""
    last = path.stat().st_mtime
    path.write_text(text, encoding="utf-8")
    os.utime(path, (last + 2, last + 2))


def try_mutation(copy: Path, mutation: Mutation, tier: str, environment: dict[str, str]) -> dict[str, object]:
    """The outcome of one, and the copy as it was."""
    path, begin = copy / mutation.file, time.perf_counter()
    text = path.read_text(encoding="utf-8")
    if text.count(mutation.old) != 1:
        raise SystemExit(f"{mutation.name}: the old text occurs {text.count(mutation.old)} times in {mutation.file}")
    write_newer(path, text.replace(mutation.old, mutation.new))
    try:
        status, line = run_tests(copy, list(mutation.tests), tier, environment)
    finally:
        write_newer(path, text)
    outcome = {0: "SURVIVED", 1: "killed", 2: "killed"}.get(status, f"NOT TESTED ({status})")
    seconds = round(time.perf_counter() - begin)
    return {"name": mutation.name, "file": mutation.file, "outcome": outcome, "seconds": seconds, "by": line}


def main() -> int:
    """The command; 1 if any survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-k", action="append", default=[], metavar="WORD", help="only those with it; may be repeated")
    parser.add_argument("--tier", choices=TIERS, default="timed", help="which tests count")
    parser.add_argument("--cache", type=Path, help="where compiled programs are kept between calls")
    parser.add_argument("--record", type=Path, help="append each outcome to a file, a JSON object a line")
    parser.add_argument("--unmutated", action="store_true", help="only check that the named tests pass as things stand")
    given = parser.parse_args()
    chosen = [m for m in read_mutations() if not given.k or any(w in f"{m.name} {m.file}" for w in given.k)]
    with tempfile.TemporaryDirectory() as scratch:
        copy, cache = Path(scratch) / "trimtab", (given.cache or Path(scratch) / "cache").resolve()
        copy.mkdir()
        (cache / "jax").mkdir(mode=0o700, parents=True, exist_ok=True)
        copy_tracked_files(copy)
        paths = os.pathsep.join([str(copy / "src"), str(copy), str(copy / "tests")])
        environment = os.environ | {"PYTHONPATH": paths, "TRIMTAB_CACHE": str(cache), "CI": "1"}
        environment["JAX_COMPILATION_CACHE_DIR"] = str(cache / "jax")
        if given.unmutated:
            status, line = run_tests(copy, sorted({t for m in chosen for t in m.tests}), given.tier, environment)
            print(line)
            return status
        outcomes = []
        for k, mutation in enumerate(chosen):
            outcomes.append(one := try_mutation(copy, mutation, given.tier, environment))
            line = f"{k + 1:3}/{len(chosen)} {one['outcome']:9} {one['seconds']:4} s  {one['name']}"
            print(line, f"        {one['by']}", sep="\n", flush=True)
            if given.record:
                with given.record.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(one) + "\n")
    rest = [f"  {one['outcome']}: {one['name']}" for one in outcomes if one["outcome"] != "killed"]
    print(f"\n{len(outcomes) - len(rest)} of {len(outcomes)} killed", *rest, sep="\n")
    return int(bool(rest))


if __name__ == "__main__":
    sys.exit(main())
