"""Vehicle as known to the autopilot's end: presence, messages, clock, scenario and arming state.

Source: docs page, Fly; MAVLink's services heartbeat, command and timesync.
"""

from collections.abc import Callable, Sequence

from trimtab.core.interfaces import Link
from trimtab.flight.connection_problem import (
    ConnectionProblem,
    clock_problem,
    key_problem,
    scenario_problem,
    signing_problem,
)
from trimtab.flight.forwarded_requests import NO_AUTOPILOT, ForwardedRequests
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import VERSION_MESSAGE, CommandCode, CommandResult
from trimtab.flight.remote_arming import RemoteArming, pack_command
from trimtab.flight.scenario_comparison import ScenarioComparison
from trimtab.flight.station.arming import RemoteChecks
from trimtab.flight.station.identity import TUNNEL, IdentityComparison
from trimtab.flight.station.streams import TextAssembly
from trimtab.flight.vehicle_clock import VehicleClock


class RemoteVehicle:
    """Vehicle at the other end of the autopilot's link. Times `now` are by the autopilot's clock, in 100 ns."""

    def __init__(
        self,
        endpoint: Endpoint,
        link: Link,
        typed: str = "trimtab fly SCENARIO --link URI",
        identity: IdentityComparison | None = None,
        accepts: Sequence[str] = (),
        confirms: bool = False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Start without a known vehicle.

        typed: command that the user typed. Messages suggest the command with the missing options.  identity, accepts:
        see `ScenarioComparison`.  confirms: see `RemoteArming`.
        tell: function that receives the messages for the user and for the log.
        """
        self._endpoint, self._link, self.typed, self._tell = endpoint, link, typed, tell
        self.remarks: list[str] = []
        """Remarks on accepted differences between vehicle and autopilot: settings, and the clock. The remarks are also
        logged."""
        self.clock = VehicleClock(endpoint, tell, self.remarks)
        self.comparison = ScenarioComparison(endpoint, identity, accepts, tell, self.remarks)
        self.arming = RemoteArming(endpoint, self.comparison, confirms, tell)
        self.requests = ForwardedRequests(endpoint)
        self.checks, self.wants_checks = RemoteChecks(), False
        """Results of the vehicle's checks before arming, requested while `wants_checks` is True."""
        self.system = self.component = 0
        self.heartbeat_time: int | None = None
        self._texts = TextAssembly()

    def is_of_vehicle(self, message: Message) -> bool:
        """Return True if a message is from the first vehicle that has sent a heartbeat."""
        return self.heartbeat_time is not None and (message.system, message.component) == (self.system, self.component)

    @property
    def is_ready(self) -> bool:
        """True if a vehicle answers, the vehicle's clock is known, and its scenario matches the autopilot's
        scenario."""
        return self.heartbeat_time is not None and self.clock.is_known and self.comparison.is_complete

    def find_problem(self, scenario: str) -> ConnectionProblem:
        """Return the reason why the vehicle is not ready, as a message for the user."""
        counts, traffic, stamps = self._endpoint.counts, self._link.statistics, self._endpoint.stamps
        start = f"trimtab vehicle {scenario} --listen …, with the same --set on both ends"
        comparison, untimely = self.comparison, self.clock.untimely
        differences = comparison.differences()
        if differences:
            return scenario_problem(differences, self.typed)
        if comparison.misfit or comparison.dialect_problem:
            return ConnectionProblem(comparison.misfit or comparison.dialect_problem, start)
        if untimely is not None and stamps is not None:
            return clock_problem(untimely.lead, stamps.stored_lead, self.typed)
        if counts.wrong_signature:
            return key_problem(counts.wrong_signature, self.typed)
        if counts.unsigned or (counts.unchecked and self.heartbeat_time is None):
            return signing_problem(stamps is not None, self.typed)
        if not traffic.packets_in:
            lost = "" if traffic.connected else ": there is no connection"
            return ConnectionProblem(f"no vehicle answers{lost}", start)
        if counts.checksum or counts.unknown:
            problem = f"wrong scenario: {counts.checksum + counts.unknown} frames do not match this scenario's messages"
            return ConnectionProblem(problem, start)
        return ConnectionProblem("a vehicle answers, but its clock is not known yet", start)

    def handle_message(self, message: Message, now: int) -> None:
        """Handle a message of the vehicle that is not part of a sample."""
        if message.name == "HEARTBEAT" and message.get("autopilot") != NO_AUTOPILOT:
            self._handle_heartbeat(message, now)
        elif (message.system, message.component) != (self.system, self.component):
            return  # a router forwards messages of ground stations and other vehicles
        elif message.name == "TIMESYNC":
            if self.clock.handle_answer(message, now):
                self.comparison.note_second_vehicle(message, "two different answers to one time request")
        elif message.name == "STATUSTEXT":
            text = self._texts.join(message)
            if text:
                self._tell(f"vehicle: {text}")
        elif message.name == "COMMAND_ACK":
            self._handle_acknowledgement(message)
        elif message.name == "COMMAND_LONG":
            self._send(self.requests.answer(message))
        elif message.name == TUNNEL:
            self.checks.handle_message(message, now)
            self.comparison.handle_identity(message)
        elif message.name == "AUTOPILOT_VERSION":
            self.comparison.handle_version(message)

    def _handle_heartbeat(self, message: Message, now: int) -> None:
        if self.heartbeat_time is None:
            self.system, self.component = message.system, message.component
        if (message.system, message.component) == (self.system, self.component):
            self.arming.handle_heartbeat(message, now)
            self.heartbeat_time = now

    def _handle_acknowledgement(self, message: Message) -> None:
        ours = ("target_system", self._endpoint.system), ("target_component", self._endpoint.component)
        if any(message.get(field) not in (0, own) for field, own in ours):
            return
        command, is_accepted = message.get("command"), message.get("result") == CommandResult.ACCEPTED
        self.arming.handle_acknowledgement(command, is_accepted, message.get("result_param2"))
        if command == CommandCode.RUN_CHECKS and not is_accepted:
            self.checks.handle_refusal()
        elif command == CommandCode.REQUEST_MESSAGE and not is_accepted:
            self.comparison.handle_refusal()

    def due(self, now: int) -> None:
        """Send the heartbeats and requests that are due now."""
        self._send(self.requests.due(now))
        self._send(self.clock.due(now))
        self._send(self.arming.due(now, self.system))
        if self.wants_checks and self.checks.is_due(now):
            self._send([pack_command(self._endpoint, self.system, CommandCode.RUN_CHECKS, 0)])
        if self.heartbeat_time is not None and self.comparison.asks_version(now):
            self._send([pack_command(self._endpoint, self.system, CommandCode.REQUEST_MESSAGE, VERSION_MESSAGE)])
        if self.heartbeat_time is not None and not (self.arming.armed and self.comparison.is_told):
            self._send(self.comparison.due(now, self.system, self.component))

    def _send(self, packets: Sequence[bytes]) -> None:
        for packet in packets:
            self._link.send(packet)
