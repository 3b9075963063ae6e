"""Settings that weaken a safety function prevent arming unless they are confirmed by name."""

import math

import pytest
from click.testing import CliRunner

from trimtab.actuators.drive import drive_failsafe
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.flight.safety_settings import LIMITS, check_confirmations, safety_checks
from trimtab.loop.vehicle_limits import VehicleLimits

SHIPPED = drive_failsafe(), VehicleLimits(), ms(50)


def failing(failsafe, limits, watchdog, confirmed=()):
    return [check.name for check in safety_checks(failsafe, limits, watchdog, confirmed) if not check.passes]


def test_default_settings_need_no_confirmation():
    assert failing(*SHIPPED) == []
    assert [check.name for check in safety_checks(*SHIPPED)] == list(LIMITS)
    assert failing(*SHIPPED[:2], None) == []  # no outputs' process, no watchdog


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("watchdog", (*SHIPPED[:2], seconds(86_400))),
        ("failsafe.timeout", (replace(SHIPPED[0], timeout=seconds("9.9")), *SHIPPED[1:])),
        ("failsafe.lift_delay", (replace(SHIPPED[0], lift_delay=seconds(1_000_000)), *SHIPPED[1:])),
        ("failsafe.patience", (replace(SHIPPED[0], patience=seconds(3600)), *SHIPPED[1:])),
        ("limits.patience", (SHIPPED[0], VehicleLimits(patience=seconds(60)), SHIPPED[2])),
        ("limits.rest_speed", (SHIPPED[0], VehicleLimits(rest_speed=1e9), SHIPPED[2])),
        ("limits.rest_rate", (SHIPPED[0], VehicleLimits(rest_rate=math.inf), SHIPPED[2])),
    ],
)
def test_setting_beyond_limit_fails_until_confirmed_by_name(name, changed):
    assert failing(*changed) == [name]
    (check,) = [check for check in safety_checks(*changed) if check.name == name]
    assert f"--confirm {name}" in check.sentence
    assert not check.heals
    assert failing(*changed, check_confirmations([name])) == []
    other = next(one for one in LIMITS if one != name)
    assert failing(*changed, check_confirmations([other])) == [name]


def test_rejects_unknown_confirmation_and_suggests_the_nearest():
    with pytest.raises(InputError, match=r"'failsafe.time' is not a setting(.|\n)*Fix: confirm=.failsafe.timeout"):
        check_confirmations(["failsafe.time"])
    done = CliRunner().invoke(main, ["vehicle", "hovercraft/spin", "--listen", "loopback://x", "--confirm", "fence"])
    assert done.exit_code == 2
    assert "Fix: trimtab vehicle" in done.output or "--confirm" in done.output
