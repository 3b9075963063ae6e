"""A vehicle, its outputs and its autopilot as programs in virtual time, for tests."""

from pathlib import Path
from types import SimpleNamespace

from run.stand_ins import KEY

from trimtab.core.time import ms
from trimtab.flight.autopilot import LiveAutopilot
from trimtab.flight.autopilot_parts import AutopilotOptions
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.stamps import running_clock
from trimtab.flight.vehicle import LiveVehicle
from trimtab.flight.virtual_machine import VirtualMachine
from trimtab.flight.virtual_network import VirtualNetwork
from trimtab.flight.virtual_time import VirtualTime
from trimtab.run.blocks import replace_links

PORT = 14550
LISTEN, LINK = f"udp://:{PORT}", f"udp://127.0.0.1:{PORT}"
LOG = Path("/virtual/flight.mcap")
"""Name of a log in memory; nothing is written."""


class VirtualPair:
    """Both ends of a flight. Set it up, `start_vehicle` and `start_autopilot`, then `run`."""

    def __init__(self, scenario, seed=1, *, hand_over=lambda: None):
        self.scenario, self.time = scenario, VirtualTime(seed, hand_over=hand_over)
        self.network = VirtualNetwork(self.time)
        self.network.names[PORT] = "vehicle"
        self.there, self.here = (VirtualMachine(self.time, self.network, name) for name in ("vehicle", "autopilot"))
        self.said, self.told, self.outputs_said = [], [], []
        self._end = None
        self.there.tell = self.outputs_said.append

    @property
    def both_paths(self):
        return self.network.path("autopilot", "vehicle"), self.network.path("vehicle", "autopilot")

    def make_vehicle(self, machine, scenario=None):
        self.vehicle = LiveVehicle(
            replace_links(scenario or self.scenario),
            machine.open_link(LISTEN, listen=True),
            lambda dialect: self.endpoint(machine, dialect, 1),
            machine=machine,
        )
        return self.vehicle

    def make_autopilot(self, machine, scenario=None, **options):
        self.flyer = LiveAutopilot(
            scenario or self.scenario,
            machine.open_link(LINK),
            lambda dialect: self.endpoint(machine, dialect, 191),
            machine=machine,
            options=AutopilotOptions(**options),
        )
        return self.flyer

    def endpoint(self, machine, dialect, component, key=KEY):
        return Endpoint(
            dialect,
            1,
            component,
            key,
            datagrams=True,
            clock=running_clock(machine.clock),
            session=machine.draw_session(),
        )

    def start_vehicle(self, scenario=None, *, until=None, **options):
        """Serve until a tenth of a second after the autopilot has ended, or until `until` returns True."""
        stop = until or self.has_autopilot_ended

        def serve(machine):
            vehicle = self.make_vehicle(machine, scenario)
            given = {"log": LOG, "watchdog": ms(50), "stop": stop, "tell": self.told.append} | options
            return vehicle.serve(**given)

        self.serving = self.there.start(serve)

    def start_autopilot(self, fly=None, *, pause=0.0, **options):
        """Connect, wait, fly. fly: called with the connected autopilot instead of its own `fly`."""

        def run(machine):
            flyer = self.make_autopilot(machine)
            flyer.connect()
            machine.clock.wait(None, pause)
            if fly is not None:
                return fly(flyer, machine)
            return flyer.fly(**{"log": LOG, "tell": self.said.append} | options)

        self.flying = self.here.start(run)

    def run(self):
        """Run to the end of both programs. Raise the error of a failed program."""
        self.time.run(*[p for p in (getattr(self, "serving", None), getattr(self, "flying", None)) if p is not None])
        for program in self.time.programs:
            if program.error is not None:
                raise program.error

    def has_autopilot_ended(self):
        """True if the autopilot ended at least a tenth of a second ago."""
        if self._end is None and any(program.has_ended for program in self.here.programs[-1:]):
            self._end = self.time.seconds
        return self._end is not None and self.time.seconds >= self._end + 0.1

    def when_armed(self, act, later=0.5):
        """Call a function some seconds after the vehicle was armed."""

        def look():
            if getattr(self, "vehicle", None) is not None and self.vehicle.release_time is not None:
                self.time.call_at(self.time.seconds + later, act)
            else:
                self.time.call_at(self.time.seconds + 0.01, look)

        self.time.call_at(0.0, look)

    def logs(self):
        """The autopilot's log and the vehicle's."""
        return self.here.disk.logs[-1].read(), self.there.disk.logs[-1].read()


def fly_pair(scenario, seed=1, *, pause=0.0, act=None, later=0.5, vehicle=None, hand_over=lambda: None, **options):
    """Fly a complete flight. act: called with the pair `later` seconds after arming."""
    pair = VirtualPair(scenario, seed, hand_over=hand_over)
    pair.start_vehicle(**(vehicle or {}))
    pair.start_autopilot(pause=pause, **options)
    if act is not None:
        pair.when_armed(lambda: act(pair), later)
    pair.run()
    log, truth = pair.logs()
    return SimpleNamespace(
        pair=pair,
        scenario=scenario,
        flight=pair.flying.result,
        served=pair.serving.result,
        log=log,
        truth=truth,
        said=pair.said,
        digest=pair.time.digest,
    )


def events(log):
    """Texts of a log's events."""
    return [event["text"] for event in log.metadata.get("events", [])]
