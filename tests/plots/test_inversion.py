"""The picture of an inversion shows its results, with angles in degrees and without constant signals."""

import numpy as np

from trimtab.design.output_inversion import Inversion
from trimtab.plots.inversion import plot_inversion


def test_draws_moving_signals_and_omits_constant_ones(tmp_path):
    times = np.linspace(0, 3, 31)
    x = np.stack([np.sin(times), 0 * times + 2.0, 0.1 * times], axis=1)
    found = Inversion(times, x, np.cos(times)[:, None], None, None)  # type: ignore[arg-type]
    file = tmp_path / "course.png"
    figure = plot_inversion(found, ("a", "b", "c"), ("F",), (1.0, 2.0), file, "one", units={"c": "rad", "F": "N"})
    assert file.stat().st_size > 5000
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["a", "c", "F"]
    np.testing.assert_allclose(figure.axes[1].lines[0].get_ydata(), np.degrees(0.1 * times))
    assert figure.axes[1].get_ylabel() == "deg"
    assert figure.axes[-1].get_xlabel() == "time (s)"


def test_outputs_come_first_and_nearly_constant_signals_are_omitted(tmp_path):
    """An angle of 0.01 deg beside 10 deg is omitted; an output of 1 m beside 1 km is kept."""
    times = np.linspace(0, 3, 31)
    x = np.stack([1e3 * times, 1e-4 * np.sin(times), np.sin(times), 0.3 * times], axis=1)
    found = Inversion(times, x, np.cos(times)[:, None], None, None)  # type: ignore[arg-type]
    names, units = (
        ("north", "roll", "pitch", "altitude"),
        {"north": "m", "altitude": "m", "roll": "rad", "pitch": "rad"},
    )
    figure = plot_inversion(found, names, ("F",), (1.0, 2.0), tmp_path / "c.png", "", units, outputs=("altitude",))
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["altitude", "north", "pitch", "F"]
