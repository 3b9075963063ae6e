"""Comparison of the vehicle's scenario with the autopilot's scenario: messages and settings. Only one vehicle may be on
the link.

Source: docs pages, Fly and Trust.
"""

import math
from collections.abc import Callable, Sequence

from trimtab.core.time import ms
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.identity import IdentityComparison, SettingDifference

MOST_ASKS = 4
"""Number of unanswered requests after which the vehicle is assumed to be unable to report its scenario."""
ASK_PERIOD = ms(500)


class ScenarioComparison:
    """Comparison of the vehicle's scenario, as far as known, with the autopilot's scenario.

    Times `now` are by the autopilot's clock, in 100 ns.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        identity: IdentityComparison | None,
        accepts: Sequence[str],
        tell: Callable[[str], None],
        remarks: list[str],
    ) -> None:
        """Start without an answer of the vehicle.

        Args:
            endpoint: autopilot's end of the link.
            identity: comparison of the settings, or None to compare only the messages.
            accepts: paths of settings that may differ between vehicle and autopilot. A path includes all settings below
                it.
            tell: function that receives the messages for the user and for the log.
            remarks: list of earlier remarks. The accepted differences are appended, and then all remarks are reported.
        """
        self._endpoint, self._identity, self._accepts = endpoint, identity, tuple(accepts)
        self._tell, self._remarks = tell, remarks
        self.misfit = self.dialect_problem = ""
        """misfit: reason why this autopilot cannot fly the vehicle, or an empty string.

        dialect_problem: description of a difference of the MAVLink dialects, or an empty string.
        """
        self.is_told = self._is_dialect_known = False
        """is_told: True if the settings have been compared and the accepted differences have been reported."""
        self._asks = self._next = self.vehicle_session = 0

    @property
    def is_complete(self) -> bool:
        """True if messages and settings of both ends have been compared, and match."""
        return self._is_dialect_known and (self._identity is None or self.is_told) and not self.misfit

    def accepts(self, path: str) -> bool:
        """Return True if the user accepts that vehicle and autopilot differ in the setting with this path."""
        return path != "messages" and any(path == own or path.startswith(f"{own}.") for own in self._accepts)

    def differences(self) -> list[SettingDifference]:
        """Return the settings that are known to differ between vehicle and autopilot and that the user has not
        accepted."""
        return [] if self._identity is None else self._identity.differences(self.accepts)

    def count_differences(self) -> float:
        """Return the number of settings that differ between vehicle and autopilot and that the user has not accepted.

        After a change of the vehicle's settings, the number is infinite until all settings are known again.
        """
        identity = self._identity
        if identity is None or not self.is_told or identity.is_unanswered:
            return 0
        return len(identity.differences(self.accepts)) if identity.is_known else math.inf

    def first_difference(self) -> str:
        """Return the path of the first setting that differs, or "PATH" if no setting is known to differ."""
        differences = self.differences()
        return differences[0].path if differences else "PATH"

    @property
    def identity_number(self) -> int:
        """Hash (as a number) of the vehicle's settings that were compared, sent in requests to arm. It is 0 if the
        settings were not compared."""
        return 0 if self._identity is None else self._identity.number

    def asks_version(self, now: int) -> bool:
        """Return True if the vehicle must be asked now for its version, which contains the hash of its dialect."""
        if self._is_dialect_known or now < self._next:
            return False
        self._next, self._asks = now + ASK_PERIOD, self._asks + 1
        self._is_dialect_known = self._asks > MOST_ASKS
        return True

    def handle_refusal(self) -> None:
        """Record that the vehicle cannot report its version."""
        self._is_dialect_known = True

    def handle_version(self, message: Message) -> None:
        """Compare the MAVLink dialects of vehicle and autopilot, and check the session number, which a vehicle keeps
        while it runs.

        A vehicle that sends no hash of its dialect is accepted, because a wrong dialect is also detected by wrong
        checksums.
        """
        ours, theirs = self._endpoint.dialect.fingerprint, bytes(message.get("flight_custom_version"))
        self._is_dialect_known = True
        if any(theirs) and theirs != ours:
            both = f"the hash of its dialect is {theirs.hex()}, that of this scenario is {ours.hex()}"
            self.dialect_problem = f"wrong scenario: the vehicle has different sensors or commands: {both}"
            if self._identity is None:
                self.misfit = self.dialect_problem
        session = message.get("uid") >> 8
        if self.vehicle_session not in (0, session):
            self.note_second_vehicle(message, f"sessions {self.vehicle_session:06x} and {session:06x}")
        self.vehicle_session = session

    def note_second_vehicle(self, message: Message, by: str) -> None:
        """Record that two vehicles answer. message: message of one vehicle.  by: text with the numbers that differ
        between the two vehicles."""
        self.misfit = f"two vehicles answer on this link as {message.system}/{message.component}: {by}"

    def handle_identity(self, message: Message) -> None:
        """Handle a TUNNEL message of the vehicle, which may contain some of its settings."""
        if self._identity is not None:
            self._identity.handle_message(message)

    def due(self, now: int, system: int, component: int) -> list[bytes]:
        """Return the requests for the vehicle's settings that are due now.

        If all settings have arrived, compare them.
        """
        if self._identity is None:
            return []
        packets = self._identity.due(now, system, component)
        if not self.is_told:
            self._compare(self._identity)
        return packets

    def _compare(self, identity: IdentityComparison) -> None:
        """Compare the vehicle's settings once they are complete, and report accepted differences."""
        if self.misfit or not (identity.is_known or identity.is_unanswered):
            return
        if identity.differences(self.accepts):
            self.misfit = "wrong scenario"
        elif self.dialect_problem:
            self.misfit = self.dialect_problem
        else:
            self.is_told = True
            self._remarks += [f"accepted: {difference}" for difference in identity.differences()]
            if identity.is_unanswered:
                self._remarks.append("the vehicle does not report its scenario: only the messages were compared")
            for remark in self._remarks:
                self._tell(remark)
