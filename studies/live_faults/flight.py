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
from trimtab.live.autopilot_end import scenario_dialect
from trimtab.live.injector import Injector, fault_parameter_names, plan_fault
from trimtab.loop.scenario import Scenario
from trimtab.wire.dialect import Dialect
from trimtab.wire.keys import SigningKey, create_key, load_key
from trimtab.wire.mavlink import Endpoint

NAME = "hovercraft/forward"
INJECTOR = 1, 192


class VehicleKnowledge(NamedTuple):
    """What is known of the vehicle on the ground: its scenario, the names of its parameters, and how it speaks."""

    scenario: Scenario
    names: dict[str, str]
    dialect: Dialect


def collect_knowledge(scenario: Scenario) -> VehicleKnowledge:
    """Made once for all flights."""
    return VehicleKnowledge(scenario, fault_parameter_names(scenario), scenario_dialect(scenario))


class ProcessResult(NamedTuple):
    """What a process left. log: path of its log, which may be missing."""

    name: str
    status: int | None
    output_text: str
    result: dict[str, Any] | None
    log: Path


class FaultFlight:
    """One vehicle, the autopilots that fly it one after the other, and the line."""

    def __init__(self, folder: Path, known: VehicleKnowledge, *, serial: bool = False) -> None:
        self.folder, self.knowledge = folder, known
        self.ends = Terminals(folder) if serial else Datagrams()
        self.relay = Relay(self.ends)
        self._key = folder / "config" / "keys" / "hovercraft.key"
        create_key(self._key)
        self._environment = {"TRIMTAB_CONFIG": str(folder / "config")}
        self.vehicles: list[Process] = []
        self.autopilots: list[Process] = []
        self.cleanups: list[Callable[[], Any]] = []

    @property
    def vehicle(self) -> Process:
        """The newest."""
        return self.vehicles[-1]

    @property
    def autopilot(self) -> Process:
        """The newest."""
        return self.autopilots[-1]

    @property
    def key(self) -> SigningKey:
        """That of the vehicle."""
        return load_key(self._key)

    def log_folder(self, name: str) -> Path:
        """The folder of a process's log."""
        return self.folder / name

    def start_vehicle(self, duration: float, **environment: str) -> None:
        """Start it, and wait until it listens."""
        name = f"vehicle-{len(self.vehicles) + 1}"
        words = ("vehicle", NAME, "--listen", self.ends.listen, "--duration", f"{duration} s")
        self.vehicles.append(self._start_process(name, words, environment))
        self.vehicle.wait_for("listens on")

    def start_autopilot(self, duration: float, **environment: str) -> None:
        """Start it; it arms the vehicle by itself, once."""
        name = f"autopilot-{len(self.autopilots) + 1}"
        words = ("fly", NAME, "--link", self.ends.link, "--duration", f"{duration} s")
        self.autopilots.append(self._start_process(name, words, environment))

    def _start_process(self, name: str, words: tuple[str, ...], environment: dict[str, str]) -> Process:
        given = {**self._environment, **environment}
        return Process(*words, "--out", str(self.log_folder(name)), folder=self.folder, name=name, environment=given)

    def wait_for_arming(self, times: int = 1) -> None:
        """Wait until the vehicle has been armed this often."""
        self.vehicle.wait_for("computer: arm request", times)

    def inject_fault(self, text: str) -> None:
        """A fault, as `trimtab inject` puts it."""
        with self.open_injector() as injector:
            injector.inject(plan_fault(self.knowledge.scenario, text, self.knowledge.names))

    @contextlib.contextmanager
    def open_injector(self) -> Iterator[Injector]:
        """Another end that speaks to the vehicle, past the relay."""
        link = open_link(self.ends.listen)
        endpoint = Endpoint(self.knowledge.dialect, *INJECTOR, self.key, datagrams=True)
        try:
            yield Injector(link, endpoint)
        finally:
            endpoint.close()
            link.close()

    def finish(self) -> list[ProcessResult]:
        """Wait for all ends, and gather what they left."""
        for one in (*self.autopilots, *self.vehicles):
            one.finish()
        return [self._process_result(p, "vehicle.mcap") for p in self.vehicles] + [
            self._process_result(p, "flight.mcap") for p in self.autopilots
        ]

    def _process_result(self, process: Process, log: str) -> ProcessResult:
        return ProcessResult(
            process.name, process.status, process.output_text, process.result, self.log_folder(process.name) / log
        )

    def close(self) -> None:
        """End everything."""
        for one in (*self.autopilots, *self.vehicles):
            if one.status is None:
                one.kill()
        self.relay.close()
        for clean in reversed(self.cleanups):
            clean()


def let_fly(seconds: float) -> None:
    """Let it fly."""
    sleep(seconds)


def remove_folder(folder: Path) -> None:
    """A case's folder, when nobody wants to look at it."""
    shutil.rmtree(folder, ignore_errors=True)
