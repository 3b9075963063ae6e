"""Parts of the autopilot's end of a link, and the distribution of received packets to these parts.

Source: docs page, Fly.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.clock import Clock
from trimtab.core.interfaces import Link
from trimtab.flight.autopilot_end import AutopilotEnd, scenario_dialect
from trimtab.flight.autopilot_parameters import AutopilotParameters
from trimtab.flight.machine import Machine
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.parameter_store import ParameterStore
from trimtab.flight.preflight import Preflight
from trimtab.flight.real_time import NS
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.reporter import Reporter
from trimtab.flight.sample_clock import SampleClock
from trimtab.flight.scenario_identity import scenario_identity
from trimtab.flight.station.identity import IdentityComparison
from trimtab.flight.supervised import CompiledSupervisor
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import add_stick_sensor
from trimtab.run.blocks import compile_autopilot


class AutopilotOptions(NamedTuple):
    """Options of the autopilot's end.

    typed: the command that the user typed; error messages suggest a changed command.
    takes_over: True to take the vehicle over from another autopilot that flies it. False to refuse such a vehicle.
    confirms: True to confirm that the vehicle may be armed again after a failsafe.
    accepts: paths of settings that may differ between vehicle and autopilot. A path includes all settings below it.
    store: file for parameters that a ground station asks to store, or None to store no parameters.
    """

    typed: str | None = None
    takes_over: bool = False
    confirms: bool = False
    accepts: Sequence[str] = ()
    store: ParameterStore | None = None


class AutopilotParts(NamedTuple):
    """Parts of the autopilot's end. Each part holds references to the parts that it uses."""

    scenario: Scenario
    """Scenario of the flight, with additional sensors whose samples contain the pilot's requests and stick
    positions."""
    link: Link
    endpoint: Endpoint
    reporter: Reporter
    clock: Clock
    remote: RemoteVehicle
    sample_clock: SampleClock
    autopilot_end: AutopilotEnd
    parameters: AutopilotParameters
    supervised: CompiledSupervisor
    preflight: Preflight

    def handle_data(self, data: bytes) -> None:
        """Pass the messages of a received packet to the parts that handle them."""
        now = self.clock.monotonic_ns() // NS
        for message in self.endpoint.feed(data):
            is_sample = self.remote.is_of_vehicle(message) and self.autopilot_end.handle_message(message)
            if not is_sample and not self.parameters.handle_message(message):
                self.remote.handle_message(message, now)
        self.remote.clock.handle_untimely(self.endpoint.untimely)


def build_parts(
    scenario: Scenario,
    link: Link,
    endpoint: Callable[[Dialect], Endpoint],
    step: CompiledBlock | None,
    seed: int,
    options: AutopilotOptions,
    machine: Machine,
) -> AutopilotParts:
    """Compile the autopilot and connect its parts. The arguments are those of `LiveAutopilot`."""
    scenario.check()
    dialect = scenario_dialect(scenario)
    flown, end, reporter = add_stick_sensor(add_pilot_sensor(scenario)), endpoint(dialect), Reporter()
    step = step or compile_autopilot(flown, seed=seed)
    identity = IdentityComparison(end, scenario_identity(scenario, dialect))
    typed = options.typed or f"trimtab fly {scenario.name} --link URI"
    remote = RemoteVehicle(end, link, typed, identity, options.accepts, options.confirms, reporter.report)
    sample_clock = SampleClock(remote.clock.sync, machine.clock, reporter)
    autopilot_end = AutopilotEnd(scenario, dialect, step, sample_clock)
    return AutopilotParts(
        flown,
        link,
        end,
        reporter,
        machine.clock,
        remote,
        sample_clock,
        autopilot_end,
        AutopilotParameters(flown, step, end, options.store or ParameterStore()),
        CompiledSupervisor(flown, step),
        Preflight(flown, autopilot_end, remote, end.counts, machine.disk),
    )
