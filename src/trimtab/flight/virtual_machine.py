"""Computers in virtual time. Each computer has a network name, a clock and a disk, and runs one live program at a time.

Source: docs page, Testing.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from trimtab.flight.machine import Machine
from trimtab.flight.mavlink.authority import MOST_SESSIONS
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.output_port import OutputPort
from trimtab.flight.outputs import START_S, OutputsOrders, OutputsProcess
from trimtab.flight.outputs_process import GONE, HANGS, STOPPED, OutputsLoop, open_log
from trimtab.flight.real_time import RealTimeGrant
from trimtab.flight.transports.open_link import parse_uri
from trimtab.flight.transports.udp import UdpLink
from trimtab.flight.virtual_disk import VirtualDisk
from trimtab.flight.virtual_network import Host, VirtualNetwork
from trimtab.flight.virtual_terminal import VirtualLines, VirtualTerminal
from trimtab.flight.virtual_time import VirtualClock, VirtualProgram, VirtualTime

LOOK_S = 0.001
"""Time (s) between two checks whether a process has ended."""


class VirtualMachine:
    """Computer in virtual time. All programs that are started on one computer, one after the other, use the same
    clock."""

    def __init__(self, time: VirtualTime, network: VirtualNetwork, name: str) -> None:
        """name: name of the computer on the network."""
        self.time, self.network, self.name = time, network, name
        self.disks: list[VirtualDisk] = []
        self.programs: list[VirtualProgram] = []
        self.outputs: list[VirtualProgram] = []
        """Processes of vehicle outputs that were started on this computer, as programs in virtual time."""
        self.interrupts = 0
        """Number of requests to end (as by Ctrl-C) that the running program has received."""
        self.tell: Callable[[str], None] = lambda _: None
        """Function that receives the lines that are printed by the processes of vehicle outputs."""
        self.terminal = VirtualTerminal(time)
        self.port_folder: Path | None = None
        """Folder for the ports of the processes of vehicle outputs, or None to make no ports."""
        self.start_driver: Callable[[Path, VirtualProgram, VirtualProgram], object] = lambda *_: None
        """Function that starts a driver. It is called with the path of a new port, the vehicle's program, and the
        program of the vehicle's outputs."""
        self._sessions = time.random(f"sessions of {name}")

    @property
    def program(self) -> VirtualProgram:
        """Program that was started last."""
        return self.programs[-1]

    @property
    def disk(self) -> VirtualDisk:
        """Disk that is used by the program that was started last."""
        return self.disks[-1]

    def start(self, run: Callable[[Machine], Any], words: Sequence[str] = ()) -> VirtualProgram:
        """Start a program now. run: function of the program, called with the description of this computer.  words:
        arguments of the command line."""
        self.interrupts = 0
        self.disks.append(VirtualDisk(self.time, self.name, lambda line: self.tell(line)))
        disk = self.disk
        before = self.programs[-1].clock if self.programs else None
        program = self.time.start(self.name, lambda clock: run(self._describe(clock, disk, words)), clock=before)
        self.programs.append(program)
        return program

    def interrupt(self) -> None:
        """Request the running program to end, as Ctrl-C does."""
        self.interrupts += 1

    def freeze(self, seconds: float) -> None:
        """Freeze the running program for some seconds, as SIGSTOP does."""
        self.time.freeze(self.program, seconds)

    def kill(self) -> None:
        """End the program immediately, without clean-up, as SIGKILL does."""
        self.disk.is_dead = True
        self.time.kill(self.program)

    def step_clock(self, seconds: float) -> None:
        """Change the wall clock of this computer by a number of seconds."""
        self.time.step_clock(self.program, seconds)

    def _describe(self, clock: VirtualClock, disk: VirtualDisk, words: Sequence[str]) -> Machine:
        program = clock.program

        def open_link(uri: str, *, listen: bool = False) -> UdpLink:
            host, port = parse_uri(uri).host_and_port()
            if listen:
                return UdpLink(self.network.open_socket(program, self.name, port), None, clock)
            peer = Host(self.network.names.get(port, host), port)
            return UdpLink(self.network.open_socket(program, self.name, peer=peer), peer, clock)

        @contextlib.contextmanager
        def write_lines(write: Callable[[str], object]) -> Iterator[VirtualLines]:
            queue = self.terminal.open_queue(write)
            try:
                yield queue
            finally:
                queue.settle()

        @contextlib.contextmanager
        def catch_interrupts() -> Iterator[Callable[[], bool]]:
            yield lambda: self.interrupts > 0

        return Machine(
            clock=clock,
            disk=disk,
            open_link=open_link,
            start_outputs=lambda orders: self._start_outputs(clock, orders),
            real_time=_schedule,
            catch_interrupts=catch_interrupts,
            write_lines=write_lines,
            store_stamps_ahead=lambda endpoint: _keep_stamps(program, endpoint),
            typed_words=lambda: words,
            draw_session=lambda: self._sessions.randrange(1, MOST_SESSIONS),
        )

    def _start_outputs(self, clock: VirtualClock, orders: OutputsOrders) -> OutputsProcess:
        vehicle = clock.program
        near, far = self.network.connect_pair(vehicle)

        def find_cause() -> str:
            if vehicle.has_ended or vehicle.is_killed:
                return GONE
            return STOPPED if vehicle.frozen_until > self.time.now else HANGS

        def run(own: VirtualClock) -> None:
            far.give_to(own.program)
            with contextlib.ExitStack() as files:
                tells: list[Callable[[str], object]] = [lambda line: self.tell(line)]
                if orders.folder is not None:
                    log = files.enter_context(open_log(Path(orders.folder)))
                    tells.insert(0, lambda line: log.write(f"{line}\n"))
                OutputsLoop(far, orders, own, find_cause=find_cause, port=port, tells=tells).serve()

        port = self._open_port(orders)
        program = self.time.start(f"{self.name}'s outputs", run, clock=clock)
        self.outputs.append(program)
        clock.wait(near, START_S)
        near.recv(64)
        if port is not None:
            self.start_driver(port.path, vehicle, program)

        def end() -> None:
            while not program.has_ended:
                clock.wait(None, LOOK_S)

        return OutputsProcess(near, program.number, end)

    def _open_port(self, orders: OutputsOrders) -> OutputPort | None:
        if self.port_folder is None:
            return None
        return OutputPort(
            self.port_folder / f"outputs-{self.name}-{len(self.outputs) + 1}.bin", orders.safe, orders.lift_delay
        )


@contextlib.contextmanager
def _schedule(is_wanted: bool = True) -> Iterator[RealTimeGrant]:
    """Do nothing, because programs in virtual time need no real-time scheduling."""
    yield RealTimeGrant("virtual", False)


@contextlib.contextmanager
def _keep_stamps(program: VirtualProgram, endpoint: Endpoint) -> Iterator[None]:
    """Close the endpoint at the end of this context. If the program was killed, no time stamp is stored."""
    try:
        yield
    finally:
        if program.is_killed:
            endpoint.abandon()
        else:
            endpoint.close()
