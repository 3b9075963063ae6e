"""Requirements on the angular accelerometer and the servos for the paper's claim to hold in rough air.

[1] has an ideal sensor, engine and elevator, so nothing printed there can be compared. Its claim is that angular
accelerometers reveal states that cannot be measured directly, so that control is possible.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.hypersonic2022._plane import AXES, rough_flights, without_measurement, worst_values
from trimtab.study import Row, same, within

SECTION = "further work"
PLACE = "[1] its claim"
ROUGH = {0.0: 0.012, 1.0: 0.74, 10.0: 7.3}
"""Factor of turbulence -> median rms error of h (ft), as on the docs page."""
STATED = {
    "noise a sample": 0.1,
    "bias": 1.0,
    "scale factor": 5.0,
    "bandwidth": 15.0,
    "delay": 15.0,
    "slope of mode 1": 3.0,
    "slope of mode 1, other sign": 1.0,
    "slope of mode 2": 3.0,
    "slope of mode 2, other sign": 0.5,
    "elevator's servo": 40.0,
    "elevator's rate": 5.0,
    "engine's servo": 1.0,
}
"""Parameter -> worst value up to which all flights succeed, as on the docs page."""


def rows() -> Iterator[Row]:
    """Yield a row on the paper's claim, and one row for each parameter that is made worse."""
    success, runs = without_measurement()
    note = "Modes 10 % off, turbulence, lags: without the accelerometer no flight succeeds."
    yield same(
        "plane/none", f"no measurement used: successful flights, of {runs}", 0, success, PLACE, basis="own", note=note
    )
    for times, (success, error) in rough_flights().items():
        words = f"turbulence times {times:g}: successful flights, of {runs}"
        yield same(f"plane/flights-{times:g}", words, runs, success, PLACE, basis="own")
        words = f"turbulence times {times:g}: h error rms, median"
        yield within(f"plane/h-{times:g}", words, ROUGH[times], error, PLACE, relative=0.1, basis="own", unit="ft")
    for axis, found in worst_values():
        words = f"{axis.name}: worst value at which all flights succeed"
        steps = ", ".join(f"{v:g}" for v in axis.values)
        id = f"plane/{axis.name}"
        yield same(id, words, STATED[axis.name], found, PLACE, basis="own", unit=axis.unit, note=f"Flown at {steps}.")


def figures(folder: Path) -> Iterator[Path]:
    """Plot the share of successful flights over each parameter."""
    from studies.hypersonic2022._plane_picture import draw_shares

    yield draw_shares(folder, AXES)
