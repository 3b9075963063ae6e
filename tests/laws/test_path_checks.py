"""Commands rejected before a path law flies, for each form of internal motion."""

import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.path_inversion import InputLimits
from trimtab.laws.stable_inversion import StableInversion, check_command_ends
from trimtab.vehicles.hypersonic import Hypersonic

CRAFT, LIMITS = Hypersonic(), InputLimits()


@pytest.mark.parametrize(
    ("dh", "dV"), [(0.0, 0.0), (1000.0, 200.0), (5000.0, 1000.0), (10000.0, 1500.0), (-5000.0, -500.0)]
)
def test_accepts_feasible_climbs(dh, dV):
    check_command_ends(CRAFT, FilteredClimb(dh=dh, dV=dV), LIMITS)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"h0": 200000.0}, r"begins at 200000 ft|level flight at 200000 ft"),
        ({"V0": 2000.0}, r"begins at 85000 ft, 2000 ft/s|level flight at 85000 ft, 2000 ft/s"),
        ({"dh": 60000.0}, r"145000 ft"),
        ({"dh": -90000.0}, r"-5000 ft"),
    ],
)
def test_rejects_commands_without_level_flight_at_an_end(changes, says):
    command = replace(FilteredClimb(), **changes)
    with pytest.raises(InputError, match=says):
        check_command_ends(CRAFT, command, LIMITS)
    with pytest.raises(InputError, match=says):
        StableInversion(command=command).check()  # the quasi-static form, which has no table


def test_rejects_commands_beyond_the_input_limits():
    with pytest.raises(
        InputError,
        match=r"at 85000 ft, 7702.08 ft/s needs fuel ratio 0\.2644, but the limits are 0\.02 and 0\.2\.",
    ):
        check_command_ends(CRAFT, FilteredClimb(), replace(LIMITS, Phi_high=0.2))


def test_rejects_commands_infeasible_for_the_assumed_vehicle():
    with pytest.raises(InputError, match=r"level flight|balances"):
        check_command_ends(replace(CRAFT, m=3000.0), FilteredClimb(), LIMITS)
