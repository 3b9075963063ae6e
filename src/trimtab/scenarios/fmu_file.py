"""Scenario whose vehicle is an FMU, for users who name an .fmu file as scenario. Its inputs are constant or
scheduled."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError
from trimtab.core.time import UNITS_PER_SECOND, ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.constant_input import ConstantInput
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.flight_state import TrueState
from trimtab.vehicles.fmu import first_state, load, neutral_input, read_interface

Trust = Annotated[
    Literal["no", "yes"],
    {
        "no": "the program code in the FMU is not run",
        "yes": "the program code in the FMU runs with your permissions; choose this only if you trust its author",
    },
]


def fmu_scenario(file: str) -> Callable[..., Scenario]:
    """Return a function that builds the scenario of an FMU. file: path of the .fmu file."""

    def scenario(trust_code: Trust = "no") -> Scenario:
        """Return the scenario of the FMU, with the duration and the step size of the FMU's default experiment."""
        if not Path(file).is_file():
            fix = "type the path of an existing .fmu file"
            raise InputError(f"scenario {file!r}", "file not found", fix=fix)
        vehicle, interface = load(file, trust_code=trust_code == "yes"), read_interface(file)
        period = _ticks(interface.step_s) or ms(10)
        held = neutral_input(vehicle)
        world = World(
            vehicle=vehicle,
            sensors={"state": TrueState(period=period)},
            actuators=DirectActuation(held, period=period),
            downlink=Wire(period=period),
            uplink=Wire(period=period),
            max_step=period,
        )
        return Scenario(
            world=world,
            autopilot=Autopilot(Passthrough("state"), ConstantInput(held), DirectAllocation(), period=period),
            initial=first_state(vehicle),
            duration=_ticks(interface.duration_s) or seconds(10),
            truth_sensor=TrueState(period=period),
            name=Path(file).stem,
        )

    return scenario


def _ticks(value: float | None) -> int:
    """Convert a time from s to units of 100 ns, rounded. Return 0 for None and for infinity."""
    return 0 if value is None or not math.isfinite(value) else round(value * UNITS_PER_SECOND)
