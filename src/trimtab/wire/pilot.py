"""What a pilot's receiver or joystick says, in SI units. Source: https://mavlink.io/en/messages/common.html."""

from trimtab.wire.events import Channels, Sticks
from trimtab.wire.message import Message

CHANNELS = 18
NAN = float("nan")
ABSENT = {"RC_CHANNELS": (65535,), "RC_CHANNELS_OVERRIDE": (0, 65534, 65535)}
"""Values that mean: no such channel; to be let alone; given back to the receiver."""


def channels(message: Message) -> Channels:
    """Pulse widths from RC_CHANNELS or RC_CHANNELS_OVERRIDE."""
    fields = message.fields()
    many = fields.get("chancount", CHANNELS)
    raw = [fields[f"chan{k + 1}_raw"] for k in range(CHANNELS)]
    pulses = (NAN if v in ABSENT[message.name] or k >= many else v * 1e-6 for k, v in enumerate(raw))
    override = message.name == "RC_CHANNELS_OVERRIDE"
    return Channels(tuple(pulses), override, (message.system, message.component))


def sticks(message: Message) -> Sticks:
    """A joystick from MANUAL_CONTROL; what lies outside of +-1000 is an axis that isn't there."""
    surge, sway, heave, yaw = (v / 1000 if abs(v) <= 1000 else NAN for v in map(message.get, "xyzr"))
    return Sticks(surge, sway, heave, yaw, message.get("buttons"), (message.system, message.component))
