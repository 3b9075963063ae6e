"""The animation of a run: frames, moving craft, and size of the GIF."""

import numpy as np
import pytest
from PIL import Image

from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target
from trimtab.plots import animation
from trimtab.plots.animation import Mover, _draw_signals, _move, _new_craft, animate_paths, animate_run
from trimtab.plots.style import new_figure


def flown(duration=1.6, heading=True):
    """Return the log of a straight flight to the east, 50 rows per second."""
    ticks = np.arange(int(50 * duration) + 1) * 200_000
    t = to_seconds(ticks)
    signals = {"truth.north": 0 * t, "truth.east": t, "truth.surge": 1 + 0 * t, "truth.yaw_rate": np.sin(t)}
    if heading:
        signals["truth.heading"] = 0 * t + np.pi / 2
    return Log(t, ticks, signals)


def frames(path):
    found = []
    with Image.open(path) as image:
        for k in range(image.n_frames):
            image.seek(k)
            found.append((np.asarray(image.convert("RGB")).astype(int), image.info["duration"]))
    return found


def craft_column(frame):
    """Return the last column with the colour of the craft in the plan view. The lines of the legend are below."""
    red, _, blue = np.moveaxis(frame[30:300, :360], 2, 0)
    return np.nonzero(((blue - red > 100) & (red < 60)).any(axis=0))[0].max()


@pytest.mark.parametrize("heading", [True, False])
def test_craft_moves_at_the_speed_of_the_flight(tmp_path, heading):
    animate_run(flown(heading=heading), flown(), tmp_path / "east.gif")
    shown = frames(tmp_path / "east.gif")
    assert len(shown) == 20  # 1.6 s at 0.08 s
    assert {duration for _, duration in shown[:-1]} == {80}
    assert shown[-1][1] == 2000
    columns = np.array([craft_column(frame) for frame, _ in shown])
    assert (np.diff(columns) >= 0).all()
    expected = columns[0] + 10 / 19 * (columns[-1] - columns[0])
    assert columns[10] == pytest.approx(expected, abs=6)
    assert columns[-1] - columns[0] > 150


def test_long_run_is_shown_faster_in_a_small_file(tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "FRAMES", 25)
    animate_run(flown(60.0), path=tmp_path / "long.gif", targets=[Target("truth.yaw_rate", 0.0, 0.3)])
    assert len(frames(tmp_path / "long.gif")) == animation.FRAMES
    assert (tmp_path / "long.gif").stat().st_size < 100_000


def test_run_without_a_position_is_animated_by_its_signals(tmp_path):
    log = flown()
    log = Log(log.t, log.ticks, {"truth.surge": log["truth.surge"], "truth.yaw_rate": log["truth.yaw_rate"]})
    animate_run(log, log, tmp_path / "signals.gif")
    first, last = (frames(tmp_path / "signals.gif")[k][0] for k in (0, -2))
    assert (first[60:] != last[60:]).any()  # the cursors; the clock is above


def test_runs_of_a_campaign_move_together(tmp_path):
    fast = flown()
    slow = Log(fast.t, fast.ticks, {path: fast[path] * (0.5 if path == "truth.east" else 1) for path in fast.paths})
    animate_paths([fast, slow], [True, False], tmp_path / "two.gif", "two runs")
    reds, blues = [], []
    for frame, _ in frames(tmp_path / "two.gif")[5:]:  # apart from here on
        red, green, blue = np.moveaxis(frame[30:310, 50:], 2, 0)
        reds.append(np.nonzero(((red - blue > 120) & (green < 140)).any(axis=0))[0].max())
        blues.append(np.nonzero(((blue - red > 100) & (red < 60)).any(axis=0))[0].max())
    assert (blues[-1] - blues[0]) == pytest.approx(2 * (reds[-1] - reds[0]), rel=0.1)
    lost = Log(fast.t, fast.ticks, {"truth.surge": fast["truth.surge"]})
    with pytest.raises(InputError, match="no north and east"):
        animate_paths([lost], [True], tmp_path / "lost.gif")


def test_refuses_other_formats_and_logs_without_a_span(tmp_path):
    with pytest.raises(InputError, match=r"must end in \.gif"):
        animate_run(flown(), path=tmp_path / "a.mp4")
    with pytest.raises(InputError, match="at least 2 rows, got 1"):
        animate_run(flown(0.0), path=tmp_path / "a.gif")
    assert not list(tmp_path.iterdir())


def test_craft_points_along_its_heading():
    figure = new_figure(4.0, 4.0)
    axes = figure.add_subplot()
    axes.set_xlim(0, 10)
    path = np.array([[3.0, 4.0], [5.0, 6.0], [np.nan, np.nan]])
    mover = Mover(np.arange(3.0), path, np.radians([90.0, 0.0, 0.0]), _new_craft(axes, "b", "b", 1.0), 0.1)
    for t, nose in ((0.0, [4.0, 4.0]), (0.9, [4.0, 4.0]), (1.0, [5.0, 7.0])):  # east, then north
        _move(mover, t)
        np.testing.assert_allclose(mover.artists[1].get_xy()[0], nose, atol=1e-12)
    assert np.array(mover.artists[0].get_data()).T.tolist() == path[:2].tolist()
    assert mover.artists[1].get_visible()
    _move(mover, 2.0)
    assert not mover.artists[1].get_visible()


def test_signals_of_targets_come_first_and_the_position_is_left_out():
    figure = new_figure(8.0, 4.6)
    grid = figure.add_gridspec(3, 2)
    cells = [grid[row, 1] for row in range(3)]
    cursors = _draw_signals(figure, cells, flown(), None, (Target("truth.yaw_rate", 0.0, 0.3),))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[0].startswith("Yaw rate")
    assert not any(name in title.lower() for title in titles for name in ("north", "east"))
    assert len(cursors) == len(titles) >= 2
