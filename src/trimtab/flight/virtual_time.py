"""Virtual time: simulation in which live programs share one clock, which advances only when all programs wait.

Each program (vehicle, outputs, autopilot, ground station, injector, attacker) is a thread. Only one thread runs at a
time, the one that holds the baton. A thread hands the baton over when it waits in `Clock.wait`. The program of the
earliest event (packet, deadline or action) is next. Simultaneous events are ordered by kind, then by the order in which
their programs were started. So each seed leads to one sequence of events, independent of the speed of the machine.

During a simulation, a program can be frozen, killed or kept busy, and its wall clock can be changed.
Source: docs page, Testing; J. Zhou et al., "FoundationDB", SIGMOD 2021, section 4 (simulation of a whole system).
"""

import hashlib
import heapq
import math
import random
import threading
from collections.abc import Callable
from typing import Any

from trimtab.core.clock import NS_PER_SECOND, Waitable

ACTION, PACKET, WAKE = range(3)
"""Kinds of events, in the order in which simultaneous events are processed."""
UNIX_START = 1_780_000_000.0
"""Wall-clock time at the start of virtual time (s since 1970)."""
LONGEST_BOOT = 100 * NS_PER_SECOND
"""Largest monotonic time (ns) of a program at the start of virtual time. Each machine has a different random boot
time."""
CLOCK_ERROR = 1e-3
"""Largest lead (s) of a machine's wall clock over virtual time. Each machine has a different random lead."""
MOST_HAND_OVERS = 1_000_000
"""Number of hand-overs of the baton without progress of virtual time above which a program counts as hanging."""
MOST_TIME = 3600 * NS_PER_SECOND
"""Virtual time (ns) after which a run counts as hanging."""


class KilledError(BaseException):
    """Exception that ends the thread of a killed program. It is a BaseException, so that handlers of ordinary errors do
    not catch it."""


class VirtualTimeError(Exception):
    """Error of a simulation in virtual time: no program can wake up, or a program hangs."""


class VirtualProgram:
    """Program that runs in virtual time: a thread with a clock."""

    def __init__(self, name: str, number: int, run: Callable[["VirtualClock"], Any], clock: "VirtualClock") -> None:
        self.name, self.number, self.clock = name, number, clock
        self.result: Any = None
        """Return value of the program's function."""
        self.error: BaseException | None = None
        """Exception that the program's function raised."""
        self.has_ended = self.is_killed = self.is_adopted = False
        self.is_waiting, self.ready, self.deadline, self.turn = False, None, math.inf, 0
        self.ready: Any
        self.frozen_until: float = 0
        self.work = self.cpu = 0
        """Remaining busy time (ns) of the program, and processor time (ns) that the program has used."""
        self.busy_until = 0
        """Time (ns) until which the program is kept busy with its own work."""
        self.closers: list[Callable[[], None]] = []
        """Functions to call when the program ends. They close the program's sockets, as the system does when a process
        dies."""
        self.gate = threading.Lock()
        self.gate.acquire()
        self.run = run

    @property
    def exit_reason(self) -> str:
        """Return the state of the program: "running", "ended", "failed" or "killed"."""
        if self.is_killed:
            return "killed"
        return "failed" if self.error else "ended" if self.has_ended else "running"

    def can_act(self, now: int) -> bool:
        """Return True if the program can run at time now (ns), that is, if it has not ended and is neither frozen nor
        kept busy."""
        return not (self.has_ended or self.is_killed) and max(self.frozen_until, self.busy_until) <= now


class VirtualClock:
    """Clock of one program in virtual time."""

    def __init__(self, time: "VirtualTime", boot: int, unix_offset: float) -> None:
        """Start the clock of a program.

        Args:
            time: the virtual time.
            boot: monotonic time (ns) at the start of virtual time.
            unix_offset: lead of the wall clock (s).
        """
        self._time, self._boot, self.unix_offset = time, boot, unix_offset
        self.program: VirtualProgram

    def monotonic_ns(self) -> int:
        """Return the monotonic time (ns)."""
        self._time.pass_work(self.program)
        return self._boot + self._time.now

    def unix(self) -> float:
        """Return the wall clock's time (s since 1970)."""
        return UNIX_START + self._time.now / NS_PER_SECOND + self.unix_offset

    def thread_ns(self) -> int:
        """Return the processor time (ns) of the program, that is, the time for which the program was kept busy."""
        return self.program.cpu

    def wait(self, ready: Waitable | None, timeout: float) -> bool:
        """Wait until an object is ready to read. Return False if the object is not ready after `timeout` seconds."""
        return self._time.wait(self.program, ready, timeout)


class VirtualTime:
    """Scheduler of programs on one virtual clock. Call `start` for each program, then `run`."""

    def __init__(self, seed: int, *, hand_over: Callable[[], None] = lambda: None) -> None:
        """Start with virtual time zero.

        Args:
            seed: seed of all random numbers of the run.
            hand_over: function called at each hand-over of the baton, e.g. to sleep for a random time in a test.
        """
        self.seed, self.now, self._hand_over = seed, 0, hand_over
        self.programs: list[VirtualProgram] = []
        self.running: VirtualProgram
        """Program that holds the baton, or None."""
        self._events: list[tuple[int, int, int, int, Callable[[], VirtualProgram | None]]] = []
        self._count = self._spins = self._spin_time = 0
        self._trace = hashlib.sha256()
        self._error: BaseException | None = None
        self._awaited: tuple[VirtualProgram, ...] = ()
        self._done = threading.Lock()
        self._done.acquire()

    def random(self, name: str) -> random.Random:
        """Return the random generator with this name. Generators with different names are independent."""
        return random.Random(f"{self.seed}/{name}")

    def note(self, *fields: Any) -> None:
        """Add an entry with the current time to the trace of the run."""
        self._trace.update(repr((self.now, *fields)).encode())

    @property
    def digest(self) -> str:
        """Return a hash of all packets, log rows and events so far."""
        return self._trace.hexdigest()

    @property
    def seconds(self) -> float:
        """Return the current virtual time (s)."""
        return self.now / NS_PER_SECOND

    def start(
        self, name: str, run: Callable[[VirtualClock], Any], *, clock: VirtualClock | None = None
    ) -> VirtualProgram:
        """Start a program now.

        Args:
            name: name of the program.
            run: function of the program, called with the program's clock in a new thread.
            clock: clock of an earlier program on the same machine, or None for the clock of a new machine.
        """
        own = self._draw_clock(name) if clock is None else VirtualClock(self, clock._boot, clock.unix_offset)
        program = VirtualProgram(name, len(self.programs), run, own)
        own.program = program
        self.programs.append(program)
        threading.Thread(target=self._run_program, args=(program,), name=name, daemon=True).start()
        self._wait_until(program, None, self.now)
        return program

    def _draw_clock(self, name: str) -> VirtualClock:
        """Return the clock of a machine. The machine's name determines its random boot time and wall-clock error."""
        boot = self.random(f"boot of {name}").randrange(LONGEST_BOOT)
        return VirtualClock(self, boot, CLOCK_ERROR * self.random(f"clock of {name}").random())

    def adopt(self, name: str) -> VirtualProgram:
        """Make the calling thread a program, which holds the baton until it waits. The method `run` must then not be
        called."""
        clock = self._draw_clock(name)
        clock.program = program = VirtualProgram(name, len(self.programs), lambda _: None, clock)
        program.is_adopted = True
        self.programs.append(program)
        self._awaited, self.running = (program,), program
        return program

    def call_at(self, seconds: float, action: Callable[[], Any]) -> None:
        """Call a function at a virtual time (s). The function must not wait."""

        def act() -> None:
            action()

        self.add_event(round(seconds * NS_PER_SECOND), ACTION, 0, act)

    def add_event(self, time: int, kind: int, order: int, action: Callable[[], VirtualProgram | None]) -> None:
        """Call a function at a virtual time (ns).

        Args:
            time: time of the call, not in the past.
            kind: ACTION, PACKET or WAKE.
            order: number of the program that the event concerns, which orders simultaneous events.
            action: the function. It returns the program that wakes up, or None.
        """
        self._count += 1
        heapq.heappush(self._events, (max(time, self.now), kind, order, self._count, action))

    def run(self, *awaited: VirtualProgram) -> None:
        """Run until these programs (default: all) have ended. Then kill the programs that still run.

        Raises:
            VirtualTimeError: no program can wake up, or a program hangs.
        """
        self._awaited = awaited or tuple(self.programs)
        self._pass_on(None)
        self._done.acquire()
        for program in self.programs:
            if not program.has_ended:
                self._awaited = ()
                self.kill(program)
                program.gate.release()
                self._done.acquire()
        if self._error is not None:
            raise self._error

    def freeze(self, program: VirtualProgram, seconds: float = math.inf) -> None:
        """Freeze a program for some seconds, or until `thaw` is called, as SIGSTOP does. Packets still arrive."""
        program.frozen_until = self.now + seconds * NS_PER_SECOND
        if seconds < math.inf:
            self.add_event(round(program.frozen_until), WAKE, program.number, lambda: self._thaw(program))

    def thaw(self, program: VirtualProgram) -> None:
        """Let a frozen program continue, as SIGCONT does."""
        program.frozen_until = self.now
        self.add_event(self.now, WAKE, program.number, lambda: self._thaw(program))

    def kill(self, program: VirtualProgram) -> None:
        """End a program immediately, without clean-up, as SIGKILL does."""
        if program.has_ended or program.is_killed:
            return
        program.is_killed, program.frozen_until = True, 0
        for close in program.closers:
            close()
        self._wait_until(program, None, self.now)

    def keep_busy(self, program: VirtualProgram, seconds: float) -> None:
        """Keep a program busy for some seconds, starting when the program next reads the clock."""
        program.work += round(seconds * NS_PER_SECOND)

    def step_clock(self, program: VirtualProgram, seconds: float) -> None:
        """Change the wall clock of a program's machine by a number of seconds."""
        program.clock.unix_offset += seconds

    def wait(self, program: VirtualProgram, ready: Any, timeout: float) -> bool:
        """Wait in a program until an object is ready or the time-out has passed, see `Clock.wait`."""
        self.pass_work(program)
        if ready is not None and ready.has_data():
            return True
        if timeout <= 0:
            self._count_hand_over(program)
            return False
        self._suspend(program, ready, self.now + max(timeout * NS_PER_SECOND, 1))
        return ready is not None and ready.has_data()

    def pass_work(self, program: VirtualProgram) -> None:
        """Suspend the calling program while it is kept busy or frozen."""
        if program.is_killed:
            raise KilledError
        while program.work or program.frozen_until > self.now:
            work, program.work = program.work, 0
            program.cpu += work
            program.busy_until = self.now + work
            self._suspend(program, None, self.now + work)

    def is_blocked(self, program: VirtualProgram, ready: Any) -> bool:
        """Return True if a program waits for an object and continues when the object becomes ready."""
        return program.is_waiting and program.ready is ready and program.frozen_until <= self.now

    def wake(self, program: VirtualProgram) -> VirtualProgram:
        """Wake a waiting program, which then holds the baton."""
        program.is_waiting, program.turn = False, program.turn + 1
        self.running = program
        return program

    def _wait_until(self, program: VirtualProgram, ready: Any, deadline: float) -> None:
        program.is_waiting, program.ready, program.deadline, program.turn = True, ready, deadline, program.turn + 1
        turn = program.turn
        if deadline < math.inf:
            self.add_event(math.ceil(deadline), WAKE, program.number, lambda: self._meet_deadline(program, turn))

    def _meet_deadline(self, program: VirtualProgram, turn: int) -> VirtualProgram | None:
        if program.turn != turn or not program.is_waiting or program.frozen_until > self.now:
            return None
        return self.wake(program)

    def _thaw(self, program: VirtualProgram) -> VirtualProgram | None:
        is_due = program.deadline <= self.now or (program.ready is not None and program.ready.has_data())
        if not program.is_waiting or program.frozen_until > self.now or not is_due:
            return None
        return self.wake(program)

    def _suspend(self, program: VirtualProgram, ready: Any, deadline: float) -> None:
        self._count_hand_over(program)
        self._wait_until(program, ready, deadline)
        self._pass_on(program)
        if program.is_killed:
            raise KilledError

    def _count_hand_over(self, program: VirtualProgram) -> None:
        self._spins = self._spins + 1 if self._spin_time == self.now else 0
        self._spin_time = self.now
        if self._spins > MOST_HAND_OVERS:
            self._error = VirtualTimeError(f"{program.name} hangs at {self.seconds:.6f} s: the program never waits")
            program.is_killed = True
            raise KilledError

    def _pass_on(self, program: VirtualProgram | None) -> None:
        """Hand the baton to the next program, and wait until the baton returns."""
        self._hand_over()
        following = self._next_program()
        if following is program and program is not None:
            return
        if following is None:
            adopted = next((one for one in self.programs if one.is_adopted), None)
            if adopted is not None and program is adopted:
                raise self._error or VirtualTimeError("the run is over")
            (adopted.gate if adopted is not None else self._done).release()
        else:
            following.gate.release()
        if program is not None:
            program.gate.acquire()
            if program.is_adopted and self._error is not None:
                raise self._error

    def _next_program(self) -> VirtualProgram | None:
        """Process events until a program wakes up. Return that program, or None if the run is over."""
        try:
            while not all(one.has_ended for one in self._awaited) and self._error is None:
                if not self._events:
                    waiting = ", ".join(p.name for p in self.programs if not p.has_ended)
                    raise VirtualTimeError(
                        f"deadlock at {self.seconds:.6f} s: all running programs wait for each other: {waiting}"
                    )
                self.now, _, _, _, action = heapq.heappop(self._events)
                if self.now > MOST_TIME:
                    raise VirtualTimeError(f"the simulation did not end within {self.seconds:.0f} s")
                program = action()
                if program is not None:
                    return program
        except BaseException as error:
            self._error = error
        return None

    def _run_program(self, program: VirtualProgram) -> None:
        program.gate.acquire()
        try:
            if not program.is_killed:
                program.result = program.run(program.clock)
        except KilledError:
            pass
        except BaseException as error:
            program.error = error
        program.has_ended = True
        for close in program.closers:
            close()
        self.note("end", program.name, program.exit_reason)
        self._pass_on_for_good()

    def _pass_on_for_good(self) -> None:
        following = self._next_program() or next((one for one in self.programs if one.is_adopted), None)
        (self._done if following is None else following.gate).release()
