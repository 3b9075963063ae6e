"""A vehicle's own limits: set by --set, none by default, invalid values rejected."""

import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import declarations
from trimtab.core.time import ms
from trimtab.loop.vehicle_limits import NO_LIMIT, VehicleLimits
from trimtab.scenarios.build import build


def test_no_limit_is_set_by_default():
    limits = build("hovercraft/forward", {}).limits
    assert [float(getattr(limits, n)) for n in ("distance", "speed", "rate", "angle")] == [NO_LIMIT] * 4


def test_limits_are_set_by_path_with_unit():
    limits = build("hovercraft/forward", {"limits.speed": "2.5", "limits.patience": "40 ms"}).limits
    assert (limits.speed, limits.patience) == (2.5, ms(40))
    assert declarations(VehicleLimits)["speed"].unit == "m/s"


@pytest.mark.parametrize("wrong", [{"limits.speed": "0"}, {"limits.rate": "-1"}, {"limits.distance": "nan"}])
def test_rejects_nonpositive_and_nan_limits(wrong):
    (path,) = wrong
    with pytest.raises(InputError, match=path):
        build("hovercraft/forward", wrong)
