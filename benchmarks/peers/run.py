"""Time a peer toolkit, trimtab's compiled single run and a numpy loop on the closed loop of benchmarks/README.md.

    python benchmarks/peers/run.py drake              also: control, pathsim, jaxonomy, elodin
    python benchmarks/peers/run.py drake --remove     also deletes the environment (0.4 to 1.4 GB) afterwards

pip installs the peer, at the version given below, into its own virtual environment in benchmarks/.peers. A process in
this environment computes one run per request, of the peer or of the numpy loop. The pipe adds about 0.1 ms to runs of
at least 50 ms. Each peer_*.py states its simplifications. Elodin needs Python 3.13, which is searched on PATH and among
the versions of pyenv. It builds a world for each run, before the time is measured, and also simulates campaigns.

Exits with 1 if a result is wrong, with 2 if the peer could not be installed.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "reference")]
import compiled
import references
import spec
from figures import CAMPAIGN
from paired import Program, Timed, load, machine, ratio, rounds, row, several, show

ENVIRONMENTS = HERE.parent / ".peers"
TRIMTAB, NUMPY = "trimtab C", "numpy loop"


class Peer(NamedTuple):
    """Peer: pip's requirements (the peer first), and the accepted difference of its results from hand-written C's.

    If the peer's events cannot have the order or the instants of the loop, its runs differ a little from the start, as
    its file describes. The other peers compute the same numbers.

    python: oldest version of Python.  prepares: True if each run is built separately.  campaign: number of runs, or 0.
    """

    requirements: tuple[str, ...]
    tolerance: float = 1e-9
    python: tuple[int, int] = (3, 11)
    prepares: bool = False
    campaign: int = 0

    @property
    def title(self) -> str:
        return self.requirements[0].replace("==", " ")


PEERS = {
    "drake": Peer(("drake==1.51.1",), tolerance=0.02),
    "control": Peer(("control==0.10.2",)),
    "pathsim": Peer(("pathsim==0.27.1",)),
    "jaxonomy": Peer(("jaxonomy==3.4.1", "jax==0.9.2"), tolerance=0.02),
    "elodin": Peer(("elodin==0.18.0", "jax==0.10.0"), python=(3, 13), prepares=True, campaign=8),
}


def environment(name: str) -> Path:
    """Return the Python of the peer's environment, which is created if missing. Exit if that is impossible."""
    folder, wanted = ENVIRONMENTS / name, PEERS[name].requirements
    python, done = folder / "bin" / "python", folder / "installed"
    if done.exists() and done.read_text() == " ".join(wanted):
        return python
    shutil.rmtree(folder, ignore_errors=True)
    print(f"installing {', '.join(wanted)} …", flush=True)
    steps = [
        [interpreter(PEERS[name]), "-m", "venv", str(folder)],
        [str(python), "-m", "pip", "install", "-q", *wanted],
    ]
    for step in steps:
        made = subprocess.run(step, capture_output=True, text=True, env=clean())
        if made.returncode:
            shutil.rmtree(folder, ignore_errors=True)
            said = "\n".join((made.stdout + made.stderr).strip().splitlines()[-8:])
            print(f"{wanted[0]} could not be installed here: {' '.join(step)} said\n{said}", file=sys.stderr)
            sys.exit(2)
    done.write_text(" ".join(wanted))
    return python


def interpreter(peer: Peer) -> str:
    """Return a Python that is new enough for the peer, preferably this one. Exit if none is found."""
    if sys.version_info[:2] >= peer.python:
        return sys.executable
    version = ".".join(map(str, peer.python))
    kept = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
    for candidate in [shutil.which(f"python{version}"), *kept]:
        check = f"import sys, venv; sys.exit(sys.version_info[:2] != {peer.python})"
        if candidate and subprocess.run([candidate, "-c", check], capture_output=True, env=clean()).returncode == 0:
            return str(candidate)
    print(f"{peer.requirements[0]} needs Python {version}, which was not found on PATH or in pyenv", file=sys.stderr)
    sys.exit(2)


def clean() -> dict[str, str]:
    """Return the environment variables without those that would add this Python's packages."""
    return {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}


class Worker:
    """Process in the peer's environment that computes runs on request."""

    def __init__(self, python: Path, name: str) -> None:
        command = [str(python), str(HERE / "worker.py"), f"peer_{name}"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=clean())

    def __enter__(self) -> Self:
        self.about = self._line()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()

    def ask(self, program: str, gains: Any, key: Any, *runs: int) -> Any:
        """Return the 14 numbers of one run of "peer" or "numpy", or of each run of "campaign"."""
        assert self.process.stdin
        self.process.stdin.write(json.dumps([program, gains.tolist(), key.tolist(), *runs]) + "\n")
        self.process.stdin.flush()
        return np.array(self._line())

    def _line(self) -> Any:
        assert self.process.stdout
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"the peer's process ended with status {self.process.wait()}; its message is above")
        return json.loads(line)


def beside(worker: Worker, peer: Peer, count: int) -> Timed:
    """Time rounds of the peer, the numpy loop, and fifty runs each of trimtab and hand-written C."""
    gains, key = np.array(spec.GAINS), np.array([spec.KEY0, 0], np.uint32)
    inputs = [(gains + 0.01 * i, key + np.array([0, i], np.uint32)) for i in range(count + 1)]
    began = time.perf_counter()
    for given in inputs if peer.prepares else []:
        worker.ask("prepare", *given)
    if peer.prepares:
        print(f"before each run its world is built: {(time.perf_counter() - began) / len(inputs):.2f} s, not counted")
    with tempfile.TemporaryDirectory() as folder:
        libraries = references.hand(folder, "native")
        programs = {
            references.HAND_C: several(references.single(libraries[references.HAND_C]), 50, references.truth),
            TRIMTAB: several(compiled.single, 50),
            NUMPY: Program(lambda gains, key: worker.ask("numpy", gains, key), result=references.truth),
            peer.title: Program(lambda gains, key: worker.ask("peer", gains, key), result=references.truth),
        }
        return rounds(programs, inputs, references.HAND_C)


def campaigns(worker: Worker, peer: Peer, count: int) -> Timed:
    """Time rounds of a campaign of the peer, and of a campaign of 512 runs of trimtab."""
    runs, many = peer.campaign, 512
    given = np.array(spec.GAINS), np.array([spec.KEY0, 0], np.uint32)
    for _ in range(count + 1):
        worker.ask("prepare", *given, runs)
    programs = {
        CAMPAIGN: Program(lambda gains, key: compiled.campaign(many, 2), many, lambda numbers: numbers[:runs]),
        peer.title: Program(lambda gains, key: worker.ask("campaign", gains, key, runs), runs, references.truth),
    }
    return rounds(programs, [given] * (count + 1), CAMPAIGN)


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("peer", choices=PEERS)
    p.add_argument("--rounds", type=int, default=7, help="number of rounds after the warm-up (%(default)s)")
    p.add_argument("--remove", action="store_true", help="delete the peer's environment afterwards")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    if a.rounds < 1:
        p.error("--rounds must be at least 1")
    peer, command = PEERS[a.peer], f"python benchmarks/peers/run.py {a.peer}"
    with Worker(environment(a.peer), a.peer) as worker:
        print(f"{machine('jax')}\nthe peer's: {worker.about}\n{load()}")
        timed = beside(worker, peer, a.rounds)
        many = campaigns(worker, peer, max(1, a.rounds // 2)) if peer.campaign else None
    show(f"One run: 15 s, 15000 steps, {a.rounds} rounds", timed, TRIMTAB, spec.N)
    found = [(u, ratio(timed, peer.title, u)) for u in (TRIMTAB, NUMPY, references.HAND_C)]
    found = [(f"one run: time of {peer.title} / time of {u}", x) for u, x in found]
    if many is not None:
        show(f"Campaigns: {peer.campaign} runs of the peer, times per run", many, CAMPAIGN, spec.N)
        rates = sorted(1 / t for t in many.times[peer.title])
        found.append((f"campaign: time of {peer.title} / time of {CAMPAIGN}", ratio(many, peer.title, CAMPAIGN)))
        rate = f"{np.median(rates):.1f} runs/s ({rates[0]:.1f}..{rates[-1]:.1f})"
        found.append((f"campaign: rate of {peer.title}", rate))
    for what, x in found:
        print(row(what, x, "", command) if a.markdown else f"{what}: {x}")
    print(load())
    if a.remove:
        shutil.rmtree(ENVIRONMENTS / a.peer)
    worst = timed.worst | ({f"{peer.title}, campaign": many.worst[peer.title]} if many is not None else {})
    bad = [(n, d) for n, d in worst.items() if not d <= (peer.tolerance if n.startswith(peer.title) else 1e-9)]
    if bad:
        print("WRONG: " + "; ".join(f"{n} by {d:.0e}" for n, d in bad) + f", allowed are {peer.tolerance:g}")
        return 1
    print(f"results agree: {peer.title} to {timed.worst[peer.title]:.0e}, allowed are {peer.tolerance:g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
