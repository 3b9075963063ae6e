"""Make the table of docs/benchmarks.md anew, all of it on this machine: half an hour at most, 3 GB for the peers.

    python benchmarks/table.py                  print it
    python benchmarks/table.py --write          put it into the page
    python benchmarks/table.py --without-peers  nothing is installed; can't be written

Runs the commands one after the other, which print their own rows, and stops at the first that fails.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from paired import load, machine

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
BEGIN, END = "<!-- made by benchmarks/table.py -->", "<!-- end -->"
COMMANDS = [
    f"benchmarks/{name}.py"
    for name in (
        "compare",
        "instructions",
        "arrays",
        "step",
        "filters",
        "board",
        "start_up",
        "deadlines",
        "campaign",
        "foreign",
    )
]
PEERS = [f"benchmarks/peers/run.py {peer}" for peer in ("jaxonomy", "control", "drake", "pathsim")]
HEAD = "| figure | median (least..largest) | target | command |\n|---|---|---|---|"


def rows(command: str) -> list[str]:
    """The rows that a command prints; its other lines are shown."""
    full = [sys.executable, *command.split(), "--markdown"]
    print(f"\n$ {' '.join(['python', *full[1:]])}", flush=True)
    found = []
    with subprocess.Popen(full, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        for line in process.stdout:
            print(line, end="", flush=True)
            if line.startswith("| "):
                found.append(line.strip())
    if process.returncode or not found:
        sys.exit(f"{command} ended with status {process.returncode}: no table")
    return found


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--write", action="store_true", help="put the table into docs/benchmarks.md")
    p.add_argument("--without-peers", action="store_true", help="leave the peers out")
    a = p.parse_args()
    if a.write and a.without_peers:
        p.error("the page's table is of one machine, whole: --write needs the peers")
    commands = COMMANDS if a.without_peers else [*COMMANDS, *PEERS]
    began = load()
    lines = [line for command in commands for line in rows(command)]
    start, end = (text.split("   ")[0] for text in (began, load()))
    about = f"Measured on {machine('jax')}; {start} at the start, {end} at the end."
    table = "\n".join([about, "", HEAD, *lines])
    print(f"\n{table}")
    if a.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        after = rest.partition(END)[2]
        PAGE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
