"""A vehicle in a thread and an autopilot in wall-clock time, over a loopback link."""

import threading

from run.stand_ins import KEY

from trimtab.flight.autopilot import LiveAutopilot
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.transports.open_link import open_link
from trimtab.flight.vehicle import LiveVehicle
from trimtab.run.blocks import replace_links


class Pair:
    """A vehicle that serves in a thread, and an autopilot that may fly it."""

    def __init__(self, scenario, name, step=None, confirmed=frozenset()):
        self.there, self.here = open_link(f"loopback://{name}", listen=True), open_link(f"loopback://{name}")
        self.vehicle = LiveVehicle(replace_links(scenario), self.there, lambda d: Endpoint(d, 1, 1, KEY))
        self.flyer = LiveAutopilot(scenario, self.here, lambda d: Endpoint(d, 1, 191, KEY), step=step)
        self._confirmed = confirmed
        self._ended, self.served = threading.Event(), []
        self.thread = threading.Thread(target=self._serve)

    def _serve(self):
        self.served.append(self.vehicle.serve(log=self.log, stop=self._ended.is_set, confirmed=self._confirmed))

    def start(self, log=None):
        self.log = log
        self.thread.start()

    def end(self):
        self._ended.set()
        self.thread.join(20)
        self.here.close()
        self.there.close()
        assert not self.thread.is_alive()
        return self.served[0] if self.served else None
