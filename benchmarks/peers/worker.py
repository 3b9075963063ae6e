"""Process in a peer's environment: reads lines [program, gains, key] and prints 14 numbers for each line.

For the programs "prepare" and "campaign", the line has the number of runs as fourth element. The reply to "prepare" is
empty, the reply to "campaign" has 14 numbers for each run.

    python worker.py peer_drake

run.py starts it. Output of the peer goes to standard error.
"""

import importlib
import json
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent / "reference")]
import hover_np


def versions() -> str:
    """Return the versions of the relevant packages in this environment."""
    found = [f"Python {platform.python_version()}"]
    for name in ("numpy", "scipy", "jax", "drake", "control", "pathsim", "jaxonomy", "elodin"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    peer = importlib.import_module(sys.argv[1])
    programs = {"numpy": hover_np.single, "peer": peer.single}
    programs |= {name: getattr(peer, name) for name in ("prepare", "campaign") if hasattr(peer, name)}
    print(json.dumps(versions()), file=answers, flush=True)
    for line in sys.stdin:
        program, gains, key, *runs = json.loads(line)
        numbers = programs[program](np.array(gains), np.array(key, np.uint32), *runs)
        print(json.dumps([] if numbers is None else np.asarray(numbers, float).tolist()), file=answers, flush=True)
