"""The first message to a page: the view of a craft, derived from the available signals."""

import re
from importlib.resources import files

from trimtab.console.hello import describe_view, list_set_points, shorten_hash
from trimtab.scenarios.build import build

PLANAR = ("surge_velocity", "sway_velocity", "yaw_rate", "heading")
SIDE = ("h", "V", "alpha")


def paths(prefix, *names):
    return [f"{prefix}.{name}" for name in names]


def test_planar_view_with_and_without_position():
    estimate = paths("estimate.state", *PLANAR)
    view = describe_view(estimate, None)
    assert (view["kind"], view["pose"]) == (
        "planar",
        {"north": None, "east": None, "heading": "estimate.state.heading"},
    )
    assert (view["truth"], view["covariance"], view["beacons"], view["fence"]) == (None, None, [], None)
    recorded = describe_view([*estimate, *paths("truth", "north", "east", "heading")], None)
    assert recorded["pose"] == {"north": "truth.north", "east": "truth.east", "heading": "estimate.state.heading"}
    known = [*estimate, *paths("estimate.state", "north", "east", "sigma_north", "sigma_east")]
    view = describe_view([*known, *paths("truth", "north", "east", "heading")], None)
    assert view["pose"]["north"] == "estimate.state.north"
    assert view["truth"]["east"] == "truth.east"
    assert view["covariance"] == {"nn": "estimate.state.sigma_north", "ee": "estimate.state.sigma_east"}


def test_planar_view_includes_hall_of_the_scenario():
    scenario = build("hovercraft/pilot", {"navigation": "ins", "supervisor": "automatic"})
    view = describe_view(paths("estimate.state", *PLANAR), scenario)
    assert len(view["beacons"]) > 10
    assert view["fence"] == {"north": [-15.0, 25.0], "east": [-15.0, 25.0]}
    assert view["length"] == 2 * 0.32


def test_side_view_uses_truth_or_estimate():
    modes = ("eta1", "eta2")
    view = describe_view([*paths("truth", *SIDE, "theta", *modes), *paths("estimate.state", *SIDE, *modes)], None)
    assert view["attitude"] == {"alpha": "truth.alpha", "theta": "truth.theta"}
    assert (view["altitude"], view["speed"]) == ("truth.h", "truth.V")
    assert (view["modes"]["eta1"], view["estimated"]["eta1"]) == ("truth.eta1", "estimate.state.eta1")
    view = describe_view(paths("estimate.state", *SIDE, "h_rate", *modes), None)
    assert view["attitude"] == {"alpha": "estimate.state.alpha", "climb": "estimate.state.h_rate"}
    assert (view["modes"]["eta2"], view["estimated"]) == ("estimate.state.eta2", None)


def test_spatial_view_uses_derived_angles():
    known = [*paths("flight", "roll", "pitch", "yaw"), *paths("estimate.state", *PLANAR)]
    view = describe_view(known, None)
    assert (view["kind"], view["plan"], view["altitude"]) == ("spatial", None, None)
    assert view["attitude"] == {"roll": "flight.roll", "pitch": "flight.pitch", "yaw": "flight.yaw"}
    view = describe_view([*known, *paths("flight", "north", "east", "altitude", "climb")], None)
    assert view["plan"]["pose"] == {"north": "flight.north", "east": "flight.east", "heading": "flight.yaw"}
    assert (view["altitude"], view["climb"], view["air_speed"]) == ("flight.altitude", "flight.climb", None)


def test_unknown_vehicle_gets_the_plain_view():
    assert describe_view(["estimate.state.x"], None) == {"kind": "plain"}


def test_page_reads_the_keys_of_each_view():
    """The keys of a view in Python and in the page must be the same."""
    folder = files("trimtab.console") / "page"
    estimate = [*paths("estimate.state", *PLANAR), *paths("estimate.state", *SIDE, "h_rate")]
    space = describe_view(paths("flight", "roll", "pitch", "yaw", "north", "east"), None)
    assert set(space["plan"]) == set(describe_view(estimate, None)) - {"kind"}
    views = {"planar": describe_view(estimate, None), "longitudinal": describe_view(estimate[4:], None)}
    for name, view in (views | {"spatial": space}).items():
        text = (folder / f"view_{name}.js").read_text(encoding="utf-8")
        read = set(re.findall(r"\bview\.([a-z_]+)", text))
        assert view["kind"] == name
        assert read
        assert read <= set(view), read - set(view)


def test_set_points_apply_to_truth_and_estimate():
    scenario = build("hovercraft/forward")
    known = ["truth.surge_velocity", "estimate.state.surge_velocity", "estimate.state.h", "law.h_reference"]
    found = list_set_points(scenario, known)
    assert abs(found["truth.surge_velocity"] - 2.8 / 2.6) < 1e-9
    assert found["estimate.state.surge_velocity"] == found["truth.surge_velocity"]
    assert found["estimate.state.h"] == "law.h_reference"


def test_calibration_is_named_by_its_hash():
    assert shorten_hash({"calibration": {"sha256": "0123456789abcdef"}}) == "01234567"
    assert shorten_hash({"scenario": "a"}) == ""
    assert shorten_hash(()) == ""
