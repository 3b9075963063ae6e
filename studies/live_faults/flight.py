"""A flight of a live pair: two processes, the line between them, and what is left when both have ended."""

import contextlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from time import sleep
from typing import Any, NamedTuple

from studies.live_faults.process import Process
from studies.live_faults.relay import Datagrams, Relay, Terminals
from trimtab.links.open_link import open_link
from trimtab.live.autopilot_end import dialect_for
from trimtab.live.injector import Injector, names_for_faults, planned
from trimtab.loop.scenario import Scenario
from trimtab.wire.dialect import Dialect
from trimtab.wire.keys import Key, create_key, load_key
from trimtab.wire.mavlink import Endpoint

NAME = "hovercraft/forward"
INJECTOR = 1, 192


class Ground(NamedTuple):
    """What is known of the vehicle on the ground: its scenario, the names of its parameters, and how it speaks."""

    scenario: Scenario
    names: dict[str, str]
    dialect: Dialect


def ground(scenario: Scenario) -> Ground:
    """Made once for all flights."""
    return Ground(scenario, names_for_faults(scenario), dialect_for(scenario))


class Ended(NamedTuple):
    """What a process left. log: path of its log, which may be missing."""

    name: str
    status: int | None
    said: str
    result: dict[str, Any] | None
    log: Path


class Flight:
    """One vehicle, the autopilots that fly it one after the other, and the line."""

    def __init__(self, folder: Path, known: Ground, *, serial: bool = False) -> None:
        self.folder, self.known = folder, known
        self.ends = Terminals(folder) if serial else Datagrams()
        self.relay = Relay(self.ends)
        self._key = folder / "config" / "keys" / "hovercraft.key"
        create_key(self._key)
        self._environment = {"TRIMTAB_CONFIG": str(folder / "config")}
        self.vehicles: list[Process] = []
        self.pilots: list[Process] = []
        self.cleaning: list[Callable[[], Any]] = []

    @property
    def vehicle(self) -> Process:
        """The newest."""
        return self.vehicles[-1]

    @property
    def pilot(self) -> Process:
        """The newest."""
        return self.pilots[-1]

    @property
    def key(self) -> Key:
        """That of the vehicle."""
        return load_key(self._key)

    def out(self, name: str) -> Path:
        """The folder of a process's log."""
        return self.folder / name

    def start_vehicle(self, duration: float, **environment: str) -> None:
        """Start it, and wait until it listens."""
        name = f"vehicle-{len(self.vehicles) + 1}"
        words = ("vehicle", NAME, "--listen", self.ends.listen, "--duration", f"{duration} s")
        self.vehicles.append(self._start(name, words, environment))
        self.vehicle.wait_for("listens on")

    def start_pilot(self, duration: float, **environment: str) -> None:
        """Start it; it arms the vehicle by itself, once."""
        name = f"autopilot-{len(self.pilots) + 1}"
        words = ("fly", NAME, "--link", self.ends.link, "--duration", f"{duration} s")
        self.pilots.append(self._start(name, words, environment))

    def _start(self, name: str, words: tuple[str, ...], environment: dict[str, str]) -> Process:
        given = {**self._environment, **environment}
        return Process(*words, "--out", str(self.out(name)), folder=self.folder, name=name, environment=given)

    def armed(self, times: int = 1) -> None:
        """Wait until the vehicle has been armed this often."""
        self.vehicle.wait_for("computer: arm request", times)

    def inject(self, text: str) -> None:
        """A fault, as `trimtab inject` puts it."""
        with self.heard_by_vehicle() as injector:
            injector.inject(planned(self.known.scenario, text, self.known.names))

    @contextlib.contextmanager
    def heard_by_vehicle(self) -> Iterator[Injector]:
        """Another end that speaks to the vehicle, past the relay."""
        link = open_link(self.ends.listen)
        endpoint = Endpoint(self.known.dialect, *INJECTOR, self.key, datagrams=True)
        try:
            yield Injector(link, endpoint)
        finally:
            endpoint.close()
            link.close()

    def finish(self) -> list[Ended]:
        """Wait for all ends, and gather what they left."""
        for one in (*self.pilots, *self.vehicles):
            one.finish()
        return [self._left(p, "vehicle.mcap") for p in self.vehicles] + [
            self._left(p, "flight.mcap") for p in self.pilots
        ]

    def _left(self, process: Process, log: str) -> Ended:
        return Ended(process.name, process.status, process.said, process.result, self.out(process.name) / log)

    def close(self) -> None:
        """End everything."""
        for one in (*self.pilots, *self.vehicles):
            if one.status is None:
                one.kill()
        self.relay.close()
        for clean in reversed(self.cleaning):
            clean()


def pause(seconds: float) -> None:
    """Let it fly."""
    sleep(seconds)


def remove(folder: Path) -> None:
    """A case's folder, when nobody wants to look at it."""
    shutil.rmtree(folder, ignore_errors=True)
