import numpy as np
import pytest
from flight.mavlink.line import every

from trimtab.core.signals import Command, Frame
from trimtab.flight.mavlink.authority import (
    MOST_SESSIONS,
    Authority,
    Sender,
    command_sender,
    draw_session,
    parse_session,
)
from trimtab.flight.mavlink.dialect import derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key

FIRST, SECOND, OLD = Sender(1, 191, 11), Sender(1, 191, 12), Sender(1, 191, 0)
STATION = Sender(255, 190, 0)


def test_session_numbers_survive_float32_command_parameters():
    drawn = {draw_session() for _ in range(200)}
    assert len(drawn) > 190
    assert all(parse_session(float(np.float32(s))) == s > 0 for s in drawn)
    assert [parse_session(n) for n in (0.0, -1.0, 0.5, float("nan"), float("inf"), MOST_SESSIONS)] == [0] * 6


def test_only_the_arming_sender_may_command():
    authority = Authority(5)
    assert authority.accepts_command(SECOND)  # nothing acts yet, and nobody has it
    authority.arm(FIRST)
    assert authority.accepts_command(FIRST)
    assert not any(authority.accepts_command(s) for s in (SECOND, OLD, Sender(7, 1, 11)))
    assert authority.refused_commands == 3
    assert authority.find_arming_problem(SECOND) == f"vehicle belongs to {FIRST}"
    assert authority.find_disarming_problem(SECOND)
    assert not authority.find_disarming_problem(FIRST)
    assert not authority.find_disarming_problem(STATION)  # a person's hand
    authority.arm(STATION)  # what is armed already does not change hands
    assert authority.owner == FIRST
    authority.end_flight()
    assert not authority.find_arming_problem(SECOND)


def test_first_commander_owns_vehicle_armed_by_ground_station():
    authority = Authority(5)
    authority.arm(STATION)
    assert [authority.accepts_command(s) for s in (SECOND, FIRST, SECOND)] == [True, False, True]


def test_other_system_cannot_command_vehicle_armed_by_station():
    authority = Authority(5, system=1)
    authority.arm(STATION)
    assert not authority.accepts_command(Sender(7, 191, 12))
    assert authority.accepts_command(FIRST)
    assert not authority.accepts_command(Sender(7, 191, 12))
    assert authority.refused_commands == 2


def test_copied_session_is_rejected_on_another_stream():
    authority = Authority(5)
    authority.arm(FIRST)
    thief = FIRST._replace(link=9)
    assert not authority.accepts_command(thief)
    assert authority.find_arming_problem(thief)
    assert str(thief) == "1/191 session 00000b link 9"


def test_takeover_transfers_authority():
    authority = Authority(5)
    authority.arm(FIRST)
    assert authority.take_over(SECOND) == FIRST
    assert [authority.accepts_command(s) for s in (FIRST, SECOND)] == [False, True]


def test_vehicle_is_addressed_by_own_session_or_zero():
    assert [Authority(5).is_addressed(s) for s in (0, 5, 6)] == [True, True, False]


@pytest.mark.parametrize("told", [False, True])
def test_session_is_an_extension_field_of_the_command(told):
    """A sender without the extension packs the same message, and its session reads as zero."""
    dialect = derive_dialect(Frame(t=np.int64(0), samples={}), Command(t=np.int64(0), valid=False, value=every()))
    definition = dialect.definitions["COMMAND"]
    assert definition.size == definition.base + 4
    assert "session" not in [p.path for p in dialect.places["COMMAND"]]
    here, there = Endpoint(dialect, 1, 191, unsigned=True), Endpoint(dialect, 1, 1, unsigned=True)
    (message,) = there.feed(here.pack("COMMAND", {"t": 3} | ({"session": 77} if told else {})))
    assert command_sender(message) == Sender(1, 191, 77 if told else 0)


def test_sender_of_a_signed_command_includes_its_link():
    dialect = derive_dialect(Frame(t=np.int64(0), samples={}), Command(t=np.int64(0), valid=False, value=every()))
    key = passphrase_key("correct-horse-battery-staple")
    here, there = Endpoint(dialect, 1, 191, key, link=7), Endpoint(dialect, 1, 1, key)
    here.feed(there.pack("HEARTBEAT"))
    (message,) = there.feed(here.pack("COMMAND", {"session": 77}))
    assert command_sender(message) == Sender(1, 191, 77, 7)
