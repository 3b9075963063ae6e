import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop.lander import hover
from matplotlib.image import imread
from matplotlib.text import Text

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target
from trimtab.plots.run import Panel, plot_run, select_panels, signal_note
from trimtab.plots.style import BLUE, CHATTER, GREY, VERMILION, decimate
from trimtab.run.simulate import simulate

UNITS = {
    "truth.surge_velocity": ("m/s", "real"),
    "truth.heading": ("rad", "angle"),
    "sensors.navigation.age": ("s", "real"),
    "downlink.navigation.age": ("s", "real"),
    "downlink.navigation.t": ("100 ns", "time"),
    "estimate.age": ("s", "real"),
    "law.demand.FX": ("N", "real"),
    "law.mode": ("1", "mode"),
    "law.lyapunov": ("J", "real"),
    "command.value.speed_rpm": ("rpm", "real"),
    "command.t": ("100 ns", "time"),
    "uplink.age": ("s", "real"),
    "actuators.u.FX": ("N", "real"),
    "actuators.thrust": ("N", "real"),
    "actuators.speed_rpm": ("rpm", "real"),
    "actuators.braking": ("1", "flag"),
}


def flown(n: int = 400, seed: int = 0) -> Log:
    rng = np.random.default_rng(seed)
    ticks = np.arange(n) * 10_000
    signals: dict[str, np.ndarray] = {}
    declared: dict[str, Quantity] = {}
    for path, (unit, kind) in UNITS.items():
        modes = ("damp", "turn to the goal") if kind == "mode" else ()
        declared[path] = Quantity(unit, f"{path}, for the picture.", kind=kind, modes=modes)
        values = np.cumsum(rng.normal(size=n))
        if kind in ("mode", "time"):
            values = (np.arange(n) // 100 % 2).astype(np.int32)
        if path == "actuators.thrust":
            values = 1e-3 + values * 1e-5  # long tick labels
        signals[path] = values > 0 if kind == "flag" else np.abs(values) if path == "law.lyapunov" else values
    return Log(to_seconds(ticks), ticks, signals, declared, {"scenario": "hovercraft/forward", "seed": 4})


@pytest.fixture(scope="module")
def drawn():
    real, ideal = flown(seed=1), flown(seed=2)
    return real, ideal, plot_run(real, ideal, targets=[Target("heading", 1.0, 0.5)])


def axes_of(figure, title):
    found = [a for a in figure.axes if a.get_title(loc="left") == title]
    assert len(found) == 1, [a.get_title(loc="left") for a in figure.axes]
    return found[0]


def line_of(axes, colour):
    return next(line for line in axes.get_lines() if line.get_color() == colour and len(line.get_xdata()) > 2)


def test_panels_follow_from_the_signal_paths(drawn):
    _, _, figure = drawn
    titles = [a.get_title(loc="left") for a in figure.axes]
    truth, actuators = ["Surge velocity", "Heading"], ["FX", "Thrust", "Speed"]
    assert titles == [*truth, *actuators, "Mode", "Lyapunov", "Age of the newest sample", "Flags"]
    assert figure.axes[0].get_title(loc="right") == "truth.surge_velocity"
    assert axes_of(figure, "FX").get_title(loc="right") == "law.demand.FX, actuators.u.FX"


def test_signal_note_is_shortened_beside_a_long_title():
    name, demand = "actuators.u.shaft_speed", "law.demand.shaft_speed"
    assert signal_note(Panel("Shaft speed, actuators.u", (name,), demand_path=demand)) == name
    assert signal_note(Panel("Shaft speed", (name,), demand_path=demand)) == f"{demand}, {name}"
    assert signal_note(Panel("A title as long as the whole width of the panel is", (name,))) == ""


def test_labels_have_the_declared_units(drawn):
    _, _, figure = drawn
    units = {a.get_title(loc="left"): a.get_ylabel() for a in figure.axes}
    assert units == {
        "Surge velocity": "m/s",
        "Heading": "deg",
        "FX": "N",
        "Thrust": "N",
        "Speed": "rpm",
        "Mode": "",
        "Lyapunov": "J",
        "Age of the newest sample": "s",
        "Flags": "",
    }
    assert [a.get_xlabel() for a in figure.axes] == [""] * 6 + ["time (s)"] * 3


def test_lines_contain_the_logged_data(drawn):
    real, ideal, figure = drawn
    axes = axes_of(figure, "Heading")
    np.testing.assert_array_equal(line_of(axes, BLUE).get_xdata(), real.t)
    np.testing.assert_array_equal(line_of(axes, BLUE).get_ydata(), np.degrees(1.0) * real["truth.heading"])
    np.testing.assert_array_equal(line_of(axes, VERMILION).get_ydata(), np.degrees(1.0) * ideal["truth.heading"])
    axes = axes_of(figure, "FX")
    np.testing.assert_array_equal(line_of(axes, GREY).get_ydata(), real["law.demand.FX"])
    np.testing.assert_array_equal(line_of(axes, BLUE).get_ydata(), real["actuators.u.FX"])
    np.testing.assert_array_equal(line_of(axes_of(figure, "Speed"), GREY).get_ydata(), real["command.value.speed_rpm"])


def test_the_target_is_drawn_only_in_its_own_panel(drawn):
    _, _, figure = drawn
    axes = axes_of(figure, "Heading")
    level = next(line for line in axes.get_lines() if len(line.get_xdata()) == 2).get_ydata()[0]
    assert (np.radians(level) - 1.0) % (2 * np.pi) == pytest.approx(0.0, abs=1e-9)
    assert axes.patches[0].get_height() == pytest.approx(np.degrees(1.0))
    assert not axes_of(figure, "Surge velocity").patches


def test_modes_are_drawn_as_named_steps(drawn):
    real, ideal, figure = drawn
    axes = axes_of(figure, "Mode")
    assert [label.get_text() for label in axes.get_yticklabels()] == ["damp", "turn to the\ngoal"]
    assert all(line.get_drawstyle() == "steps-post" for line in axes.get_lines())
    np.testing.assert_array_equal(line_of(axes, BLUE).get_ydata(), real["law.mode"])
    np.testing.assert_allclose(line_of(axes, VERMILION).get_ydata(), ideal["law.mode"] - 0.1, atol=1e-15)


def test_lyapunov_axis_is_logarithmic_and_flags_are_bars(drawn):
    real, _, figure = drawn
    assert axes_of(figure, "Lyapunov").get_yscale() == "log"
    spans = [path.get_extents() for path in axes_of(figure, "Flags").collections[0].get_paths()]
    on = np.array([any(s.x0 <= t < s.x1 for s in spans) for t in real.t[:-1]])
    np.testing.assert_array_equal(on, real["actuators.braking"][:-1])


def test_link_ages_share_a_panel(drawn):
    _, _, figure = drawn
    legend = axes_of(figure, "Age of the newest sample").get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["downlink.navigation.age", "uplink.age"]


def test_single_legend_explains_the_colours(drawn):
    _, _, figure = drawn
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["real", "ideal", "demanded", "target", "band"]
    assert figure.texts[0].get_text() == "hovercraft/forward · seed 4"
    alone = plot_run(flown())
    assert [t.get_text() for t in alone.legends[0].get_texts()] == ["real", "demanded"]
    assert plot_run(flown(), title="Mine").texts[0].get_text() == "Mine"


def texts_of(axes) -> list[Text]:
    """The texts that are drawn: all but tick labels out of view."""
    found = [axes.xaxis.label, axes.yaxis.label]
    found += [text for text in axes.get_children() if isinstance(text, Text)]
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        found += [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return found


def test_texts_do_not_overlap_or_leave_the_picture(drawn):
    _, _, figure = drawn
    figure.draw_without_rendering()
    texts = [*figure.texts, *figure.legends[0].get_texts(), *(t for axes in figure.axes for t in texts_of(axes))]
    texts = [text for text in texts if text.get_visible() and text.get_text().strip()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    assert len(boxes) > 70
    for i, (a, x) in enumerate(boxes):
        assert x.x0 > 0, a
        assert x.x1 < figure.bbox.x1, a
        for b, y in boxes[i + 1 :]:
            assert not x.overlaps(y), (a, b)


def test_unknown_vehicle_gets_panels_for_its_signals():
    ticks = np.arange(20)
    signals = {
        "truth.altitude": np.linspace(0, 1e5, 20),
        "truth.p_WB": np.zeros((20, 3)),
        "law.demand.elevator": np.zeros(20),
        "law.reference": np.full(20, np.nan),
        "actuators.valve_open": np.arange(20) > 4,
    }
    log = Log(to_seconds(ticks), ticks, signals)
    titles = [p.title for p in select_panels(log)]
    assert titles == ["Altitude", "P WB", "Elevator", "Reference", "Flags"]
    figure = plot_run(log, log)
    assert len(axes_of(figure, "P WB").get_lines()) == 6
    only = Log(to_seconds(ticks), ticks, {"estimate.state.x": np.zeros(20)})
    assert [p.title for p in select_panels(only)] == ["x"]


@pytest.mark.parametrize(
    ("aim", "said"), [(1.0, "within the target band from 0.15 s on"), (2.0, "outside the target band at the end")]
)
def test_target_panel_states_whether_target_is_met(aim, said):
    log = flown()
    log = Log(
        log.t, log.ticks, log.signals | {"truth.heading": 1 - np.exp(-20 * log.t)}, log.declarations, log.metadata
    )
    figure = plot_run(log, targets=[Target("heading", aim, 0.05)])
    assert [text.get_text() for text in axes_of(figure, "Heading").texts] == [said]


@pytest.mark.thorough("0", "1")
@pytest.mark.parametrize("n", [0, 1, 2])
def test_very_short_runs_are_drawn(n, tmp_path):
    log = flown(n=5).between(0, n * 1e-3)
    assert len(log) == n
    plot_run(log, log, tmp_path / "short.png", targets=[Target("heading", 1.0, 0.5)])
    assert (tmp_path / "short.png").exists()


def test_png_has_the_figure_size(tmp_path, drawn):
    real, ideal, _ = drawn
    figure = plot_run(real, ideal, tmp_path / "run.png")
    picture = imread(tmp_path / "run.png")
    wide, high = figure.get_size_inches() * figure.dpi
    assert picture.shape[:2] == (int(high), int(wide))
    assert 0.01 < (picture[..., :3].min(axis=2) < 0.9).mean() < 0.5
    assert [p.name for p in tmp_path.iterdir()] == ["run.png"]


@pytest.mark.thorough
def test_file_suffix_selects_the_picture_format(tmp_path):
    plot_run(flown(), path=tmp_path / "run.svg")
    assert b"<svg" in (tmp_path / "run.svg").read_bytes()
    with pytest.raises(InputError, match="cannot be saved as 'doc'"):
        plot_run(flown(), path=tmp_path / "run.doc")
    with pytest.raises(InputError, match="mkdir -p"):
        plot_run(flown(), path=tmp_path / "no" / "run.png")
    with pytest.raises(InputError, match="no signal has this name"):
        plot_run(flown(), targets=[Target("truth.depth", 1.0, 0.5)])


def test_long_lines_are_thinned_and_keep_extremes():
    n = 15_000
    x = np.sin(np.arange(n) / 900) + 1e-3 * np.random.default_rng(0).normal(size=n)
    x[7_777], x[8_888] = 50.0, -50.0
    ticks = np.arange(n)
    figure = plot_run(Log(to_seconds(ticks), ticks, {"truth.x": x}))
    shown = figure.axes[0].get_lines()[0]
    values = np.asarray(shown.get_ydata())
    assert len(values) <= 1802
    assert (values.min(), values.max()) == (-50.0, 50.0)


@pytest.mark.thorough
@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-10, 10) | st.just(np.nan), min_size=1, max_size=60), st.integers(1, 5))
def test_decimation_keeps_extremes_ends_gaps_and_order(values, bins):
    x = np.array(values)
    t = np.arange(len(x)) * 0.5
    kept_t, kept = decimate(t, x, bins)
    assert len(kept) <= max(4 * bins, 3 * bins + 2)
    np.testing.assert_array_equal(kept, x[(kept_t * 2).astype(int)])
    assert (np.diff(kept_t) > 0).all()
    assert kept_t[0] == t[0]
    assert kept_t[-1] == t[-1]
    size = len(x) if len(x) <= 4 * bins else -(-len(x) // bins)
    for start in range(0, len(x), size):
        stretch = x[start : start + size]
        inside = kept[(kept_t >= t[start]) & (kept_t <= t[min(start + size, len(x)) - 1])]
        assert np.isnan(inside).any() == np.isnan(stretch).any()
        if not np.isnan(stretch).all():
            assert np.nanmin(inside) == np.nanmin(stretch)
            assert np.nanmax(inside) == np.nanmax(stretch)


@pytest.mark.thorough
def test_spatial_flight_shows_angles_in_degrees_and_its_track():
    log = simulate(hover(), log_period=ms(20), backend="jax")
    figure = plot_run(log, log, targets=hover().targets)
    titles = [a.get_title(loc="left") for a in figure.axes]
    assert titles[:3] == ["Altitude", "Speed", "Attitude"]
    assert {"Plan", "Profile"} <= set(titles)
    assert "q" not in titles
    assert "v" not in titles
    assert "r" in titles  # a target is set on it
    attitude = axes_of(figure, "Attitude")
    assert attitude.get_ylabel() == "deg"
    yaw = attitude.lines[4].get_ydata()
    assert yaw[-1] == pytest.approx(np.rad2deg(log.t[-1]), rel=1e-6)
    profile = axes_of(figure, "Profile")
    assert profile.lines[-1].get_ydata()[0] == pytest.approx(5.0, abs=0.2)  # where it ends


def test_input_bounds_are_drawn_only_when_near():
    ticks = np.arange(100) * 10_000
    u = np.linspace(0, 8, 100)
    declared = {
        "actuators.u.near": Quantity("N", "F.", low=0, high=10),
        "actuators.u.far": Quantity("N", "F.", high=500),
    }
    log = Log(to_seconds(ticks), ticks, dict.fromkeys(declared, u), declared)
    figure = plot_run(log)
    assert {axes_of(figure, "Near").lines[k].get_ydata()[0] for k in (1, 2)} == {0, 10}
    assert len(axes_of(figure, "Far").lines) == 1


def test_vector_flag_is_drawn_per_component():
    ticks = np.arange(10) * 10_000
    declared = {"law.working": Quantity("1", "Which work.", kind="flag")}
    log = Log(to_seconds(ticks), ticks, {"law.working": np.ones((10, 3), bool), "truth.x": np.zeros(10)}, declared)
    labels = [t.get_text() for t in axes_of(plot_run(log), "Flags").get_yticklabels()]
    assert labels == ["Working[0]", "Working[1]", "Working[2]"]


@pytest.mark.thorough
def test_panel_titles_are_unique():
    log = simulate("hovercraft/pose", duration="100 ms")
    titles = [panel.title for panel in select_panels(log)]
    assert len(titles) == len(set(titles)), titles
    assert sum("," in title for title in titles) < len(titles) / 2


def switching(n=30_000, every=20):
    """Slow at first, then a bang-bang law that switches all the time, a quarter of it up."""
    ticks = np.arange(n) * 10_000
    x = np.where(np.arange(n) % (4 * every) < every, 1.0, -1.0)
    x[: n // 3] = np.where(np.arange(n // 3) < n // 6, 1.0, -1.0)
    return Log(to_seconds(ticks), ticks, {"truth.x": x})


def test_chattering_signal_is_drawn_as_range_with_mean():
    log = switching()
    figure = plot_run(log)
    (axes,) = figure.axes
    (band,), (line,) = axes.collections, axes.get_lines()
    box = band.get_paths()[0].get_extents()
    assert (box.y0, box.y1) == (-1.0, 1.0)
    assert box.x0 == pytest.approx(log.t[-1] / 3, abs=log.t[-1] / 50)
    assert box.x1 == pytest.approx(log.t[-1], abs=log.t[-1] / 50)
    t, x = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert np.abs(x[(t > box.x0) & (t < box.x1)] + 0.5).max() < 0.15  # of a column that ends within a period
    assert set(x[t < box.x0]) == {-1.0, 1.0}
    assert CHATTER in [text.get_text() for text in figure.legends[0].get_texts()]


def test_slow_signals_are_not_drawn_as_chatter():
    ticks = np.arange(30_000) * 10_000
    walk = np.cumsum(np.random.default_rng(3).normal(size=len(ticks)))
    slow = np.sin(to_seconds(ticks)) + 0.05 * np.random.default_rng(4).normal(size=len(ticks))
    for log in (switching(every=600), Log(to_seconds(ticks), ticks, {"truth.walk": walk, "truth.slow": slow})):
        figure = plot_run(log)
        assert not any(band.get_label() == CHATTER for axes in figure.axes for band in axes.collections)
        assert CHATTER not in [text.get_text() for text in figure.legends[0].get_texts()]


def test_gap_in_chattering_signal_stays_a_gap():
    log = switching()
    x = log["truth.x"].copy()
    x[20_000:24_000] = np.nan
    (axes,) = plot_run(Log(log.t, log.ticks, {"truth.x": x})).axes
    inside = [path.vertices[:, 0] for path in axes.collections[0].get_paths()]
    assert not any(((t > log.t[20_300]) & (t < log.t[23_700])).any() for t in inside)


def test_second_positional_string_is_the_output_file(tmp_path):
    plot_run(flown(), str(tmp_path / "run.svg"))
    assert [p.name for p in tmp_path.iterdir()] == ["run.svg"]
