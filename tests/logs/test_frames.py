"""Messages for maps and 3-D scenes: Foxglove's schemas, poses of the vehicle, and their number."""

import json

import jsonschema
import numpy as np
import pytest
from logs.test_spatial import BODY
from loop.lander import hover
from mcap.reader import make_reader

from trimtab.core.quantity import Quantity
from trimtab.core.record import leaves
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.logs.frames import POSE_COLUMNS, FrameWriter, frame_topics, quaternion, roll_pitch_yaw
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.ring import Ring
from trimtab.logs.stream import start_writer
from trimtab.run.simulate import simulate
from trimtab.vehicles.rigid_body import NO_WRENCH

EPOCH = 1_790_000_000_123_456_700
TOPICS = {"/tf": "foxglove.FrameTransform", "/scene": "foxglove.SceneUpdate", "/location": "foxglove.LocationFix"}
REQUIRED = {
    "foxglove.FrameTransform": "timestamp parent_frame_id child_frame_id translation rotation",
    "foxglove.SceneUpdate": "deletions entities",
    "foxglove.LocationFix": "timestamp frame_id latitude longitude altitude position_covariance"
    " position_covariance_type",
}
"""As published: foxglove-sdk, schemas/jsonschema, in August 2026."""
ENTITY = """timestamp frame_id id lifetime frame_locked metadata arrows cubes spheres cylinders lines triangles texts
    models"""
CUBE, ARROW = "pose size color", "pose shaft_length shaft_diameter head_length head_diameter color"
SIGNALS = [("truth.x", (), np.float64, Quantity("m", "Where it is.", frame="W"))]


def pose(k, place=True):
    where = (0.68, -1.34, 20.0 + k) if place else (np.nan,) * 3
    return (1.0 * k, -2.0, -0.5, 0.1, -0.2, 0.3, *where)


def write(folder, rows=3000, place=True):
    """A log of so many milliseconds, as a flight writes it."""
    ring, path = Ring.create(columns=2 + POSE_COLUMNS), folder / "flight.mcap"
    stream = start_writer(path, ring, signals=SIGNALS, metadata={"scenario": "a"}, frame="vehicle")
    ring.write_text("before the clock")
    stream.set_epoch(EPOCH)
    for k in range(rows):
        ring.write_row(np.array([k * ms(1), 0.5 * k, *pose(k, place)]))
    ring.write_text("at the end")
    assert stream.close() is not None
    ring.close()
    ring.unlink()
    return path


def messages(path):
    """Topic -> (log time, schema, message) of each."""
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, schema, json.loads(message.data)))
    return found


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("log"))


@pytest.mark.thorough
def test_messages_satisfy_own_and_published_foxglove_schemas(log):
    found = messages(log)
    for topic, title in TOPICS.items():
        for time, schema, message in found[topic]:
            assert schema.name == title
            jsonschema.validate(message, json.loads(schema.data))
            assert set(REQUIRED[title].split()) <= set(message)
            stamp = message.get("timestamp") or message["entities"][0]["timestamp"]
            assert stamp["sec"] * 10**9 + stamp["nsec"] == time
    for topic in frame_topics():
        schema = json.loads(topic.text)
        assert set(schema["required"]) == set(REQUIRED[schema["title"]].split())
    (entity,) = found["/scene"][0][2]["entities"]
    assert set(entity) == set(ENTITY.split())
    assert set(entity["cubes"][0]) == set(CUBE.split())
    assert set(entity["arrows"][0]) == set(ARROW.split())
    assert entity["frame_locked"]


@pytest.mark.thorough
def test_poses_are_thinned_and_stamped_with_wall_clock_time(log):
    found = messages(log)
    (world, *moves) = found["/tf"]
    assert (world[2]["parent_frame_id"], world[2]["child_frame_id"]) == ("map", "world")
    assert [time for time, _, _ in moves] == [EPOCH + 50_000_000 * k for k in range(60)]
    assert [m["translation"]["x"] for _, _, m in moves] == [50.0 * k for k in range(60)]
    assert len(found["/location"]) == 15
    assert len(found["/scene"]) == 1
    last = found["/location"][-1][2]
    assert last["latitude"] == pytest.approx(np.degrees(0.68), abs=1e-9)
    assert last["altitude"] == 2820.0


def test_rows_and_epoch_are_read_back_beside_frames(log):
    read = read_mcap(log)
    assert read.ticks.tolist() == [k * ms(1) for k in range(3000)]
    assert (read["truth.x"] == 0.5 * np.arange(3000)).all()
    assert read.metadata["epoch_ns"] == EPOCH
    events = [(round(e["t"], 7), e["text"]) for e in read.metadata["events"]]
    assert events == [(0.0, "before the clock"), (2.999, "at the end")]
    assert list(read.paths) == ["truth.x", "log.dropped", "log.unwritten"]
    assert messages(log)["/truth"][7][0] == EPOCH + 7_000_000


def test_truncated_log_keeps_its_epoch(log, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    read = read_mcap(cut)
    assert (read.metadata["epoch_ns"], read.metadata["truncated"]) == (EPOCH, True)
    assert read.ticks.tolist() == [k * ms(1) for k in range(len(read))]


def test_log_without_origin_has_poses_but_no_location(tmp_path):
    found = messages(write(tmp_path, 200, place=False))
    assert "/location" not in found
    assert len(found["/tf"]) == 5


def test_nan_poses_give_no_messages():
    writer = FrameWriter("vehicle")
    assert writer.messages(np.array([0, seconds(1)]), np.full((2, POSE_COLUMNS), np.nan), 0) == []


def test_quaternions_match_scipy_and_map_frame_is_enu():
    from scipy.spatial.transform import Rotation

    attitude = (0.3, -0.4, 2.0)
    w, x, y, z = quaternion(attitude)
    expected = Rotation.from_euler("ZYX", attitude[::-1]).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), expected, atol=1e-12)
    message = json.loads(FrameWriter("v").messages(np.array([0]), np.array([pose(0)]), 0)[0].text)
    turn = Rotation.from_quat([message["rotation"][k] for k in "xyzw"])
    np.testing.assert_allclose(turn.apply([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0], atol=1e-12)


@pytest.mark.thorough
def test_frame_messages_add_under_two_percent_to_file_size(tmp_path):
    """The comparison is a log with rows of a hundred changing numbers."""
    sizes, rng = [], np.random.default_rng(1)
    names = [(f"truth.n{k}", (), np.float64, None) for k in range(100)]
    walk = np.cumsum(rng.standard_normal((2000, 100)), axis=0)
    for frame in ("", "vehicle"):
        columns = 101 + (POSE_COLUMNS if frame else 0)
        ring, path = Ring.create(columns=columns), tmp_path / f"a{frame}.mcap"
        stream = start_writer(path, ring, signals=names, metadata={}, frame=frame)
        if frame:
            stream.set_epoch(EPOCH)
        for k in range(2000):
            ring.write_row(np.array([k * ms(1), *walk[k], *(pose(k) if frame else ())]))
        stream.close()
        ring.close()
        ring.unlink()
        sizes.append(path.stat().st_size)
    assert sizes[1] < 1.02 * sizes[0]


def test_quaternion_to_euler_round_trip():
    for q in np.random.default_rng(5).normal(size=(20, 4)):
        again = np.array(quaternion(roll_pitch_yaw(q)))
        assert abs(again @ q) == pytest.approx(np.linalg.norm(q), rel=1e-9)
    assert np.isnan(roll_pitch_yaw([0.0] * 4)).all()
    assert np.isnan(roll_pitch_yaw([np.nan] * 4)).all()


@pytest.mark.thorough
def test_simulated_spatial_flight_has_matching_poses(tmp_path):
    log = simulate(hover(), log_period=ms(10), backend="jax")
    found = messages(write_mcap(log, tmp_path / "run.mcap"))
    (first, _, fixed), *moving = found["/tf"]
    assert (first, fixed["parent_frame_id"], fixed["child_frame_id"]) == (0, "map", "world")
    assert [t for t, _, _ in moving] == sorted(t for t, _, _ in moving)
    assert len(moving) == pytest.approx(20 * 4, abs=1)
    t, _, last = moving[-1]
    k = int(np.searchsorted(log.ticks, t // 100))
    assert last["translation"] == pytest.approx(dict(zip("xyz", log["truth.r"][k], strict=True)), abs=1e-4)
    q = np.array([last["rotation"][n] for n in "wxyz"])
    assert abs(q @ log["truth.q"][k]) == pytest.approx(1, abs=1e-6)
    assert "/location" not in found
    assert len(found["/scene"]) == 1
    again = read_mcap(tmp_path / "run.mcap")
    assert again.paths == log.paths
    assert all(np.array_equal(again[p], log[p]) for p in log.paths)


@pytest.mark.thorough
def test_rotating_earth_flight_has_its_geodetic_location(tmp_path):
    start = BODY.start(
        0.7, -1.1, 2e3, velocity=[100.0, 50, 0], angles=[0.1, 0.2, 0.3], rate=[0, 0, 0], over_ground=True
    )
    ticks = np.array([0])
    signals = {f"truth.{p}": np.asarray(v)[None] for p, v, _ in leaves(start)}
    declared = {f"truth.{p}": d for p, _, d in leaves(start)}
    parameters = {f"world.vehicle.{p}": np.asarray(v).tolist() for p, v, _ in leaves(BODY)}
    log = Log(to_seconds(ticks), ticks, signals, declared, {"parameters": parameters})
    found = messages(write_mcap(log, tmp_path / "run.mcap"))
    place = found["/location"][0][2]
    assert (place["latitude"], place["longitude"]) == pytest.approx(np.rad2deg([0.7, -1.1]), abs=1e-8)
    assert place["altitude"] == pytest.approx(2e3, abs=1e-3)
    motion = BODY.motion(0, start, NO_WRENCH)
    pose = found["/tf"][1][2]
    assert list(pose["translation"].values()) == pytest.approx(np.asarray(motion.p_WB), abs=1e-3)
    want = np.array(quaternion(np.asarray(motion.attitude).tolist()))
    assert abs(want @ [pose["rotation"][n] for n in "wxyz"]) == pytest.approx(1, abs=1e-6)


def test_scalar_euler_angles_give_poses(tmp_path):
    t = to_seconds(np.array([0]))
    numbers = {"roll": 0.1, "pitch": -0.2, "yaw": 0.3, "north": 4.0, "east": 5.0, "altitude": 60.0}
    log = Log(t, np.array([0]), {f"truth.{n}": np.array([x]) for n, x in numbers.items()})
    pose = messages(write_mcap(log, tmp_path / "run.mcap"))["/tf"][1][2]
    assert pose["translation"] == {"x": 4.0, "y": 5.0, "z": -60.0}
    assert [pose["rotation"][n] for n in "wxyz"] == pytest.approx(quaternion((0.1, -0.2, 0.3)), abs=1e-6)
