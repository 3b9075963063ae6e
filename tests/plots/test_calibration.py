"""Pictures of fits: readings, band, excluded readings, residuals."""

from pathlib import Path

import numpy as np
from matplotlib.image import imread
from matplotlib.text import Text

from trimtab.plots.calibration import FitCurve, FitPanel, plot_fits


def test_picture_shows_readings_fit_and_residuals(tmp_path: Path) -> None:
    x = np.linspace(0, 1, 20)
    kept = np.arange(20) != 7
    curve = FitCurve(x, 2 * x, 2 * x + 0.1, kept, x, 2 * x, 0.1 * np.ones(20))
    panels = [
        FitPanel("Thrust", "speed", "force", [curve]),
        FitPanel("Two", "x", "y", [curve, curve._replace(label="b")]),
    ]
    figure = plot_fits(panels, tmp_path / "fit.png", "calibrate")
    above, below = figure.axes[0], figure.axes[2]
    assert above.get_title(loc="left") == "Thrust"
    assert "left out" in [t.get_text() for t in (above.get_legend() or figure).findobj(Text)]
    assert below.get_ylabel() == "residual"
    assert len(above.collections) == 1  # the band
    assert imread(tmp_path / "fit.png").shape[0] > 300
