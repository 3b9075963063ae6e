"""`trimtab vehicle` and `trimtab fly` in virtual time, with the interface of `pair.fly_pair`."""

from contextlib import ExitStack

from flight.pair import DISARMED_S, Ended, make_key

from studies.live_faults.virtual_process import VirtualProcess, own_streams
from trimtab.flight.virtual_machine import VirtualMachine
from trimtab.flight.virtual_network import VirtualNetwork
from trimtab.flight.virtual_time import VirtualTime

PORT = 14550
LISTEN, LINK = f"udp://:{PORT}", f"udp://127.0.0.1:{PORT}"


class VirtualPrograms:
    """Programs on virtual computers. The test's thread acts as the user who starts them."""

    def __init__(self, folder, seed=1):
        self.folder, self.time = folder, VirtualTime(seed)
        self.network = VirtualNetwork(self.time)
        self.network.names[PORT] = "vehicle"
        self._clock = self.time.adopt("user").clock
        self._streams = ExitStack()
        self.machines = {}

    def pause(self, seconds):
        self._clock.wait(None, seconds)

    def start(self, host, *words):
        """Start a command on a computer. Restarts on the same computer keep its clock."""
        self._streams.close()  # pytest sets the usual streams anew when a fixture is ready
        self._streams.enter_context(own_streams())
        machine = self.machines.setdefault(host, VirtualMachine(self.time, self.network, host))
        return VirtualProcess(*words, name=host, machine=machine, pause=self.pause)

    def finish(self, process):
        process.finish()
        return Ended(process.status, process.result, process.output_text)

    def read_log(self, host):
        return self.machines[host].disk.logs[-1].read()

    def close(self):
        for program in self.time.programs[1:]:
            self.time.kill(program)
        self.pause(0.001)
        self._streams.close()


def fly_pair(folder, scenario, *both, vehicle=(), pilot=(), key="hovercraft"):
    """Run both ends to their end. Return the programs and the results of vehicle and autopilot."""
    make_key(folder, key)
    programs, signed = VirtualPrograms(folder), ("--key", str(folder / "config" / "keys" / f"{key}.key"))
    try:
        out = folder / "there", folder / "here"
        words = ("vehicle", scenario, "--listen", LISTEN, "--out", str(out[0]), *signed, *both, *vehicle)
        there = programs.start("vehicle", *words)
        there.wait_for("listens on")
        words = ("fly", scenario, "--link", LINK, "--out", str(out[1]), *signed, *both, *pilot)
        here = programs.finish(programs.start("autopilot", *words))
        if here.status:  # one that flew ends by itself; one that nobody armed waits for ever
            programs.pause(DISARMED_S)
            programs.machines["vehicle"].interrupt()
        return programs, programs.finish(there), here
    finally:
        programs.close()
