"""Roll, pitch, yaw, altitude and speeds from a log, compared with the vehicle models."""

import jax.numpy as jnp
import numpy as np
import pytest
from loop.lander import hover
from scipy.spatial.transform import Rotation

from trimtab.core.quantity import Quantity
from trimtab.core.record import leaves, replace
from trimtab.core.time import seconds, to_seconds
from trimtab.environment.geodetic import TangentPlane
from trimtab.environment.wind import Wind
from trimtab.logs.log import Log
from trimtab.logs.spatial import euler_angles, find_logged_flight, flight_sources, rotation_matrices, with_flight
from trimtab.run.simulate import simulate
from trimtab.vehicles.rigid_body import NO_WRENCH, RigidBody

BODY = RigidBody(wind=Wind(4.0, -3.0, 1e-3, 2e-3), origin=TangentPlane(0.6, -1.2, 30.0))


def over_the_earth() -> tuple[Log, list]:
    """A few states of a rigid body anywhere above the earth, as a log, and the states."""
    rng, times = np.random.default_rng(3), np.array([0.0, 7.5, 900.0, 4000.0])
    states = [
        BODY.start(
            *(rng.uniform(-1.4, 1.4), rng.uniform(-3, 3), rng.uniform(0, 4e5)),
            velocity=rng.normal(size=3) * 300,
            angles=rng.uniform(-1.5, 1.5, 3),
            rate=rng.normal(size=3),
            over_ground=True,
        )
        for _ in times
    ]
    signals = {f"truth.{p}": np.stack([np.asarray(getattr(x, p)) for x in states]) for p, _, _ in leaves(states[0])}
    declared = {f"truth.{p}": d for p, _, d in leaves(states[0]) if isinstance(d, Quantity)}
    parameters = {f"world.vehicle.{p}": np.asarray(v).tolist() for p, v, _ in leaves(BODY)}
    ticks = np.round(times * 1e7).astype(np.int64)
    return Log(to_seconds(ticks), ticks, signals, declared, {"parameters": parameters}), states


@pytest.mark.thorough
def test_rotating_earth_flight_matches_the_body_model():
    log, states = over_the_earth()
    flight = with_flight(log)
    for k, (t, x) in enumerate(zip(log.t, states, strict=True)):
        said = BODY.flight(t, x)
        roll, pitch, yaw = np.asarray(said.angles)
        assert np.cos(flight["flight.roll"][k] - roll) == pytest.approx(1, abs=1e-12)
        assert flight["flight.pitch"][k] == pytest.approx(pitch, abs=1e-9)
        assert np.cos(flight["flight.yaw"][k] - yaw) == pytest.approx(1, abs=1e-12)
        assert flight["flight.altitude"][k] == pytest.approx(float(said.height), abs=1e-6)
        assert flight["flight.ground_speed"][k] == pytest.approx(np.hypot(*np.asarray(said.velocity[:2])), rel=1e-9)
        assert flight["flight.climb"][k] == pytest.approx(-float(said.velocity[2]), abs=1e-6)
        assert flight["flight.air_speed"][k] == pytest.approx(float(said.flow.speed), rel=1e-9)
        place = np.asarray(BODY.motion(log.ticks[k], x, NO_WRENCH).p_WB)
        got = [flight[f"flight.{name}"][k] for name in ("north", "east")]
        np.testing.assert_allclose(got, place[:2], atol=1e-4)


@pytest.mark.thorough
def test_origin_and_earth_rate_come_from_the_metadata():
    log, _ = over_the_earth()
    parameters = dict(log.metadata["parameters"])
    other = replace_metadata(log, {"parameters": parameters | {"world.vehicle.origin.latitude": 0.5}})
    assert abs(with_flight(other)["flight.north"] - with_flight(log)["flight.north"]).min() > 1e3
    still = replace_metadata(log, {"parameters": parameters | {"world.vehicle.earth.rate": 0.0}})
    assert abs(with_flight(still)["flight.ground_speed"] - with_flight(log)["flight.ground_speed"]).max() > 10


def replace_metadata(log: Log, metadata: dict) -> Log:
    return Log(log.t, log.ticks, dict(log.signals), log.declarations, metadata)


def test_euler_angles_match_scipy_for_unnormalised_quaternions():
    q = np.random.default_rng(1).normal(size=(50, 4))
    R = rotation_matrices(q)
    np.testing.assert_allclose(R, Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix(), atol=1e-12)
    got = np.stack(euler_angles(R), axis=1)
    want = Rotation.from_matrix(R).as_euler("ZYX")[:, ::-1]
    np.testing.assert_allclose(np.exp(1j * got), np.exp(1j * want), atol=1e-9)


@pytest.mark.thorough
def test_yaw_is_continuous_and_final_values_match():
    log = simulate(replace(hover(), duration=seconds(9)), backend="jax")
    flight = with_flight(log)
    np.testing.assert_allclose(flight["flight.yaw"], log.t, atol=1e-6)  # a radian a second, through more than a turn
    np.testing.assert_allclose(flight["flight.altitude"], log["truth.altitude"], atol=1e-9)
    assert flight.final["flight.yaw"] == pytest.approx(9.0, abs=1e-6)
    assert flight.final["flight.altitude"] == pytest.approx(float(log.final["truth.altitude"]))
    speed = np.hypot(*log["truth.v"].T[:2])
    np.testing.assert_allclose(flight["flight.ground_speed"], speed, atol=1e-12)
    assert flight.unit("flight.yaw") == "rad"
    assert flight.paths[-len(log.paths) :] == log.paths
    assert with_flight(flight) is flight


def test_body_velocity_is_rotated_to_the_world_frame():
    ticks = np.arange(2) * 10_000
    up = np.deg2rad(30) / 2
    turned = np.array([[np.cos(up), 0, np.sin(up), 0]] * 2)  # nose up by 30 degrees
    declared = {
        "truth.q": Quantity("1", "Attitude.", "WB", shape=(4,)),
        "truth.v": Quantity("m/s", "Velocity.", "B", shape=(3,)),
    }
    signals = {"truth.q": turned, "truth.v": np.array([[2.0, 0.0, 0.0]] * 2)}
    flight = with_flight(Log(to_seconds(ticks), ticks, signals, declared))
    assert flight["flight.pitch"] == pytest.approx(np.pi / 6)
    assert flight["flight.ground_speed"] == pytest.approx(np.sqrt(3))
    assert flight["flight.climb"] == pytest.approx(1.0)
    assert "flight.altitude" not in flight


def test_planar_vehicle_log_is_unchanged():
    ticks = np.arange(3) * 10_000
    log = Log(to_seconds(ticks), ticks, {"truth.heading": np.zeros(3), "truth.quartet": np.zeros((3, 4))})
    assert find_logged_flight(log) is None
    assert with_flight(log) is log


@pytest.mark.thorough
def test_diverged_flight_gives_nan_angles_without_error():
    log = simulate(hover(), backend="jax")
    q = np.array(log["truth.q"])
    q[len(q) // 2 :] = np.nan
    lost = with_flight(Log(log.t, log.ticks, dict(log.signals) | {"truth.q": q}, log.declarations))
    assert np.isnan(lost["flight.roll"][-1])
    assert np.isfinite(lost["flight.roll"][0])
    assert jnp.isfinite(lost["flight.altitude"]).all()


def test_scalar_euler_angles_are_recognised_by_name():
    ticks = np.arange(0, 40_000_000, 100_000)
    t = to_seconds(ticks)
    yaw = np.angle(np.exp(2j * t))  # wrapped
    numbers = {"roll": 0.1 * t, "pitch": 0 * t, "yaw": yaw, "north": 3 * t, "east": 4 * t, "altitude": 100 - 2 * t}
    log = Log(t, ticks, {f"truth.{n}": x for n, x in numbers.items()} | {"truth.power": t})
    flight = with_flight(log)
    np.testing.assert_allclose(flight["flight.yaw"], 2 * t, atol=1e-9)
    np.testing.assert_allclose(flight["flight.ground_speed"], 5.0, rtol=1e-9)
    np.testing.assert_allclose(flight["flight.climb"], -2.0, rtol=1e-9)
    assert flight_sources(log) == {f"truth.{n}" for n in numbers}
    assert "flight.air_speed" not in flight
    bare = Log(t, ticks, {"truth.pitch": t, "truth.altitude": t})  # in the vertical plane
    assert with_flight(bare) is bare
