"""Time `trimtab run` on a warm cache against `python -c "import jax, matplotlib"`, whole processes in turn.

    python benchmarks/start_up.py

Prints the median of the ratios of neighbouring runs; the target is under 2.5.
"""

import subprocess
import sys
import time

import numpy as np

RUN = [sys.executable, "-m", "trimtab.cli", "run", "hovercraft/zero-velocity"]
IMPORT = [sys.executable, "-c", "import jax, matplotlib"]


def took(command: list[str]) -> float:
    """Wall time of a process (s)."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


if __name__ == "__main__":
    took(RUN), took(IMPORT)
    pairs = np.array([(took(RUN), took(IMPORT)) for _ in range(9)])
    run, imported = np.median(pairs, axis=0)
    print(f"trimtab run, warm cache  {run:.2f} s\nimport jax, matplotlib   {imported:.2f} s")
    print(f"ratio                    {np.median(pairs[:, 0] / pairs[:, 1]):.2f}   (target: under 2.5)")
