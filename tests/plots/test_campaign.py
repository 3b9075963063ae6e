"""Pictures of a campaign show its statistics."""

import numpy as np
import pytest
from matplotlib.image import imread

from trimtab.analysis.campaign.sampling.points import morris_rows, saltelli_rows
from trimtab.analysis.campaign.statistics.intervals import proportion, quantile
from trimtab.analysis.campaign.statistics.morris import morris
from trimtab.analysis.campaign.statistics.sensitivity import sensitivity
from trimtab.plots.campaign import plot_convergence, plot_histogram, plot_sensitivity

RNG = np.random.default_rng(0)


def words_of(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()] + [axes.get_title("right"), axes.get_title()]


def test_histogram_counts_runs_outside_the_axes(tmp_path):
    x = np.r_[RNG.normal(size=1000), [1e6] * 3, [np.nan] * 2]
    axes = plot_histogram(x, path=tmp_path / "h.png", limit=1.5).axes[0]
    words = " ".join(words_of(axes))
    assert "1005 runs; 3 beyond the edges; 2 without a finite value, counted as +inf" in words
    assert sum(bar.get_height() for bar in axes.containers[0]) == 1000
    assert str(quantile(x, 0.95)) in words
    assert 1.5 in [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata())]
    assert imread(tmp_path / "h.png").std() > 0.05


@pytest.mark.parametrize(("limit", "side"), [(500.0, "right"), (-500.0, "left")])
def test_far_limit_does_not_squeeze_the_bars(limit, side):
    axes = plot_histogram(np.linspace(0.0, 1.0, 200), limit=limit).axes[0]
    assert np.ptp(axes.get_xlim()) < 2
    assert f"limit {limit:g}, beyond the {side} edge" in words_of(axes)


@pytest.mark.thorough("x0", "x1")
@pytest.mark.parametrize("x", [np.full(20, 3.0), np.full(20, np.nan), np.array([1.0])])
def test_histogram_of_constant_nan_or_single_value_is_drawn(x, tmp_path):
    plot_histogram(x, path=tmp_path / "h.png")


def test_convergence_ends_at_the_interval_of_all_runs(tmp_path):
    success = RNG.random(400) < 0.9
    axes = plot_convergence(success, path=tmp_path / "c.png", limit=0.85).axes[0]
    line = axes.lines[0].get_xydata()
    assert tuple(line[-1]) == (400, success.mean())
    assert line[0][0] == 10
    found = proportion(int(success.sum()), 400)
    ends = axes.collections[1].get_paths()[0].vertices
    at_the_end = ends[ends[:, 0] == 400][:, 1]
    assert (at_the_end.min(), at_the_end.max()) == pytest.approx((found.low, found.high))


@pytest.mark.thorough
def test_quantile_convergence_starts_without_upper_bound(tmp_path):
    x = RNG.normal(size=2000)
    axes = plot_convergence(x, 0.95, tmp_path / "c.png").axes[0]
    low, high = axes.get_ylim()
    assert -1 < low < quantile(x, 0.95).low < quantile(x, 0.95).high < high < 5
    ends = axes.collections[1].get_paths()[0].vertices
    assert ends[ends[:, 0] == 10][:, 1].max() > 1e6  # ten runs: no upper bound, drawn to the edge
    plot_convergence(np.full(30, np.nan), 0.95, tmp_path / "n.png")


@pytest.mark.thorough
def test_sensitivity_bars_are_sorted_largest_first(tmp_path):
    names = ("world.vehicle.mass", "world.uplink.delay", "law.gain")
    rows = saltelli_rows(0, 0, 256 * 6, 3)
    found = sensitivity(rows.u @ [1.0, 3.0, 0.2], names)
    axes = plot_sensitivity(found, tmp_path / "s.png").axes[0]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["delay", "mass", "gain", "noise (random numbers)"]
    widths = [bar.get_width() for bar in axes.patches]
    np.testing.assert_allclose(widths[:4], found.total[[1, 0, 2, 3]])
    np.testing.assert_allclose(widths[4:], found.first[[1, 0, 2, 3]])
    assert "1536 runs" in " ".join(words_of(axes))
    screened = morris(morris_rows(0, 0, 100, 3).u @ [1.0, 3.0, 0.2], 0, names)
    axes = plot_sensitivity(screened, tmp_path / "m.png").axes[0]
    np.testing.assert_allclose([bar.get_width() for bar in axes.patches][:4], [3, 1, 0.2, 0], atol=1e-12)


def test_sensitivity_plot_states_zero_variance(tmp_path):
    found = sensitivity(np.full(80, 1.0), ("a", "b", "c"), noise=False)
    axes = plot_sensitivity(found, tmp_path / "s.png").axes[0]
    assert "no variance to explain" in " ".join(words_of(axes))
