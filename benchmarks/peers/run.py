"""Time a peer beside trimtab's compiled single run and a numpy loop, on the closed loop of benchmarks/README.md.

    python benchmarks/peers/run.py drake              also: control, pathsim, jaxonomy
    python benchmarks/peers/run.py drake --remove     and delete the environment (0.4 to 1.4 GB) afterwards

The peer is installed with pip, at the version named below, into a virtual environment of its own in benchmarks/.peers.
It runs there in a process that is asked for one run at a time; so does the numpy loop, on the same numpy. The pipe adds
about 0.1 ms to runs of 50 ms and more. Each peer_*.py says what it simplifies.

Exits with 1 when a result is wrong, 2 when the peer could not be installed.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "reference")]
import compiled
import references
import spec
from paired import Program, load, machine, ratio, rounds, row, several, show

ENVIRONMENTS = HERE.parent / ".peers"
TRIMTAB, NUMPY = "trimtab C", "numpy loop"


class Peer(NamedTuple):
    """What pip is asked for, the peer first, and how far its results may be from hand C's.

    Where the peer's events can't happen in the loop's order, or at its instants, the runs differ a little from the
    start; its file says how. The others compute the same numbers.
    """

    requirements: tuple[str, ...]
    tolerance: float = 1e-9


PEERS = {
    "drake": Peer(("drake==1.51.1",), tolerance=0.02),
    "control": Peer(("control==0.10.2",)),
    "pathsim": Peer(("pathsim==0.27.1",)),
    "jaxonomy": Peer(("jaxonomy==3.4.1", "jax==0.9.2"), tolerance=0.02),
}


def environment(name: str) -> Path:
    """The Python of the peer's environment, which is made if need be; ends the program where it can't be."""
    folder, wanted = ENVIRONMENTS / name, PEERS[name].requirements
    python, done = folder / "bin" / "python", folder / "installed"
    if done.exists() and done.read_text() == " ".join(wanted):
        return python
    shutil.rmtree(folder, ignore_errors=True)
    print(f"installing {', '.join(wanted)} …", flush=True)
    steps = [[sys.executable, "-m", "venv", str(folder)], [str(python), "-m", "pip", "install", "-q", *wanted]]
    for step in steps:
        made = subprocess.run(step, capture_output=True, text=True, env=clean())
        if made.returncode:
            shutil.rmtree(folder, ignore_errors=True)
            said = "\n".join((made.stdout + made.stderr).strip().splitlines()[-8:])
            print(f"{wanted[0]} could not be installed here: {' '.join(step)} said\n{said}", file=sys.stderr)
            sys.exit(2)
    done.write_text(" ".join(wanted))
    return python


def clean() -> dict[str, str]:
    """This environment's variables without those that would bring this Python's packages along."""
    return {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}


class Worker:
    """A process in the peer's environment that runs what it is asked for."""

    def __init__(self, python: Path, name: str) -> None:
        command = [str(python), str(HERE / "worker.py"), f"peer_{name}"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=clean())

    def __enter__(self) -> Self:
        self.about = self._line()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()

    def ask(self, program: str, gains: Any, key: Any) -> Any:
        """The 14 numbers of one run of "peer" or "numpy"."""
        assert self.process.stdin
        self.process.stdin.write(json.dumps([program, gains.tolist(), key.tolist()]) + "\n")
        self.process.stdin.flush()
        return np.array(self._line())

    def _line(self) -> Any:
        assert self.process.stdout
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"the peer's process ended with status {self.process.wait()}; its message is above")
        return json.loads(line)


def beside(worker: Worker, title: str, count: int) -> Any:
    """Rounds of the peer, the numpy loop, and fifty runs each of trimtab and hand C."""
    gains, key = np.array(spec.GAINS), np.array([spec.KEY0, 0], np.uint32)
    inputs = [(gains + 0.01 * i, key + np.array([0, i], np.uint32)) for i in range(count + 1)]
    with tempfile.TemporaryDirectory() as folder:
        libraries = references.hand(folder, "native")
        programs = {
            references.HAND_C: several(references.single(libraries[references.HAND_C]), 50),
            TRIMTAB: several(compiled.single, 50),
            NUMPY: Program(lambda gains, key: worker.ask("numpy", gains, key)),
            title: Program(lambda gains, key: worker.ask("peer", gains, key)),
        }
        return rounds(programs, inputs, references.HAND_C)


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("peer", choices=PEERS)
    p.add_argument("--rounds", type=int, default=7, help="rounds that count (%(default)s)")
    p.add_argument("--remove", action="store_true", help="delete the peer's environment afterwards")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    if a.rounds < 1:
        p.error("--rounds must be at least 1")
    peer = PEERS[a.peer]
    title = peer.requirements[0].replace("==", " ")
    with Worker(environment(a.peer), a.peer) as worker:
        print(f"{machine('jax')}\nthe peer's: {worker.about}\n{load()}")
        timed = beside(worker, title, a.rounds)
    show(f"One run: 15 s, 15000 steps, {a.rounds} rounds", timed, TRIMTAB, spec.N)
    for under in (TRIMTAB, NUMPY, references.HAND_C):
        what, x = f"one run: {title} / {under}", ratio(timed, title, under)
        print(row(what, x, "", f"python benchmarks/peers/run.py {a.peer}") if a.markdown else f"{what}: {x}")
    print(load())
    if a.remove:
        shutil.rmtree(ENVIRONMENTS / a.peer)
    allowed = dict.fromkeys(timed.worst, 1e-9) | {title: peer.tolerance}
    bad = [f"{n} by {d:.0e}, allowed are {allowed[n]:g}" for n, d in timed.worst.items() if not d <= allowed[n]]
    fine = f"results agree: {title} to {timed.worst[title]:.0e}, allowed are {peer.tolerance:g}; the others to 1e-09"
    print(f"WRONG: {'; '.join(bad)}" if bad else fine)
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
