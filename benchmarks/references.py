"""C and SIMD C++ of the loop, written by hand, built with the machine's compiler, and called through ctypes."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SOURCES = Path(__file__).parent / "reference"
sys.path.insert(0, str(SOURCES))
import spec

CC, CXX = os.environ.get("CC", "gcc"), os.environ.get("CXX", "g++")
FLAGS = ["-O3", "-shared", "-fPIC"]
HAND_C, HAND_SLP = "hand-written C", "hand-written C with SLP"
KNOWN = np.array(
    [
        *(0.0359807356968819, 0.0300824255925851, 0.00182891280533006, -0.0991717791979678, -3.92524697596123),
        *(10.9585213852944, 10.9473455499011, 0.00247880849785609, -0.0997645564191161, -3.92949262830810),
        *(0.0132121395138743, -0.0239376256565529, 0.0282358010078955, -0.0204137281635220),
    ]
)
"""The 14 numbers for gains (1, 2.5) and key (7, 0), as printed in README.md."""
TRUTH = 6
"""Number of these, counted from the first, that are the true state, the final values of a compiled run."""


def truth(numbers: Any) -> Any:
    """Return the true state in the numbers of a run, or in each row of several runs."""
    return np.asarray(numbers)[..., :TRUTH]


def sh(*command: str) -> str:
    """Return the output of a command. If the command fails, exit with its message."""
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        sys.exit(f"{command[0]} not found (Debian: apt-get install gcc g++; or name compilers in CC and CXX)")
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout


def widest(march: str) -> int:
    """Return the number of lanes for code with this -march: 8 with AVX-512, 4 with AVX2, else 0."""
    macros = sh(CC, f"-march={march}", "-dM", "-E", "-x", "c", os.devnull)
    if all(f"__AVX512{x}__" in macros for x in ("F", "DQ", "VL")):
        return 8
    return 4 if "__AVX2__" in macros else 0


def hand(folder: str, march: str) -> dict[str, ctypes.CDLL]:
    """Build hand-written C without and with SLP, by which gcc packs neighbouring scalars into vectors."""
    libraries = {}
    for name, extra in ((HAND_C, ["-fno-tree-vectorize"]), (HAND_SLP, [])):
        out = f"{folder}/hand{len(libraries)}.so"
        sh(CC, *FLAGS, f"-march={march}", *extra, "-o", out, str(SOURCES / "hover_c.c"), "-lm", "-lpthread")
        libraries[name] = ctypes.CDLL(out)
    return libraries


def simd(folder: str, march: str, lanes: int) -> dict[str, ctypes.CDLL]:
    """Build hand-written SIMD. If that is impossible, print the reason and return an empty dict."""
    if not lanes:
        print("hand-written SIMD is left out: no AVX2")
        return {}
    out, source = f"{folder}/simd.so", str(SOURCES / "hover_simd.cpp")
    try:
        sh(CXX, *FLAGS, f"-march={march}", f"-DW={lanes}", "-o", out, source, "-lm", "-lmvec", "-lpthread")
        return {hand_simd(lanes): ctypes.CDLL(out)}
    except (RuntimeError, OSError) as reason:
        print(f"hand-written SIMD is left out: it needs g++, x86-64 and glibc 2.35 or newer\n{str(reason)[:500]}")
        return {}


def hand_simd(lanes: int) -> str:
    """Return the name of hand-written SIMD in the tables."""
    return f"hand-written SIMD, {lanes} lanes"


def at(a: Any) -> ctypes.c_void_p:
    """Return the address of an array."""
    return ctypes.c_void_p(a.ctypes.data)


def single(library: ctypes.CDLL) -> Callable[..., Any]:
    """Return a function of (gains, key) that simulates one run and returns 14 numbers."""
    out = np.empty(14)

    def call(gains: Any, key: Any) -> Any:
        library.sim_sum(at(gains), at(key), spec.N, at(out))
        return out.copy()

    return call


def block(library: ctypes.CDLL, lanes: int) -> Callable[..., Any]:
    """Return a function that simulates a run in each lane, with increasing keys, and returns the first run's."""
    out = np.empty((lanes, 14))

    def call(gains: Any, key: Any) -> Any:
        runs = key[1] + np.arange(lanes, dtype=np.uint32)
        library.sim_block(at(gains), int(key[0]), at(runs), spec.N, at(out))
        return out[0].copy()

    return call


def logged(library: ctypes.CDLL) -> Callable[..., Any]:
    """Return a function of (gains, key) that returns a log of 11 numbers per step: x 6, estimate 3, thrust, rudder."""

    def call(gains: Any, key: Any) -> Any:
        log = np.empty((spec.N, 11))
        library.sim_log(at(gains), at(key), spec.N, at(log))
        return log

    return call


def campaign(library: ctypes.CDLL) -> Callable[..., Any]:
    """Return a function of (runs, threads) that simulates a campaign and returns runs x 14 numbers."""
    gains = np.array(spec.GAINS)

    def call(runs: int, threads: int) -> Any:
        out = np.empty((runs, 14))
        library.mc(at(gains), spec.KEY0, runs, spec.N, threads, at(out))
        return out

    return call
