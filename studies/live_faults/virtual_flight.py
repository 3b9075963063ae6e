"""Flight of a vehicle, its autopilots and the link between them in virtual time, from one seed.

It has the methods of `flight.FaultFlight`, so the same cases are flown.
"""

import re
import shlex
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from studies.live_faults.case import Case, CaseOutcome, fly_case
from studies.live_faults.driver import OutputsCheck, longest_times
from studies.live_faults.flight import INJECTOR, NAME, UNDISTURBED_S, ProcessResult, VehicleKnowledge
from studies.live_faults.virtual_process import OUTPUTS, VirtualProcess, own_streams
from studies.live_faults.virtual_relay import VEHICLE_PORT, VirtualEnds, VirtualRelay
from trimtab.core.interfaces import Link
from trimtab.flight.injector import Injector, plan_fault
from trimtab.flight.mavlink.authority import MOST_SESSIONS
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import SigningKey, create_key, load_key
from trimtab.flight.mavlink.stamps import running_clock
from trimtab.flight.transports.udp import UdpLink
from trimtab.flight.virtual_machine import VirtualMachine
from trimtab.flight.virtual_network import Host, VirtualNetwork
from trimtab.flight.virtual_time import VirtualClock, VirtualProgram, VirtualTime
from trimtab.logs.mcap import write_mcap

CAMPAIGN = "campaign"
STEP = "STEP_S"
"""Environment variable with the seconds by which a wall clock jumps."""


class VirtualFaultFlight:
    """One vehicle, the autopilots that fly it one after the other, and the link, in virtual time."""

    def __init__(
        self,
        folder: Path,
        known: VehicleKnowledge,
        clock: VirtualClock,
        time: VirtualTime,
        *,
        keeps_logs: bool,
        has_autopilot: bool = True,
    ) -> None:
        """Prepare a flight for the program of the campaign.

        Args:
            folder: folder for keys, and for files of the outputs.
            known: data of the vehicle that the ground has.
            clock: clock of the campaign's program.
            time: virtual time of the flight.
            keeps_logs: True writes logs and output into the folder.
            has_autopilot: False if the vehicle is not flown by `trimtab fly`.
        """
        self.folder, self.knowledge, self.undisturbed_s = folder, known, UNDISTURBED_S
        self.clock, self._time, self._network = clock, time, VirtualNetwork(time)
        self._keeps_logs = keeps_logs
        self.ends, self.relay = VirtualEnds(), VirtualRelay(time, self._network)
        self._network.names[VEHICLE_PORT] = "vehicle-1"
        self._key = folder / "config" / "keys" / "hovercraft.key"
        create_key(self._key, f"{time.random('key').getrandbits(128):032x}")
        self._draw = time.random(CAMPAIGN)
        self._is_stepped = False
        self._injecting = False
        self.overslept_s = 0.0
        self.vehicles: list[VirtualProcess] = []
        self.autopilots: list[VirtualProcess] = []
        self.refused: list[VirtualProcess] = []
        self.cleanups: list[Callable[[], Any]] = []
        self._machines: dict[str, VirtualMachine] = {}
        self._steps: list[tuple[VirtualMachine, float]] = []
        self.output_checks: list[OutputsCheck] = []
        self._bypassing: list[VirtualProcess] = []
        """Autopilots whose packets do not pass the relay."""
        self._has_autopilot = has_autopilot

    @property
    def vehicle(self) -> VirtualProcess:
        """Vehicle that was started last."""
        return self.vehicles[-1]

    @property
    def autopilot(self) -> VirtualProcess:
        """Autopilot that was started last."""
        return self.autopilots[-1]

    @property
    def key(self) -> SigningKey:
        """Key of the vehicle."""
        return load_key(self._key)

    def log_folder(self, name: str) -> Path:
        """Return the folder of a process's log."""
        return self.folder / name

    def now(self) -> float:
        """Return the monotonic time of the campaign (s)."""
        return self._time.seconds

    def pause(self, seconds: float) -> None:
        """Let virtual time pass for the caller: the campaign, or one of the acts of `act_together`."""
        self._clock_of_caller().wait(None, seconds)

    def let_fly(self, seconds: float) -> None:
        """Let the vehicle fly."""
        self.pause(max(seconds, 0.0))

    def _clock_of_caller(self) -> VirtualClock:
        return self._time.running.clock

    def act_together(self, acts: Sequence[Callable[[], None]]) -> None:
        """Do several acts at the same time, and wait for all."""
        started = [self._time.start(f"act {k}", lambda _, act=act: act()) for k, act in enumerate(acts)]
        self._await(started)
        for program in started:
            if program.error is not None:
                raise program.error

    def _await(self, programs: Sequence[VirtualProgram]) -> None:
        while not all(one.has_ended for one in programs):
            self.pause(0.001)

    def start_vehicle(self, duration: float, *options: str, **environment: str) -> None:
        """Start a vehicle, and wait until it listens."""
        name = f"vehicle-{len(self.vehicles) + 1}"
        words = ("vehicle", NAME, "--listen", self.ends.listen, "--duration", f"{duration} s", *options)
        self.vehicles.append(self._start_process(name, words, environment, host="vehicle-1"))
        self.vehicle.wait_for("listens on")

    def start_twin(self) -> None:
        """Start another vehicle on the same link, and wait until it listens."""
        name, config = f"vehicle-{len(self.vehicles) + 1}", {"TRIMTAB_CONFIG": str(self.copy_key("twin"))}
        self.relay.vehicles.append(Host(name, VEHICLE_PORT))
        self.vehicles.append(self._start_process(name, ("vehicle", NAME, "--listen", self.ends.listen), config))
        self.vehicle.wait_for("listens on")

    def copy_key(self, name: str) -> Path:
        """Copy the vehicle's key to a folder of another computer. Return the folder."""
        keys = self.folder / name / "keys"
        keys.mkdir(parents=True)
        shutil.copy(self._key, keys)
        return keys.parent

    def start_autopilot(self, duration: float, *options: str, scenario: str = NAME, **environment: str) -> None:
        """Start an autopilot. It arms the vehicle on its own, once."""
        name = f"autopilot-{len(self.autopilots) + 1}"
        words = ("fly", scenario, "--link", self.ends.link, "--duration", f"{duration} s", *options)
        self.autopilots.append(self._start_process(name, words, environment))

    def start_second(self, name: str, *options: str) -> None:
        """Start a second `trimtab fly` with the same key, from another computer's folder, bypassing the relay."""
        words = ("fly", NAME, "--link", self.ends.listen, "--duration", "1 s", *options)
        config = {"TRIMTAB_CONFIG": str(self.copy_key("second"))}
        self.autopilots.append(self._start_process(name, words, config))
        self._bypassing.append(self.autopilot)

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
        name = f"autopilot-{len(self.autopilots) + 1}"
        self.autopilots.append(self._start_process(name, tuple(w for w in words if w != "--json"), environment))

    def _start_process(
        self, name: str, words: tuple[str, ...], environment: dict[str, str], *, host: str = ""
    ) -> VirtualProcess:
        """Start a process. host: name of its computer, if this differs from the process's name."""
        where = host or name
        machine = self._machines.setdefault(where, VirtualMachine(self._time, self._network, where))
        machine.port_folder, machine.start_driver = self.folder, self._start_driver
        config = Path(environment.get("TRIMTAB_CONFIG", self.folder / "config"))
        signed = () if {"--key", "--unsigned"} & set(words) else ("--key", str(config / "keys" / "hovercraft.key"))
        given = (*words, *signed, "--out", str(self.log_folder(name)))
        process = VirtualProcess(*given, name=name, machine=machine, pause=self.pause)
        if STEP in environment:
            self._steps.append((machine, float(environment[STEP])))
            if self._is_stepped:
                machine.step_clock(float(environment[STEP]))
        return process

    def _start_driver(self, port: Path, vehicle: VirtualProgram, outputs: VirtualProgram) -> None:
        check = OutputsCheck(
            vehicle.name, self._time, {"process": vehicle, "outputs' process": outputs}, self._last_heard
        )
        self.output_checks.append(check)
        self._time.start(f"driver of {vehicle.name}", lambda clock: check.run(clock, port), clock=vehicle.clock)

    def _last_heard(self) -> int:
        """Return the time (ns) when the vehicle last got a packet of an autopilot, as far as the campaign knows."""
        bypasses = any(one.status is None for one in self._bypassing)
        return self._time.now if bypasses or not self._has_autopilot else self.relay.last_sent_up

    def prepare_clock(self, seconds: int) -> dict[str, str]:
        """Return the environment of a process whose wall clock jumps by some seconds at `step_clocks`."""
        return {STEP: str(seconds)}

    def step_clocks(self) -> None:
        """Make the wall clocks of all prepared processes jump, including processes that start later."""
        if not self._is_stepped:
            self._is_stepped = True
            for machine, seconds in self._steps:
                machine.step_clock(seconds)

    def prepare_disk(self, name: str) -> None:
        """Do nothing: every disk of virtual time can be filled."""

    def fill_disk(self, name: str) -> None:
        """Fill the remaining space of the disk of a log."""
        self._machines[name].disk.is_full = True

    def free_disk(self, name: str) -> None:
        """Free the space that `fill_disk` filled."""
        self._machines[name].disk.is_full = False

    def hang_disk(self, name: str, hangs: bool) -> None:
        """Make writes to the disk of a log hang, or continue."""
        self._machines[name].disk.hangs = hangs

    def hang_terminal(self, name: str, hangs: bool) -> None:
        """Make the terminal of a process hang, or continue."""
        self._machines[name].terminal.hangs = hangs

    def starve_process(self, who: str, seconds: float) -> None:
        """Give a process no processor time for a while.

        who: name of a process, or OUTPUTS for the outputs of the vehicle.
        """
        machine = self._machines["vehicle-1" if who == OUTPUTS else who]
        self._time.keep_busy(machine.outputs[-1] if who == OUTPUTS else machine.program, seconds)

    def wait_for_arming(self, times: int = 1) -> None:
        """Wait until the vehicle has been armed this number of times."""
        self.vehicle.wait_for("computer: arm request", times)

    def inject_fault(self, text: str) -> None:
        """Inject a fault, as `trimtab inject` does."""
        with self.open_injector() as injector:
            injector.inject(plan_fault(self.knowledge.scenario, text, self.knowledge.names))

    def join_line(self, system: int, component: int, key: SigningKey | None) -> tuple[Link, Endpoint]:
        """Join the link as another station that bypasses the relay, with a key or without."""
        clock, peer = self._clock_of_caller(), Host("vehicle-1", VEHICLE_PORT)
        socket = self._network.open_socket(clock.program, f"system {system}/{component}", peer=peer)
        endpoint = Endpoint(
            self.knowledge.dialect,
            system,
            component,
            key,
            unsigned=key is None,
            datagrams=True,
            clock=running_clock(clock),
            session=self._draw.randrange(1, MOST_SESSIONS),
        )
        return UdpLink(socket, peer, clock), endpoint

    @contextmanager
    def open_injector(self) -> Iterator[Injector]:
        """Join the link as an injector that bypasses the relay.

        Only one is open at a time, as all are the same sender.
        """
        while self._injecting:
            self.pause(0.001)
        self._injecting = True
        link, endpoint = self.join_line(*INJECTOR, self.key)
        try:
            yield Injector(link, endpoint, self._clock_of_caller())
        finally:
            endpoint.close()
            link.close()
            self._injecting = False

    def finish(self) -> list[ProcessResult]:
        """Wait until all processes have ended, and return their results."""
        for one in (*self.autopilots, *self.vehicles):
            one.finish()
        return [self._process_result(p, "vehicle.mcap") for p in self.vehicles] + [
            self._process_result(p, "flight.mcap") for p in (*self.autopilots, *self.refused)
        ]

    def _process_result(self, process: VirtualProcess, log: str) -> ProcessResult:
        file = self.log_folder(process.name) / log
        if self._keeps_logs:
            (self.folder / f"{process.name}.said").write_text(process.output_text, "utf-8")
            if process.disk.logs:
                write_mcap(process.read_log(), file)
        return ProcessResult(process.name, process.status, process.output_text, process.result, file, process.read_log)

    def end_vehicles(self) -> None:
        """Ask all vehicles to end, as a user would."""
        for vehicle in self.vehicles:
            vehicle.send(signal.SIGINT)

    def close(self) -> None:
        """Kill all processes that still run."""
        for one in (*self.autopilots, *self.vehicles, *self.refused):
            if one.status is None:
                one.kill()


def fly_in_virtual_time(
    case: Case, known: VehicleKnowledge, folder: Path, seed: int, *, keeps_logs: bool = False
) -> CaseOutcome:
    """Fly a case in virtual time, and return its outcome. keeps_logs: True writes the logs into the folder."""
    if case.serial:
        why = "virtual time has no serial devices: needs --real-time"
        return CaseOutcome(case.name, case.does, "", (), (), why)
    time = VirtualTime(seed)

    def run(clock: VirtualClock) -> CaseOutcome:
        flights: list[VirtualFaultFlight] = []

        def open_flight(folder: Path, known: VehicleKnowledge, *, serial: bool = False) -> Any:
            options = {"keeps_logs": keeps_logs, "has_autopilot": case.has_autopilot}
            flights.append(VirtualFaultFlight(folder, known, clock, time, **options))
            return flights[-1]

        outcome = fly_case(case._replace(missing_requirement=lambda: ""), known, folder, open_flight)
        checks = [check for flight in flights for check in flight.output_checks]
        late = [problem for check in checks for problem in check.list_violations(case.command_delay_s)]
        return outcome._replace(problems=(*outcome.problems, *late), acted_s=longest_times(checks))

    campaign = time.start(CAMPAIGN, run)
    with own_streams():
        time.run(campaign)
    if campaign.error is not None:
        raise campaign.error
    return campaign.result._replace(digest=time.digest)
