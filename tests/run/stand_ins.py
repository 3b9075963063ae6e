"""Stand-ins for tests of links: a step that records its inputs, a link that records packets, two endpoints."""

from types import SimpleNamespace

import numpy as np

from trimtab.core.interfaces import LinkStatistics
from trimtab.core.record import leaves
from trimtab.core.signals import Command, Frame, Sample
from trimtab.flight.mavlink.dialect import derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key

KEY = passphrase_key("correct-horse-battery-staple")


def sample(value):
    return Sample(value=value, t=np.int64(0), age=0.0, fresh=False, valid=False)


def dialect(samples, command):
    """Return the dialect of samples by name (their values) and of a command's value."""
    frame = Frame(t=np.int64(0), samples={name: sample(value) for name, value in samples.items()})
    return frame, derive_dialect(frame, Command(t=np.int64(0), valid=False, value=command))


def places(tree, prefix=""):
    """Return path -> index or slice, with the leaves one after the other."""
    found, k = {}, 0
    for path, value, _ in leaves(tree):
        size = np.size(value)
        found[f"{prefix}{path}"] = slice(k, k + size) if np.shape(value) else k
        k += size
    return found, k


class Step:
    """A step that keeps a copy of the inputs of each call."""

    def __init__(self, frame, command):
        self.reads, n = places(frame)
        self.writes, m = places(command, "command.")
        self.inputs, self.outputs, self.seen = np.zeros(n), np.zeros(m), []

    def step(self):
        self.seen.append({p: np.copy(self.inputs[at]).tolist() for p, at in self.reads.items()})


class Link:
    """Records the packets that are sent."""

    def __init__(self, connected=True):
        self.sent, self.connected, self.heard = [], connected, 0

    def send(self, packet):
        self.sent.append(packet)
        return True

    @property
    def statistics(self):
        return LinkStatistics(0, 0, self.heard, len(self.sent), 0, 0, self.connected)


def ends(of, **options):
    """Return the vehicle's endpoint and the autopilot's."""
    options = options or {"key": KEY}
    return SimpleNamespace(there=Endpoint(of, 1, 1, **options), here=Endpoint(of, 1, 191, **options))
