"""A climb of your own with the hypersonic vehicle: another command, another filter, and its cost.

python examples/my_climb.py                       this comparison
trimtab run examples/my_climb.py:scenario         one flight with table and pictures
"""

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.laws.path_command import FilteredClimb
from trimtab.run.simulate import simulate
from trimtab.scenarios.hypersonic import hypersonic_scenario


def scenario(filter="tuned"):
    """Return a climb by 2 000 ft and 300 ft/s, slightly faster than the catalogue's climbs, with noise."""
    climb = FilteredClimb(dh=2000.0, dV=300.0, wh=0.08, wV=0.08)
    return hypersonic_scenario("my-climb", climb, 60.0, filter=filter, noise="on")


if __name__ == "__main__":
    for name in ("tuned", "accurate"):
        log = simulate(scenario(name), log_period=ms(50))
        late = log.t > 20
        error, elevator = log["law.h_error"][late], log["actuators.u.delta_e"][late]
        shake = np.rad2deg(np.std(np.diff(elevator)))
        print(f"{name:9s} altitude {np.sqrt(np.mean(error**2)):.4f} ft rms, elevator {shake:.3f} deg from row to row")
    try:
        hypersonic_scenario("too-quick", FilteredClimb(dh=2000.0, dV=300.0, wh=0.5, wV=0.5), 60.0).check()
    except InputError as refused:
        print(refused)
