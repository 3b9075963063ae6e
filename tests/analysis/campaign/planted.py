"""Backing away under an interlock: beyond a rate of turn reached in one far corner only, the fans stay off for good."""

from trimtab.core.record import replace
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import Limit
from trimtab.scenarios.build import build

TRIP = 0.30
"""Rate of turn (rad/s) at which the supervisor ends the flight."""
PATHS = (
    *(f"world.vehicle.{name}" for name in ("mass", "inertia", "arm")),
    *(f"autopilot.law.{name}" for name in ("k1", "k2", "theta")),
    *(f"initial.{name}" for name in ("yaw_rate", "sway_velocity")),
)
SPREAD = dict.fromkeys(PATHS, "uniform(80%, 120%)")
SUCCESS = ("settling:surge_velocity <= 10", "peak:yaw_rate <= 0.4")
"""Neither names the interlock: the room of the second leads towards it."""


def scenario() -> Scenario:
    """The catalogue's hovercraft/reverse, supervised, with exact navigation."""
    made = build("hovercraft/reverse", {"supervisor": "automatic", "duration": "12 s"}, ["navigation-error"])
    limit = Limit(fields=("yaw_rate",), low=-TRIP, high=TRIP, kind="envelope")
    supervisor = replace(made.autopilot.supervisor, limits=(limit,))
    return replace(made, autopilot=replace(made.autopilot, supervisor=supervisor))
