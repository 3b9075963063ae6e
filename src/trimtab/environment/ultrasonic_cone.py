"""How much too long an ultrasonic range is away from the beacon's axis.

A receiver that triggers on the envelope's threshold triggers later where the sound is weaker. Transducers are weaker
off their axis, so that the range grows with the angle from it.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any

import numpy as np

from trimtab.core.float64 import jnp

QUADRATIC, LINEAR = -0.038, 0.0032
"""Coefficients of the fit. [1] section 5.5.4."""
CONE = math.pi / 4
"""Half the opening angle (rad) within which the fit holds and replies arrive. [1] section 5.5."""
PEAK = -LINEAR / (2 * QUADRATIC)
"""The angle (rad), 2.4°, at which the ratio is greatest: the fit is not symmetric about the axis."""


def range_ratio(beta: Any) -> Any:
    """True range over measured range at an angle beta (rad) from the axis, 0 to 45°. Source: [1] section 5.5.4."""
    return QUADRATIC * beta * beta + LINEAR * beta + 1.0


def off_axis(height: Any, distance: Any) -> Any:
    """Angle (rad) from the vertical of a line of length `distance` (m) that climbs `height` (m); 0 without a line."""
    ratio = height / jnp.where(distance > 0, distance, 1.0)
    return jnp.where(distance > 0, jnp.arccos(jnp.clip(ratio, -1.0, 1.0)), 0.0)


def fit(beta: Any, ratio: Any) -> tuple[float, float]:
    """Quadratic and linear coefficient through a calibration: least squares with ratio 1 on the axis.

    Args:
        beta: angles (rad), shape (n,).
        ratio: true over measured range, shape (n,).
    """
    b = np.asarray(beta, np.float64)
    A = np.stack([b * b, b], axis=1)
    found, *_ = np.linalg.lstsq(A, np.asarray(ratio, np.float64) - 1.0, rcond=None)
    return float(found[0]), float(found[1])
