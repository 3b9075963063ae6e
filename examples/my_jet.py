"""The F-16 at sea level, 502 ft/s, for trim and linear models: trimtab linearise examples/my_jet.py --at …"""

import numpy as np

from trimtab.core.rotation import DEG
from trimtab.vehicles.f16 import F16, F16Controls
from trimtab.vehicles.imperial import FOOT


def system():
    """Return vehicle, initial state and input; centre of mass as in the book's table, at 35 % of the chord."""
    jet = F16(centre=0.35)
    ahead, level = [502 * FOOT, 0.0, 0.0], [0.0, 2 * DEG, 0.0]
    start = jet.body.start(0.6, -1.4, 0.0, velocity=ahead, angles=level, rate=np.zeros(3), over_ground=True)
    return jet, start, F16Controls(elevator=0.0, aileron=0.0, rudder=0.0, throttle=0.2)
