"""The Bode plot shows the values of the loop."""

import numpy as np
import pytest

from examples.my_cart import scenario
from trimtab.design.loop_map import find_crossings
from trimtab.plots.bode import plot_bode
from trimtab.run.loop_linearisation import linearise_loop


@pytest.mark.thorough
def test_bode_plot_shows_magnitude_phase_and_margins(tmp_path):
    loop = linearise_loop(scenario())
    figure = plot_bode(loop, tmp_path / "bode.png", "cart")
    assert (tmp_path / "bode.png").stat().st_size > 5000
    size, phase = figure.axes
    curve, dots, *_ = size.get_lines()
    w = curve.get_xdata()
    np.testing.assert_allclose(curve.get_ydata(), 20 * np.log10(np.abs(loop.broken_loops(w)[:, 0])), atol=1e-9)
    crossings = find_crossings(loop)["force"]
    assert [float(d.get_xdata()[0]) for d in size.get_lines() if len(d.get_xdata()) == 1] == [f for f, _ in crossings]
    assert [t.get_text().strip() for t in phase.texts] == [f"{np.degrees(m):.0f}°" for _, m in crossings]
    assert len(dots.get_xdata()) == 1
