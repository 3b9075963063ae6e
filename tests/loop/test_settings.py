"""Values with units after --set, and the three parameters of a link."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import leaves
from trimtab.links.latency import MeasuredLatency, interpolate_latency
from trimtab.loop.settings import setting_paths, texts_of, with_settings
from trimtab.scenarios.build import build

NAME = "hovercraft/forward"


@pytest.fixture(scope="module")
def forward():
    return build(NAME)


def read(scenario, path):
    return next(value for p, value, _ in leaves(scenario) if p == path)


@pytest.mark.parametrize(
    ("path", "text", "value"),
    [
        ("world.vehicle.mass", "3 kg", 3.0),
        ("world.vehicle.mass", "3000g", 3.0),
        ("world.vehicle.mass", "3e0", 3.0),
        ("world.vehicle.mass", " 2.5e-1 kg ", 0.25),
        ("world.vehicle.arm", "32 cm", 0.32),
        ("initial.heading", "90 deg", np.pi / 2),
        ("initial.heading", "-90°", -np.pi / 2),
        ("initial.surge_velocity", "3.6 km/h", 1.0),
        ("autopilot.law.k1", "2 kg/s", 2.0),
        ("autopilot.period", "20 ms", 200_000),
    ],
)
def test_values_accept_units(path, text, value, forward):
    assert read(with_settings(forward, {path: text}), path) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("true", "must be a number, got true"),
        ("false", "must be a number, got false"),
        ("1" + 400 * "0", r"larger than 1\.8e\+308"),
        ("-1" + 400 * "0", r"larger than 1\.8e\+308"),
        ("5e-324", "smaller than any normal number"),
        ("-1e-310", "smaller than any normal number"),
    ],
)
def test_rejects_values_beyond_64_bits(text, says, forward):
    with pytest.raises(InputError, match=f"world.vehicle.mass: .*{says}"):
        with_settings(forward, {"world.vehicle.mass": text})


def test_array_element_is_set_by_its_index():
    quadrotor, path = build("quadrotor/track"), "world.vehicle.rotors.places"
    own, changed = (read(s, path) for s in (quadrotor, with_settings(quadrotor, {f"{path}[2,0]": "-32 cm"})))
    assert (own[2, 0], changed[2, 0]) == (-0.315, -0.32)
    np.testing.assert_array_equal(np.delete(changed, 6), np.delete(own, 6))
    for wrong, says, fix in (
        (f"{path}[2]", r"has shape \(4, 3\)", f'settings={{"{path}[0,0]": '),
        ("world.vehicle.mass[0]", r"has shape \(\)", 'settings={"world.vehicle.mass": '),
        ("autopilot.period[0]", "not an array of numbers", 'settings={"autopilot.period": '),
    ):
        with pytest.raises(InputError, match=says) as refused:
            with_settings(quadrotor, {wrong: "1"})
        assert refused.value.fix.startswith(fix)


@pytest.mark.parametrize(
    ("path", "text", "says"),
    [
        ("world.vehicle.mass", "3 m", "unit is kg"),
        ("world.vehicle.mass", "3 stone", "unit is kg"),
        ("world.vehicle.mass", "kg", "is not a number"),
        ("initial.heading", "1 rad/s", "unit is rad"),
    ],
)
def test_wrong_unit_is_rejected_with_a_fitting_suggestion(path, text, says, forward):
    with pytest.raises(InputError, match=says) as refused:
        with_settings(forward, {path: text})
    assert f'settings={{"{path}": ' in refused.value.fix


def test_setting_paths_include_every_leaf_and_absent_parts(forward):
    paths = setting_paths(forward)
    assert {p for p, _, _ in leaves(forward)} < set(paths)
    assert "world.vehicle.friction.torque_viscous" in paths


def test_link_delay_jitter_and_loss_are_set_by_name():
    settings = {"downlink.delay": "80 ms", "downlink.jitter": "0.02", "downlink.loss": "5 %"}
    link = build(NAME, settings).world.downlink
    assert isinstance(link, MeasuredLatency)
    assert float(link.loss) == pytest.approx(0.05)
    spread = np.asarray(interpolate_latency(link.latency, np.array([-6.0, 0.0, 6.0])))
    np.testing.assert_allclose(spread, [0.08, 0.09, 0.1], atol=2e-4)


@pytest.mark.parametrize(
    ("path", "text"),
    [("uplink.delay", "soon"), ("uplink.delay", "-1 ms"), ("uplink.loss", "120 %"), ("uplink.loss", "x")],
)
def test_rejects_invalid_link_parameters(path, text):
    with pytest.raises(InputError, match=path):
        build(NAME, {path: text})


def test_predictor_uses_the_uplink_delay_setting():
    without, late = (
        build(NAME, {"predictor": "on"} | more).autopilot.predictor for more in ({}, {"uplink.delay": "120 ms"})
    )
    assert float(late.uplink_delay) == pytest.approx(0.12)
    assert float(late.uplink_delay) > float(without.uplink_delay)


@pytest.mark.parametrize(
    ("path", "value"), [("world.vehicle.mass", 3), ("world.vehicle.mass", np.float64(3)), ("duration", 3)]
)
def test_settings_accept_numbers_and_texts_alike(path, value, forward):
    assert read(with_settings(forward, {path: value}), path) == read(with_settings(forward, {path: "3"}), path)
    assert read(build(NAME, {path: value}), path) == read(build(NAME, {path: "3"}), path)


def test_setting_values_are_written_as_typed():
    given = {"a": 3, "b": [1, 2.5], "c": True, "d": "3 kg", "e": np.array([1.0, 2.0])}
    assert texts_of(given) == {"a": "3", "b": "[1.0, 2.5]", "c": "true", "d": "3 kg", "e": "[1.0, 2.0]"}
