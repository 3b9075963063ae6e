"""Measure all rows of the table of docs/benchmarks.md on this machine: half an hour at most, 3 GB for the peers.

    python benchmarks/table.py                  print it
    python benchmarks/table.py --write          put it into the page
    python benchmarks/table.py --without-peers  without peers; cannot be combined with --write
    python benchmarks/table.py --write --only elodin   only rows of the commands that contain this text

Runs one command after the other. Each prints its own rows. Stops at the first command that fails.
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
        *("compare", "instructions", "arrays", "step", "simulate", "filters"),
        *("board", "start_up", "deadlines", "campaign", "foreign", "crazyflow"),
    )
]
PEERS = [f"benchmarks/peers/run.py {peer}" for peer in ("jaxonomy", "control", "drake", "pathsim", "elodin")]
HEAD = "| quantity | median (smallest..largest) | target | command |\n|---|---|---|---|"


def rows(command: str) -> list[str]:
    """Run a command and return the rows that it prints. Its other lines are printed."""
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


def merge(old: str, new: list[str], commands: list[str], began: str, ended: str) -> str:
    """Return the page's table with the rows of some commands replaced. Rows of a new command come last."""
    names = [f"`python {command}`" for command in commands]
    about, _, *lines = old.strip().splitlines()
    kept = [line for line in lines if not any(name in line for name in names)]
    first = next((i for i, line in enumerate(lines) if any(name in line for name in names)), len(lines))
    at = sum(line in kept for line in lines[:first])
    about += f" The rows of {', '.join(names)} were measured separately {began} at the start, {ended} at the end."
    return "\n".join([about, "", *kept[:at], *new, *kept[at:]])


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--write", action="store_true", help="put the table into docs/benchmarks.md")
    p.add_argument("--without-peers", action="store_true", help="leave out the peers")
    p.add_argument("--only", metavar="TEXT", help="run only the commands that contain TEXT, and keep the other rows")
    a = p.parse_args()
    if a.write and a.without_peers:
        p.error("--write needs all rows from one machine, so it cannot be used with --without-peers")
    commands = COMMANDS if a.without_peers else [*COMMANDS, *PEERS]
    if a.only is not None:
        commands = [command for command in commands if a.only in command]
    if not commands:
        p.error(f"no command contains {a.only!r}; the commands are: {', '.join([*COMMANDS, *PEERS])}")
    began = load()
    lines = [line for command in commands for line in rows(command)]
    start, end = (text.split("   ")[0] for text in (began, load()))
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    old, _, after = rest.partition(END)
    if a.only is None:
        table = "\n".join([f"Measured on {machine('jax')}; {start} at the start, {end} at the end.", "", HEAD, *lines])
    else:
        table = merge(old, lines, commands, f"on {machine('jax')}, {start}", end)
    print(f"\n{table}")
    if a.write:
        PAGE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
