"""The picture of a swarm: one track for each craft, spacing of the real and the ideal run."""

import numpy as np
import pytest
from matplotlib.image import imread

from trimtab.core.errors import InputError
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.plots.swarm import plot_swarm

T = np.arange(0, ms(2000), ms(10))
AROUND = to_seconds(T)[:, None] + np.arange(3)


def log(shift=0.0, **more):
    signals = {
        "truth.north": 3 * np.cos(AROUND),
        "truth.east": 3 * np.sin(AROUND),
        "truth.heading": AROUND,
        "sensors.arena.value.spacing": 1.5 + shift + to_seconds(T),
        "sensors.arena.value.formation_error": 2.0 - to_seconds(T) / 2,
    }
    return Log(t=to_seconds(T), ticks=T, signals=signals | more)


@pytest.mark.thorough
def test_each_craft_has_a_track_and_a_heading_mark(tmp_path):
    figure = plot_swarm(log(), path=tmp_path / "s.png", title="Test")
    floor, spacing, _ = figure.axes
    ways = [line for line in floor.lines if len(line.get_xdata()) == len(T)]
    for i, way in enumerate(ways):
        np.testing.assert_allclose(way.get_ydata(), 3 * np.cos(AROUND[:, i]))
    noses = [line for line in floor.lines if len(line.get_xdata()) == 2]
    assert (len(ways), len(noses)) == (3, 3)
    x, y = noses[0].get_data()
    assert np.arctan2(x[1] - x[0], y[1] - y[0]) == pytest.approx(AROUND[-1, 0])
    assert spacing.get_title("right") == "least 1.5 m"
    assert imread(tmp_path / "s.png").std() > 0.05


def test_ideal_run_spacing_is_drawn_beside_real_run():
    spacing = plot_swarm(log(), log(shift=1.0)).axes[1]
    assert [line.get_ydata()[0] for line in spacing.lines] == [2.5, 1.5]
    assert spacing.get_title("right") == "least 1.5 m", "the note is the real run's"


def test_rejects_log_of_a_single_vehicle():
    with pytest.raises(InputError, match="several craft"):
        plot_swarm(log(**{"truth.north": np.zeros(len(T))}))
