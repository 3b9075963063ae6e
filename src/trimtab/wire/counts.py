"""What one end of a line has sent, taken and refused."""

import dataclasses


@dataclasses.dataclass
class Counts:
    """Frames, except where it says bytes, since the end was opened."""

    sent: int = 0
    accepted: int = 0
    lost: int = 0
    """Frames that never came, told by the gaps in their senders' sequence numbers."""
    checksum: int = 0
    """Wrong checksum: damaged, or of a sender with other definitions."""
    unknown: int = 0
    """No such message in this dialect."""
    unsigned: int = 0
    downgraded: int = 0
    """Frames of MAVLink 1, which cannot be signed."""
    wrong_signature: int = 0
    replayed: int = 0
    """Signed rightly but not new."""
    reflected: int = 0
    """This end's own, sent back."""
    garbage: int = 0
    """Bytes that belong to no frame."""
    clamped: int = 0
    """Messages packed with a number that its type could not hold."""

    @property
    def refused(self) -> int:
        """Frames that came whole and were not taken."""
        return self.unknown + self.unsigned + self.downgraded + self.wrong_signature + self.replayed + self.reflected
