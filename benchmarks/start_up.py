"""Time `trimtab run` with a warm cache against `python -c "import jax, matplotlib"`, as alternating processes.

python benchmarks/start_up.py               a few seconds; the target of the ratio is under 2.5
python benchmarks/start_up.py --markdown    also prints the row of docs/benchmarks.md
"""

import argparse
import subprocess
import sys
import time

import numpy as np
from paired import Ratio, load, machine, row

RUN = [sys.executable, "-m", "trimtab", "run", "hovercraft/zero-velocity"]
IMPORT = [sys.executable, "-c", "import jax, matplotlib"]


def took(command: list[str]) -> float:
    """Return the wall time of a process (s)."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


if __name__ == "__main__":
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--markdown", action="store_true", help="print the row for the documentation's table at the end")
    a = p.parse_args()
    print(f"{machine('jax', 'matplotlib')}\n{load()}")
    took(RUN), took(IMPORT)
    pairs = np.array([(took(RUN), took(IMPORT)) for _ in range(9)])
    run, imported = np.median(pairs, axis=0)
    ratios = pairs[:, 0] / pairs[:, 1]
    x = Ratio(float(np.median(ratios)), float(ratios.min()), float(ratios.max()))
    print(f"trimtab run, warm cache  {run:.2f} s\nimport jax, matplotlib   {imported:.2f} s")
    print(f"ratio                    {x}   (target: under 2.5)\n{load()}")
    if a.markdown:
        print(
            row(
                "start-up: time of trimtab run with a warm cache / time to import jax and matplotlib",
                *(x, "< 2.5", "python benchmarks/start_up.py"),
            )
        )
