"""Flight of a live pair: two processes, the link between them, and their results."""

import contextlib
import re
import shlex
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple

from studies.live_faults import machine
from studies.live_faults.process import Process
from studies.live_faults.relay import Datagrams, Relay, Terminals
from trimtab.core.clock import SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Link
from trimtab.flight.autopilot_end import scenario_dialect
from trimtab.flight.injector import Injector, fault_parameter_names, plan_fault
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import SigningKey, create_key, load_key
from trimtab.flight.transports.open_link import open_link
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.loop.scenario import Scenario

NAME = "hovercraft/forward"
INJECTOR = 1, 192
UNDISTURBED_S = 1.0
"""Time of undisturbed flight before the act (s)."""


class VehicleKnowledge(NamedTuple):
    """Data of the vehicle that the ground has: its scenario, the names of its parameters, and its dialect."""

    scenario: Scenario
    names: dict[str, str]
    dialect: Dialect


def collect_knowledge(scenario: Scenario) -> VehicleKnowledge:
    """Collect the vehicle's data once for all flights."""
    return VehicleKnowledge(scenario, fault_parameter_names(scenario), scenario_dialect(scenario))


class ProcessResult(NamedTuple):
    """Result of a process. log: path of its log, which may be missing.  read_log: function that reads the log."""

    name: str
    status: int | None
    output_text: str
    result: dict[str, Any] | None
    log: Path
    read_log: Callable[[], Log]


class FaultFlight:
    """One vehicle, the autopilots that fly it one after the other, and the link."""

    def __init__(self, folder: Path, known: VehicleKnowledge, *, serial: bool = False) -> None:
        self.folder, self.knowledge, self.undisturbed_s = folder, known, UNDISTURBED_S
        self.ends = Terminals(folder) if serial else Datagrams()
        self.relay = Relay(self.ends)
        self._key = folder / "config" / "keys" / "hovercraft.key"
        create_key(self._key)
        self._environment = {"TRIMTAB_CONFIG": str(folder / "config")}
        self._injecting = threading.Lock()
        self.overslept_s = 0.0
        """Longest excess of one of the campaign's own waits (s)."""
        self.vehicles: list[Process] = []
        self.autopilots: list[Process] = []
        self.refused: list[Process] = []
        """Autopilots that were refused before they flew."""
        self.cleanups: list[Callable[[], Any]] = []

    @property
    def vehicle(self) -> Process:
        """Vehicle that was started last."""
        return self.vehicles[-1]

    @property
    def autopilot(self) -> Process:
        """Autopilot that was started last."""
        return self.autopilots[-1]

    @property
    def key(self) -> SigningKey:
        """Key of the vehicle."""
        return load_key(self._key)

    def log_folder(self, name: str) -> Path:
        """Return the folder of a process's log."""
        return self.folder / name

    @property
    def clock(self) -> Clock:
        """Clock of the campaign."""
        return SYSTEM_CLOCK

    def now(self) -> float:
        """Return the monotonic time of the campaign (s)."""
        return monotonic()

    def pause(self, seconds: float) -> None:
        """Wait between two packets of an attacker."""
        sleep(seconds)

    def act_together(self, acts: Sequence[Callable[[], None]]) -> None:
        """Do several acts at the same time, and wait for all."""
        problems: list[BaseException] = []

        def run(act: Callable[[], None]) -> None:
            try:
                act()
            except Exception as error:  # raised again below, in the campaign's thread
                problems.append(error)

        threads = [threading.Thread(target=run, args=(act,)) for act in acts]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        if problems:
            raise problems[0]

    def prepare_clock(self, seconds: int) -> dict[str, str]:
        """Return the environment of a process whose wall clock jumps by some seconds at `step_clocks`."""
        return machine.build_clock(self.folder, seconds)

    def step_clocks(self) -> None:
        """Make the wall clocks of all prepared processes jump, including processes that start later."""
        (self.folder / "stepped").touch()

    def prepare_disk(self, name: str) -> None:
        """Mount a small disk where a process writes its log."""
        machine.mount_small_disk(self.log_folder(name))
        self.cleanups.append(lambda: machine.unmount(self.log_folder(name)))

    def fill_disk(self, name: str) -> None:
        """Fill the remaining space of a small disk."""
        machine.fill_disk(self.log_folder(name) / "ballast")

    def free_disk(self, name: str) -> None:
        """Free the space that `fill_disk` filled."""
        (self.log_folder(name) / "ballast").unlink()

    def join_line(self, system: int, component: int, key: SigningKey | None) -> tuple[Link, Endpoint]:
        """Join the link as another station that bypasses the relay, with a key or without."""
        endpoint = Endpoint(self.knowledge.dialect, system, component, key, unsigned=key is None, datagrams=True)
        return open_link(self.ends.listen), endpoint

    def let_fly(self, seconds: float) -> None:
        """Wait while the vehicle flies, and record the excess of the wait."""
        began = monotonic()
        sleep(max(seconds, 0.0))
        self.overslept_s = max(self.overslept_s, monotonic() - began - max(seconds, 0.0))

    def start_vehicle(self, duration: float, *options: str, **environment: str) -> None:
        """Start a vehicle, and wait until it listens."""
        name = f"vehicle-{len(self.vehicles) + 1}"
        words = ("vehicle", NAME, "--listen", self.ends.listen, "--duration", f"{duration} s", *options)
        self.vehicles.append(self._start_process(name, words, environment))
        self.vehicle.wait_for("listens on")

    def copy_key(self, name: str) -> Path:
        """Copy the vehicle's key to a folder of another computer. Return the folder."""
        keys = self.folder / name / "keys"
        keys.mkdir(parents=True)
        shutil.copy(self._key, keys)
        return keys.parent

    def start_twin(self) -> None:
        """Start another vehicle on the same link, and wait until it listens."""
        assert isinstance(self.ends, Datagrams)
        name, listen = f"vehicle-{len(self.vehicles) + 1}", self.ends.add_vehicle()
        elsewhere = {"TRIMTAB_CONFIG": str(self.copy_key("twin"))}
        self.vehicles.append(self._start_process(name, ("vehicle", NAME, "--listen", listen), elsewhere))
        self.vehicle.wait_for("listens on")

    def start_autopilot(self, duration: float, *options: str, scenario: str = NAME, **environment: str) -> None:
        """Start an autopilot. It arms the vehicle on its own, once."""
        name = f"autopilot-{len(self.autopilots) + 1}"
        words = ("fly", scenario, "--link", self.ends.link, "--duration", f"{duration} s", *options)
        self.autopilots.append(self._start_process(name, words, environment))

    def start_refused(self, *options: str, scenario: str = NAME, **environment: str) -> str:
        """Start an autopilot that must be refused. Return the command that the refusal suggests, or an empty text."""
        name = f"refused-{len(self.refused) + 1}"
        words = ("fly", scenario, "--link", self.ends.link, "--duration", "1 s", *options)
        self.refused.append(self._start_process(name, words, environment))
        self.refused[-1].finish()
        fix = re.search(r"^Fix: trimtab (.*?)(?:   .*)?$", self.refused[-1].output_text, re.MULTILINE)
        return fix[1] if fix else ""

    def start_as_told(self, typed: str, duration: float, **environment: str) -> None:
        """Start an autopilot with a suggested command, with the vehicle's key for `--key FILE`."""
        words = shlex.split(typed.replace("--key FILE", f"--key {shlex.quote(str(self._key))}"))
        for option, value in (("--out", None), ("--duration", f"{duration} s")):
            at = words.index(option)
            words[at : at + 2] = [] if value is None else [option, value]
        words = [word for word in words if word != "--json"]
        name = f"autopilot-{len(self.autopilots) + 1}"
        self.autopilots.append(self._start_process(name, tuple(words), environment))

    def _start_process(self, name: str, words: tuple[str, ...], environment: dict[str, str]) -> Process:
        given = {**self._environment, **environment}
        return Process(*words, "--out", str(self.log_folder(name)), folder=self.folder, name=name, environment=given)

    def wait_for_arming(self, times: int = 1) -> None:
        """Wait until the vehicle has been armed this number of times."""
        self.vehicle.wait_for("computer: arm request", times)

    def inject_fault(self, text: str) -> None:
        """Inject a fault, as `trimtab inject` does."""
        with self.open_injector() as injector:
            injector.inject(plan_fault(self.knowledge.scenario, text, self.knowledge.names))

    @contextlib.contextmanager
    def open_injector(self) -> Iterator[Injector]:
        """Join the link as an injector that bypasses the relay.

        Only one is open at a time, as all are the same sender.
        """
        with self._injecting:
            link, endpoint = self.join_line(*INJECTOR, self.key)
            try:
                yield Injector(link, endpoint)
            finally:
                endpoint.close()
                link.close()

    def start_second(self, name: str, *options: str) -> None:
        """Start a second `trimtab fly` with the same key, from another computer's folder, bypassing the relay."""
        line = ("--link", self.ends.listen, "--duration", "1 s", "--out", str(self.log_folder(name)))
        environment = {"TRIMTAB_CONFIG": str(self.copy_key("second"))}
        words = ("fly", NAME, *line, *options)
        self.autopilots.append(Process(*words, folder=self.folder, name=name, environment=environment))

    def finish(self) -> list[ProcessResult]:
        """Wait until all processes have ended, and return their results."""
        for one in (*self.autopilots, *self.vehicles):
            one.finish()
        return [self._process_result(p, "vehicle.mcap") for p in self.vehicles] + [
            self._process_result(p, "flight.mcap") for p in (*self.autopilots, *self.refused)
        ]

    def _process_result(self, process: Process, log: str) -> ProcessResult:
        file = self.log_folder(process.name) / log
        said = process.output_text
        return ProcessResult(process.name, process.status, said, process.result, file, partial(read_mcap, file))

    def end_vehicles(self) -> None:
        """Ask all vehicles to end, as a user would."""
        for vehicle in self.vehicles:
            vehicle.send(signal.SIGINT)

    def close(self) -> None:
        """End all processes and the relay, and clean up."""
        for one in (*self.autopilots, *self.vehicles, *self.refused):
            if one.status is None:
                one.kill()
        self.relay.close()
        for clean in reversed(self.cleanups):
            clean()


def remove_folder(folder: Path) -> None:
    """Remove a case's folder if it is not kept."""
    shutil.rmtree(folder, ignore_errors=True)
