"""Was the sensor still? A knock, a step or a motion in a log spoils its noise coefficients; here it is refused.

Noise that is white, flicker and walk has differences that are Gaussian and an Allan deviation of the fitted form. A
slow and steady motion that looks like a walk can't be told from one.

Source: this module; the scale of the differences from their median, so that a few knocks don't change it: Huber,
"Robust statistics", Wiley 1981.
"""

from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.identify.allan import AllanFit

KNOCK = 10.0
"""A change between two samples of more than so many of its usual sigmas is no noise: 1e-23 for a Gaussian."""
MISFIT = 10.0
"""Weighted squares of the misfit over the degrees of freedom: 1 for a log of this kind of noise."""
MEDIAN = 0.6744897501960817
"""Of the size of a standard normal number."""


def refuse_motion(name: str, y: Any, fit: AllanFit) -> None:
    """Raise InputError where a log is not that of a still sensor.

    Args:
        name: of the axis, for the message.
        y: samples (n,).
        fit: what `allan` found in them.
    """
    change = np.diff(np.asarray(y, np.float64))
    usual = float(np.median(np.abs(change - np.median(change)))) / MEDIAN
    size = np.abs(change - np.median(change))
    if usual > 0 and size.max() > KNOCK * usual:
        at = float((np.argmax(size) + 1) * fit.sampling_period)
        problem = (
            f"changes by {size.max():.3g} within one sample, {size.max() / usual:.0f} times the usual, {at:.2f} s in"
        )
        raise InputError(f"signal {name!r}", problem, fix="keep the sensor still, or cut the log there")
    if fit.misfit > MISFIT:
        off = np.abs(np.log(fit.deviation / fit.model))
        problem = f"is not the noise of a still sensor: at {fit.tau[np.argmax(off)]:.3g} s its Allan deviation is"
        problem += f" {fit.deviation[np.argmax(off)]:.3g}, that of the nearest noise {fit.model[np.argmax(off)]:.3g}"
        problem += f" (misfit {fit.misfit:.0f}, 1 is good)"
        fix = "keep the sensor still and its temperature steady; if it only filters its output, say --shortest TIME"
        raise InputError(f"signal {name!r}", problem, fix=fix)
