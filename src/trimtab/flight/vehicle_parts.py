"""Parts of a virtual vehicle that runs in real time. Each part holds references to the parts that it uses.

Source: docs page, Vehicle.
"""

from collections.abc import Callable
from typing import NamedTuple

from trimtab.core.interfaces import Link
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.flight.announcer import Announcer
from trimtab.flight.autopilot_parameters import AutopilotRelay
from trimtab.flight.broadcast import Broadcast
from trimtab.flight.clock_refusals import RefusalAnswers
from trimtab.flight.command_gate import CommandGate
from trimtab.flight.duties import STATION_MODES, Duties, FlightRequests
from trimtab.flight.exchange import MessageGroup, command_group
from trimtab.flight.instruments import Instruments
from trimtab.flight.machine import Machine
from trimtab.flight.mavlink.dialect import Dialect, derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.parameter_store import ParameterStore
from trimtab.flight.prearm import ArmingGuard
from trimtab.flight.reporter import Reporter
from trimtab.flight.scenario_identity import scenario_identity
from trimtab.flight.station.identity import IdentityService
from trimtab.flight.station.parameter_metadata import component_metadata, metadata_documents
from trimtab.flight.station.parameters import Parameters
from trimtab.flight.station.standard_services import Station, Status
from trimtab.flight.station_options import StationOptions, station_services
from trimtab.flight.virtual_vehicle import VirtualVehicle, check_pace
from trimtab.links.wire import Wire
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import choose_failsafe, uplink_block
from trimtab.run.cosimulation import prepare_world
from trimtab.run.kept_blocks import compile_kept
from trimtab.vehicles.vehicle_type import mav_type


class VehicleParts(NamedTuple):
    """Parts of a virtual vehicle that runs in real time."""

    scenario: Scenario
    link: Link
    machine: Machine
    endpoint: Endpoint
    reporter: Reporter
    body: VirtualVehicle
    duties: Duties
    guard: ArmingGuard
    instruments: Instruments
    station: Station
    announcer: Announcer
    parameters: Parameters
    command: MessageGroup
    """Group of the MAVLink messages that carry a command."""
    requests: FlightRequests
    identity: IdentityService
    broadcast: Broadcast
    relay: AutopilotRelay
    gate: CommandGate
    refusals: RefusalAnswers

    def find_status(self) -> Status:
        """Return the status of the vehicle for ground stations, with the reasons why the vehicle cannot be armed."""
        return self.duties.status._replace(
            arming_problem=self.guard.problem,
            confirmation_problem=self.guard.confirmation_problem,
            identity=self.identity.number,
        )


def build_vehicle_parts(
    scenario: Scenario,
    link: Link,
    endpoint: Callable[[Dialect], Endpoint],
    seed: int,
    options: StationOptions,
    machine: Machine,
) -> VehicleParts:
    """Compile the vehicle and connect its parts. The arguments are those of `LiveVehicle`."""
    uplink, bare = scenario.world.uplink, replace(scenario, world=replace(scenario.world, uplink=Wire()))
    world, frame, command = prepare_world(bare, seed=seed)
    check_pace(world, bare)
    dialect = derive_dialect(frame, command)
    end, body, reporter = endpoint(dialect), VirtualVehicle(bare, dialect, world), Reporter()
    failsafe = choose_failsafe(scenario, command)
    received = None if isinstance(uplink, Wire) else compile_kept(uplink_block, uplink, command, seed=seed)
    duties = Duties(failsafe, command, world, received)
    guard = ArmingGuard(body, scenario.limits, failsafe, end.counts, duties.pilot.radio_silence, machine.disk)
    instruments = Instruments(body, duties, guard, end, options.origin, machine.clock)
    parameters = Parameters(scenario.world, "world")
    station = _build_station(scenario, end, parameters, instruments, guard, options, reporter)
    announcer, messages = Announcer(station, reporter), command_group(dialect, duties.commands.slot)
    broadcast = Broadcast(end, link, messages.names)
    return VehicleParts(
        scenario,
        link,
        machine,
        end,
        reporter,
        body,
        duties,
        guard,
        instruments,
        station,
        announcer,
        parameters,
        messages,
        FlightRequests(end, announcer.notice),
        IdentityService(end, scenario_identity(scenario, dialect)),
        broadcast,
        AutopilotRelay(end, broadcast),
        CommandGate(station, broadcast, announcer.warn),
        RefusalAnswers(end, link, reporter.report),
    )


def _build_station(
    scenario: Scenario,
    endpoint: Endpoint,
    parameters: Parameters,
    instruments: Instruments,
    guard: ArmingGuard,
    options: StationOptions,
    reporter: Reporter,
) -> Station:
    streams, documents = instruments.telemetry_streams(), metadata_documents(parameters)
    streams.add_on_request("COMPONENT_METADATA", lambda now: component_metadata(now // ms(1), documents))
    return Station(
        endpoint,
        parameters,
        STATION_MODES,
        vehicle=mav_type(scenario.world.vehicle),
        streams=streams,
        services=[instruments.globe, *station_services(endpoint, options, documents)],
        store=(options.store or ParameterStore()).write,
        tell=reporter.report,
        arming_checks=lambda: guard.checks,
    )
