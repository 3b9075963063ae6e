"""A vehicle without missions answers mission requests at once, so that clients do not wait."""

import pytest
from flight.station.clients import Master, common

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.missions import MissionResult, MissionService

MISSION, FENCE, RALLY = 0, 1, 2


@pytest.fixture
def master(dialect):
    return Master(dialect, [MissionService(Endpoint(dialect, 1, 1, unsigned=True))])


def test_result_codes_match_the_common_dialect():
    assert MissionResult.ACCEPTED == common.MAV_MISSION_ACCEPTED
    assert MissionResult.UNSUPPORTED == common.MAV_MISSION_UNSUPPORTED
    assert MissionResult.INVALID_SEQUENCE == common.MAV_MISSION_INVALID_SEQUENCE


@pytest.mark.parametrize("kind", [MISSION, FENCE, RALLY])
def test_mission_list_is_empty_and_clearing_is_accepted(master, kind):
    master.mav.mission_request_list_send(1, 1, kind)
    (count,) = master.heard("MISSION_COUNT", 0)
    assert (count.count, count.mission_type, count.target_system, count.target_component) == (0, kind, 255, 190)
    master.mav.mission_clear_all_send(1, 1, kind)
    (done,) = master.heard("MISSION_ACK", 0)
    assert (done.type, done.mission_type) == (MissionResult.ACCEPTED, kind)


@pytest.mark.parametrize(
    ("ask", "result"),
    [
        (lambda mav: mav.mission_count_send(1, 1, 5, FENCE), MissionResult.UNSUPPORTED),
        (lambda mav: mav.mission_count_send(1, 1, 0, FENCE), MissionResult.ACCEPTED),
        (lambda mav: mav.mission_request_int_send(1, 1, 0, MISSION), MissionResult.INVALID_SEQUENCE),
        (lambda mav: mav.mission_request_send(1, 1, 0, MISSION), MissionResult.INVALID_SEQUENCE),
        (lambda mav: mav.mission_write_partial_list_send(1, 1, 0, 1, MISSION), MissionResult.UNSUPPORTED),
        (lambda mav: mav.mission_set_current_send(1, 1, 3), MissionResult.UNSUPPORTED),
        (lambda mav: mav.mission_item_int_send(1, 1, 0, 0, 16, 0, 1, 0, 0, 0, 0, 1, 2, 3), MissionResult.UNSUPPORTED),
    ],
)
def test_mission_requests_are_answered_at_once(master, ask, result):
    ask(master.mav)
    (answer,) = master.heard("MISSION_ACK", 0)
    assert answer.type == result


def test_requests_to_another_vehicle_are_ignored(master):
    master.mav.mission_request_list_send(2, 1, MISSION)
    assert master.heard("MISSION_COUNT") == []
