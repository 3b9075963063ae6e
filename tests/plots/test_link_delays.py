import numpy as np
import pytest
from matplotlib.image import imread
from scipy import stats

from trimtab.flight.line_delays import DelayModel, Delays, LinkTestPlan
from trimtab.plots.link_delays import gamma_density, plot_link_delays


@pytest.mark.thorough
def test_picture_has_a_row_of_three_histograms_for_each_load(tmp_path):
    g = np.random.default_rng(0)
    up, down = 0.02 + g.gamma(4, 0.005, 300), 0.017 + g.gamma(4, 0.004, 300)
    up[7] = down[7] = np.nan
    sent = np.arange(300) * 0.1
    measured = [Delays(LinkTestPlan(2.9, load), sent, up, down, 1, True, (2.9, load)) for load in (41.0, 22.0)]
    figure = plot_link_delays(measured, tmp_path / "a.png")
    titles = [axes.get_title("left") for axes in figure.axes]
    assert titles == [f"{path}, 2.9/{load} kb/s" for load in (41, 22) for path in ("up", "down", "round trip")]
    for axes, seconds in zip(figure.axes, (up, down, up + down) * 2, strict=True):
        share = [patch.get_height() * patch.get_width() for patch in axes.patches]
        seen = 1e3 * seconds[np.isfinite(seconds)]
        want, edges = np.histogram(seen, len(share))
        np.testing.assert_allclose(share, want / 299, atol=1e-9)
        assert axes.patches[0].get_x() == pytest.approx(edges[0])
    assert len(figure.axes[0].lines) == 2
    fitted = next(line for line in figure.axes[0].lines if len(line.get_xdata()) > 2)
    area = np.trapezoid(fitted.get_ydata(), fitted.get_xdata())
    assert area == pytest.approx(1, abs=0.1), "a density per ms, as the histogram's"
    assert len(figure.axes[2].lines) == 1
    assert imread(tmp_path / "a.png").std() > 0.05


def test_density_is_that_of_the_shifted_gamma_distribution():
    m = DelayModel(mean=0.034, sd=0.008, shift=0.017, loss=0.0)
    x = np.linspace(0.01, 0.08, 50)
    k, scale = (0.017 / 0.008) ** 2, 0.008**2 / 0.017
    assert gamma_density(m, x) == pytest.approx(stats.gamma.pdf(x, k, 0.017, scale))
