import numpy as np
from matplotlib.image import imread

from trimtab.analysis.identify.allan import fit_allan
from trimtab.plots.allan import plot_allan


def test_picture_shows_deviations_bars_and_the_fitted_model(tmp_path):
    g, dt = np.random.default_rng(0), 0.01
    white = g.standard_normal(6_000)
    fits = {"x": fit_allan(white, dt), "y": fit_allan(white + 0.05 * np.cumsum(g.standard_normal(6_000)), dt)}
    figure = plot_allan(fits, {"x": "rad/s", "y": "rad/s"}, tmp_path / "a.png", title="Test")
    assert [axes.get_title("left") for axes in figure.axes] == ["x", "y"]
    for axes, fit in zip(figure.axes, fits.values(), strict=True):
        lines = {line.get_label(): line.get_ydata() for line in axes.lines}
        np.testing.assert_array_equal(lines["fitted"], fit.model)
        kinds = {"N": fit.white.value**2 / fit.tau, "B": 2 * np.log(2) / np.pi * fit.flicker.value**2}
        kinds["K"] = fit.walk.value**2 * fit.tau / 3
        for letter in set(kinds) & set(lines):
            np.testing.assert_allclose(lines[letter] ** 2, kinds[letter] * np.ones(len(fit.tau)), rtol=1e-12)
        bars = axes.collections[0].get_segments()
        assert all(low[1] < d < high[1] for (low, high), d in zip(bars, fit.deviation, strict=True))
    assert "K" not in {line.get_label() for line in figure.axes[0].lines}
    assert "K" in {line.get_label() for line in figure.axes[1].lines}
    assert imread(tmp_path / "a.png").std() > 0.05
