"""Virtual time: order, freezing, killing, work, and reproducible events for each seed."""

import random
import time as wall

import pytest

from trimtab.core.errors import argument, spell_with
from trimtab.flight import virtual_time
from trimtab.flight.virtual_network import Host, VirtualNetwork
from trimtab.flight.virtual_time import KilledError, VirtualTime, VirtualTimeError


def sleeper(said, name, *waits):
    """A program that waits and records its wakeup times (s)."""

    def run(clock):
        for seconds in waits:
            clock.wait(None, seconds)
            said.append((name, clock._time.seconds))

    return run


def test_programs_wake_in_the_order_of_their_deadlines():
    time, said = VirtualTime(1), []
    time.start("a", sleeper(said, "a", 0.3, 0.3))
    time.start("b", sleeper(said, "b", 0.1, 0.2))
    time.run()
    assert said == [("b", 0.1), ("a", 0.3), ("b", pytest.approx(0.3)), ("a", 0.6)]


def test_programs_due_together_wake_in_start_order():
    time, said = VirtualTime(1), []
    for name in "cab":
        time.start(name, sleeper(said, name, 1.0))
    time.run()
    assert [name for name, _ in said] == ["c", "a", "b"]


def test_time_stands_still_while_a_program_computes():
    time = VirtualTime(1)

    def run(clock):
        before = clock.monotonic_ns()
        wall.sleep(0.01)
        assert clock.monotonic_ns() == before
        assert clock.thread_ns() == 0

    program = time.start("a", run)
    time.run()
    assert (program.error, time.now) == (None, 0)


def test_frozen_program_wakes_late_with_queued_packets():
    time = VirtualTime(1)
    network, woke = VirtualNetwork(time), []

    def listen(clock):
        own = network.open_socket(clock.program, "ear", 5)
        for _ in range(3):
            clock.wait(own, 0.5)
            packets = []
            while own.has_data():
                packets.append(own.recvfrom(100)[0])
            woke.append((time.seconds, packets))

    def speak(clock):
        own = network.open_socket(clock.program, "mouth")
        for k in range(3):
            own.sendto(b"%d" % k, Host("ear", 5))
            clock.wait(None, 0.1)

    ear = time.start("ear", listen)
    time.start("mouth", speak)
    time.call_at(0.05, lambda: time.freeze(ear, 1.0))
    time.run()
    assert woke == [(0.0002, [b"0"]), (1.05, [b"1", b"2"]), (1.55, [])]


def test_thawed_program_resumes_at_once():
    time, said = VirtualTime(1), []
    program = time.start("a", sleeper(said, "a", 0.1, 0.1))
    time.call_at(0.05, lambda: time.freeze(program))
    time.call_at(0.72, lambda: time.thaw(program))
    time.run()
    assert said == [("a", 0.72), ("a", pytest.approx(0.82))]


def test_killed_program_stops_sending_and_frees_its_address():
    time = VirtualTime(1)
    network, heard = VirtualNetwork(time), []
    network.answer_at(Host("ear", 5), lambda data, _: heard.append(data))

    def run(clock):
        own = network.open_socket(clock.program, "mouth", 7)
        try:
            clock.wait(None, 10.0)
        finally:
            with pytest.raises(OSError, match="closed"):
                own.sendto(b"last words", Host("ear", 5))
            with pytest.raises(KilledError):
                clock.monotonic_ns()

    first = time.start("mouth", run)

    def restart():
        time.kill(first)
        time.start("mouth", lambda clock: network.open_socket(clock.program, "mouth", 7), clock=first.clock)

    time.call_at(1.0, restart)
    time.start("end", lambda clock: clock.wait(None, 2.0))
    time.run()
    assert (first.exit_reason, first.error, heard) == ("killed", None, [])
    second = time.programs[-1]
    assert (second.exit_reason, second.error) == ("ended", None)
    assert second.clock._boot == first.clock._boot


def test_only_busy_work_consumes_processor_time():
    time, seen = VirtualTime(1), []

    def run(clock):
        clock.wait(None, 0.1)
        before = clock.monotonic_ns()
        clock.wait(None, 0.1)
        seen.extend([clock.monotonic_ns() - before, clock.thread_ns()])

    program = time.start("a", run)
    time.call_at(0.15, lambda: time.keep_busy(program, 0.3))
    time.run()
    assert seen == [400_000_000, 300_000_000]


def test_wall_clock_step_leaves_monotonic_clock_unchanged():
    time, seen = VirtualTime(1), []

    def run(clock):
        unix, monotonic = clock.unix(), clock.monotonic_ns()
        clock.wait(None, 1.0)
        seen.extend([clock.unix() - unix, clock.monotonic_ns() - monotonic])

    program = time.start("a", run)
    time.call_at(0.5, lambda: time.step_clock(program, -3600.0))
    time.run()
    assert seen == [pytest.approx(-3599.0), 1_000_000_000]


def test_machines_have_different_boot_times():
    time, seen = VirtualTime(1), []
    for name in "ab":
        time.start(name, lambda clock: seen.append(clock.monotonic_ns()))
    time.run()
    assert seen[0] != seen[1]


def test_wall_clocks_differ_between_machines_not_within_one():
    time, said = VirtualTime(1), {}

    def look(name):
        return lambda clock: said.setdefault(name, (clock, clock.unix()))

    for name in ("there", "here"):
        time.start(name, look(name))
    time.run()
    time.start("beside", look("beside"), clock=said["there"][0])
    time.run()
    assert 1e-6 < abs(said["there"][1] - said["here"][1]) < virtual_time.CLOCK_ERROR
    assert said["beside"][1] == said["there"][1]


def test_deadlock_error_names_the_waiting_programs():
    time = VirtualTime(1)
    network = VirtualNetwork(time)

    def run(clock):
        clock.wait(network.open_socket(clock.program, "ear", 5), float("inf"))

    time.start("ear", run)
    with pytest.raises(VirtualTimeError, match=r"deadlock at 0\.000000 s: .*: ear"):
        time.run()


def test_reports_a_program_that_never_waits(monkeypatch):
    monkeypatch.setattr(virtual_time, "MOST_HAND_OVERS", 1000)
    time = VirtualTime(1)

    def spin(clock):
        while True:
            clock.wait(None, 0.0)

    time.start("spinner", spin)
    with pytest.raises(VirtualTimeError, match=r"spinner hangs at 0\.000000 s"):
        time.run()


def test_errors_of_an_action_end_the_run():
    time = VirtualTime(1)
    time.start("a", lambda clock: clock.wait(None, 10.0))
    time.call_at(1.0, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        time.run()


def test_background_programs_are_killed_at_the_end():
    time = VirtualTime(1)

    def forever(clock):
        while True:
            clock.wait(None, 0.3)

    attacker = time.start("attacker", forever)
    time.run(time.start("flight", lambda clock: clock.wait(None, 1.0)))
    assert (attacker.exit_reason, time.seconds) == ("killed", 1.0)


def test_closed_socket_pair_is_seen_at_other_end():
    time = VirtualTime(1)
    network, seen = VirtualNetwork(time), []

    def near(clock):
        a, b = network.connect_pair(clock.program)

        def far(own):
            b.give_to(own.program)
            while data := (own.wait(b, float("inf")) and b.recv(100)):
                seen.append((time.seconds, data))
            seen.append((time.seconds, data))

        time.start("far", far)
        clock.wait(None, 0.1)
        a.send(b"row")
        clock.wait(None, 10.0)

    program = time.start("near", near)
    time.call_at(0.5, lambda: time.kill(program))
    time.start("end", lambda clock: clock.wait(None, 1.0))
    time.run()
    assert seen == [(0.1, b"row"), (0.5, b"")]


def chatter(seed, hand_over=lambda: None):
    """Run three programs that answer each other over a bad network. Return the hash and the packets received."""
    time = VirtualTime(seed, hand_over=hand_over)
    network, heard = VirtualNetwork(time), []
    names = "abc"
    for x in names:
        for y in names:
            path = network.path(x, y)
            path.delay, path.jitter, path.loss, path.double, path.keeps_order = 0.001, 0.02, 0.2, 0.1, False

    def talk(name):
        def run(clock):
            own = network.open_socket(clock.program, name, 9)
            draw = time.random(name)
            while time.seconds < 3.0:
                if clock.wait(own, draw.uniform(0.0, 0.05)):
                    heard.append((time.now, name, own.recvfrom(100)))
                own.sendto(b"%d" % draw.randrange(1000), Host(draw.choice(names), 9))

        return run

    for name in names:
        time.start(name, talk(name))
    time.run()
    return time.digest, heard


def test_same_seed_gives_same_events():
    digest, heard = chatter(3)
    assert chatter(3) == (digest, heard)
    assert len({sender.host for _, _, (_, sender) in heard}) == 3


def test_random_thread_delays_do_not_change_events():
    draw = random.Random()
    assert chatter(3, lambda: wall.sleep(draw.choice((0.0, 0.0, 1e-4)))) == chatter(3)


def test_different_seeds_give_different_events():
    assert len({chatter(seed)[0] for seed in range(5)}) == 5


@pytest.mark.parametrize(("loss", "double"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.25)])
def test_path_loses_and_duplicates_the_configured_share(loss, double):
    path = VirtualNetwork(VirtualTime(5)).path("a", "b")
    path.loss, path.double = loss, double
    arrivals = [len(path.transit(k)) for k in range(10_000)]
    assert arrivals.count(0) / 10_000 == pytest.approx(loss, abs=0.015)
    assert arrivals.count(2) / 10_000 == pytest.approx(double, abs=0.015)


def test_a_path_that_keeps_order_delays_and_never_reorders():
    path = VirtualNetwork(VirtualTime(5)).path("a", "b")
    path.delay, path.jitter = 0.01, 0.05
    arrivals = [at for k in range(1000) for at in path.transit(k * 1_000_000)]
    assert arrivals == sorted(arrivals)
    assert min(at - k * 1_000_000 for k, at in enumerate(arrivals)) >= 10_000_000
    path.keeps_order = False
    free = [at for k in range(1000) for at in path.transit(k * 1_000_000)]
    assert free != sorted(free)
    assert max(at - k * 1_000_000 for k, at in enumerate(free)) < 60_000_000


def test_cut_path_drops_packets_until_its_end():
    path = VirtualNetwork(VirtualTime(5)).path("a", "b")
    path.cut_until = 1000
    assert (path.transit(999), path.transit(1000)) == ([], [201_000])


def test_the_calling_thread_can_be_a_program():
    time, said = VirtualTime(1), []
    clock = time.adopt("test").clock
    time.start("a", sleeper(said, "a", 0.1, 0.1))
    clock.wait(None, 0.15)
    assert said == [("a", 0.1)]
    clock.wait(None, 0.15)
    assert (said[1:], time.seconds) == ([("a", 0.2)], pytest.approx(0.3))
    with pytest.raises(VirtualTimeError, match=r"deadlock at 0\.3"):
        clock.wait(None, float("inf"))


def test_rejects_address_already_in_use():
    time = VirtualTime(1)
    network = VirtualNetwork(time)

    def run(clock):
        network.open_socket(clock.program, "a", 5)
        network.open_socket(clock.program, "a", 5)

    program = time.start("a", run)
    time.run()
    assert "is taken" in str(program.error)


def test_argument_spelling_is_local_to_each_program():
    """Two commands overlap. The end of the first one must not change the spelling of the second one."""
    time, seen = VirtualTime(1), []

    def command(name, seconds):
        def run(clock):
            with spell_with(lambda before, option, value, path: f"{name} {option}"):
                clock.wait(None, seconds)
                seen.append(argument("runs", 3))

        return run

    for name, seconds in (("first", 1.0), ("second", 2.0)):
        time.start(name, command(name, seconds))
    time.run()
    assert seen == ["first runs", "second runs"]
    assert argument("runs", 3) == "runs=3"
