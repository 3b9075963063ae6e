"""A vehicle's world frame on the globe: positions against the ellipsoid's radii of curvature; changes of origin."""

import math

import pytest
from flight.station.clients import Master, common

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.flight.globe import Globe, parse_origin
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.streams import Streams, TelemetryStream
from trimtab.flight.station.telemetry import VehicleMotion

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
COLLEGE_PARK = "38.9897,-76.9378,20"
A, E2 = 6378137.0, 0.00669437999014
"""WGS84: semi-major axis (m), eccentricity squared."""
MOTION = VehicleMotion((120.0, -50.0, -3.0), (0.1, -0.2, math.radians(-30)), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
SECOND = 10_000_000


class Craft:
    """A moving vehicle, seen by pymavlink through a station."""

    def __init__(self, dialect, origin=None):
        self.motion = MOTION
        endpoint = Endpoint(dialect, 1, 1, unsigned=True)
        self.globe = Globe(endpoint, lambda: self.motion, None if origin is None else parse_origin(origin))
        told = {"GLOBAL_POSITION_INT": self.globe.position_fields, "HOME_POSITION": self.globe.home_fields}
        told |= {"GPS_GLOBAL_ORIGIN": self.globe.origin_fields}
        streams = Streams(endpoint, {name: TelemetryStream(fields, SECOND) for name, fields in told.items()})
        self.master = Master(dialect, [self.globe], streams=streams)
        self.master.mav.heartbeat_send(6, 8, 0, 0, 0)

    def ask(self, name):
        number = getattr(common, f"MAVLINK_MSG_ID_{name}")
        self.master.mav.command_long_send(1, 1, 512, 0, number, 0, 0, 0, 0, 0, 0)
        return self.master.recv_match(name, timeout=0.001)


@pytest.fixture
def craft(dialect):
    return Craft(dialect, COLLEGE_PARK)


@pytest.fixture
def dialect():
    from flight.mavlink.conftest import made

    return made()


def test_global_position_matches_ellipsoid_radii_of_curvature(craft):
    seen = craft.ask("GLOBAL_POSITION_INT")
    latitude = math.radians(38.9897)
    w = 1 - E2 * math.sin(latitude) ** 2
    meridian, transverse = A * (1 - E2) / w**1.5, A / math.sqrt(w)
    north = math.degrees(120.0 / (meridian + 20))
    east = math.degrees(-50.0 / ((transverse + 20) * math.cos(latitude)))
    assert seen.lat == pytest.approx((38.9897 + north) * 1e7, abs=1)  # a unit is a centimetre
    assert seen.lon == pytest.approx((-76.9378 + east) * 1e7, abs=1)
    assert (seen.alt, seen.relative_alt) == (23_001, 0)  # the plane touches the globe: 1.3 mm at 130 m
    assert seen.hdg == 33_000
    speed = math.sqrt(seen.vx**2 + seen.vy**2 + seen.vz**2)
    assert speed == pytest.approx(200, abs=1)
    assert seen.vz == pytest.approx(200 * math.sin(0.2), abs=1)  # nose down, so it goes down


def test_home_is_the_marked_position_and_height_reference(craft):
    craft.globe.mark_home()
    craft.motion = MOTION._replace(p_WB=(500.0, 0.0, -13.0))
    home, seen = craft.ask("HOME_POSITION"), craft.ask("GLOBAL_POSITION_INT")
    assert (home.x, home.y, home.z) == (120.0, -50.0, -3.0)
    assert home.altitude == 23_001
    assert seen.relative_alt == 10_000
    assert math.isnan(home.approach_x)
    w, x, y, z = home.q
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(math.radians(-30))
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(-0.2)


def test_get_home_position_is_answered(craft):
    craft.master.mav.command_long_send(1, 1, 410, 0, 0, 0, 0, 0, 0, 0, 0)
    names = [m.get_type() for m in craft.master._queue]
    assert "HOME_POSITION" in names
    assert "COMMAND_ACK" in names


def test_no_global_position_until_a_station_sets_origin(dialect):
    craft = Craft(dialect)
    assert craft.ask("GLOBAL_POSITION_INT") is None
    assert craft.master.heard("GLOBAL_POSITION_INT", 3000) == []
    craft.master.mav.set_gps_global_origin_send(1, 389_897_000, -769_378_000, 20_000)
    (told,) = craft.master.heard("GPS_GLOBAL_ORIGIN", 0)
    assert (told.latitude, told.longitude, told.altitude) == (389_897_000, -769_378_000, 20_000)
    assert craft.ask("GLOBAL_POSITION_INT").lat == Craft(dialect, COLLEGE_PARK).ask("GLOBAL_POSITION_INT").lat


@pytest.mark.parametrize(("latitude", "is_armed", "why"), [(0, True, "armed"), (900_000_001, False, "out of range")])
def test_rejects_origin_while_armed_or_out_of_range(craft, latitude, is_armed, why):
    craft.master.fly(is_armed)
    craft.master.mav.set_gps_global_origin_send(1, latitude, 0, 0)
    answers = list(craft.master._queue)
    assert [m.latitude for m in answers if m.get_type() == "GPS_GLOBAL_ORIGIN"] == [389_897_000]
    assert [why in m.text for m in answers if m.get_type() == "STATUSTEXT"] == [True]


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "north,2,3", "91,0,0", "0,181,0", "nan,0,0", "0,0,inf"])
def test_rejects_invalid_origin_text(text):
    with pytest.raises(InputError, match="origin"):
        parse_origin(text)
