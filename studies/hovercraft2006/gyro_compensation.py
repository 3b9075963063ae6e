"""Gyro compensation, table 6.5: ratio of the responses measured with and without the inverse.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.2.1.3.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.gyro_compensated import GyroCompensator
from trimtab.sensors.gyro_dynamics import TICK, DelayedGyro, frequency_response
from trimtab.study import Row, within

SECTION = "6.2.1.3"
PLACE = "[1] table 6.5"


class GyroResponse(NamedTuple):
    """Row of [1] table 6.5.

    frequency: Hz.  gain, phase (rad): without compensation.  gain_after, phase_after (rad): with compensation.
    delay: difference of the two delays (ms).
    """

    frequency: float
    gain: float
    phase: float
    gain_after: float
    phase_after: float
    delay: float


TABLE_6_5 = (
    GyroResponse(5, 1.05, -0.65, 1.03, -0.38, -8.59),
    GyroResponse(10, 0.98, -1.05, 1.06, -0.51, -8.59),
    GyroResponse(15, 0.93, -1.95, 1.20, -1.17, -8.28),
    GyroResponse(20, 0.90, -2.39, 1.48, -1.45, -7.48),
    GyroResponse(30, 0.67, -3.55, 1.80, -2.52, -5.46),
    GyroResponse(40, 0.47, -4.61, 1.87, -3.70, -3.62),
    GyroResponse(50, 0.33, -5.29, 1.74, -4.58, -2.26),
)


def rows() -> Iterator[Row]:
    """Yield gain, phase and delay of the inverse at each frequency, and the gain of the platform's simulated gyro."""
    for m in TABLE_6_5:
        H = compensation_gain(m.frequency)
        turn, at = float(np.angle(H)), f"{m.frequency:g} Hz"
        name = f"table-6.5/{m.frequency:g}"
        gain = m.gain_after / m.gain
        yield within(
            f"{name}/gain", f"gain with compensation divided by gain without, {at}", gain, abs(H), PLACE, relative=0.01
        )
        lead = m.phase_after - m.phase
        yield within(
            f"{name}/phase", f"phase with minus phase without, {at}", lead, turn, PLACE, tolerance=0.006, unit="rad"
        )
        w = 2 * np.pi * m.frequency
        tolerance = 0.01 / w * 1e3
        what = f"difference of the delays, {at}"
        yield within(f"{name}/delay", what, m.delay, -turn / w * 1e3, PLACE, tolerance=tolerance, unit="ms")
    for m in TABLE_6_5:
        G = abs(_gyro_gain(m.frequency))
        yield within(
            f"table-6.5/{m.frequency:g}/gyro",
            f"gain of the platform's simulated gyro, {m.frequency:g} Hz",
            m.gain,
            G,
            PLACE,
            tolerance=0.055,
            basis="input",
            note="The model's bandwidth, 30 Hz, was fitted to these seven gains. Its phase is right only up to 20 Hz.",
        )


def compensation_gain(frequency: Any) -> Any:
    """Return the complex gain of the inverse of [1, eq. 6.2], as identified, at frequencies (Hz)."""
    s = GyroCompensator(normalised=False).section()
    return frequency_response((s.b0, s.b1, s.b2), (), frequency, to_seconds(TICK))


def _gyro_gain(frequency: Any) -> Any:
    return frequency_response(*DelayedGyro().coefficients(), frequency, to_seconds(TICK))


def figures(folder: Path) -> Iterator[Path]:
    """Plot gain and phase of table 6.5, with those of the inverse and the modelled gyro."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    f, printed = np.linspace(1, 55, 200), np.array(TABLE_6_5)
    figure = Figure(figsize=(10, 4), layout="constrained")
    gain, phase = figure.subplots(1, 2)
    gyro, both = _gyro_gain(f), _gyro_gain(f) * compensation_gain(f)
    for H, columns, words in ((gyro, (1, 2), "without"), (both, (3, 4), "with")):
        (line,) = gain.plot(f, np.abs(H), label=f"{words} compensation, model")
        gain.plot(printed[:, 0], printed[:, columns[0]], "o", color=line.get_color(), label=f"{words}, table 6.5")
        phase.plot(f, np.unwrap(np.angle(H)), color=line.get_color())
        phase.plot(printed[:, 0], printed[:, columns[1]], "o", color=line.get_color())
    gain.set(xlabel="Hz", ylabel="gain", title="[1] table 6.5")
    phase.set(xlabel="Hz", ylabel="phase (rad)")
    gain.legend(frameon=False)
    path = folder / "table-6.5.png"
    figure.savefig(path, dpi=100)
    yield path
