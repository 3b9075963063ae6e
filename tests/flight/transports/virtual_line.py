"""Links of a virtual network, for a test that runs as one program in virtual time."""

from trimtab.flight.transports.udp import UdpLink
from trimtab.flight.virtual_network import Host, VirtualNetwork
from trimtab.flight.virtual_time import VirtualTime

SERVER = Host("server", 14550)


class VirtualLine:
    """One listening end and any number of calling ends, all in one program."""

    def __init__(self, time, clock):
        self.time, self.clock, self.network = time, clock, VirtualNetwork(time)

    def listen(self):
        return UdpLink(self.network.open_socket(self.clock.program, *SERVER), None, self.clock)

    def call(self, host="client"):
        return UdpLink(self.network.open_socket(self.clock.program, host, peer=SERVER), SERVER, self.clock)

    def pause(self, seconds):
        self.clock.wait(None, seconds)


def open_virtual_line(seed=1):
    """A VirtualLine whose links belong to the calling thread."""
    time = VirtualTime(seed)
    return VirtualLine(time, time.adopt("test").clock)


def run_in_virtual_time(body, seed=1):
    """Run a test's body, called with a VirtualLine; return what it returns."""
    time = VirtualTime(seed)
    program = time.start("test", lambda clock: body(VirtualLine(time, clock)))
    time.run()
    if program.error is not None:
        raise program.error
    return program.result
