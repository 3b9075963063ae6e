"""filterpy's KalmanFilter with the interface that filters_np.py uses."""

import filterpy
import numpy as np
from filterpy.kalman import KalmanFilter

NAME = f"filterpy {filterpy.__version__}"


class Filter(KalmanFilter):
    """Filter with states of shape (n,). F, Q and R are arguments of each call."""

    def __init__(self, x, P, H):
        super().__init__(dim_x=len(x), dim_z=len(H))
        self.x, self.P, self.H = np.array(x), np.array(P), H

    def predict(self, F, Q):
        super().predict(F=F, Q=Q)

    def update(self, z, R):
        super().update(z, R=R)
