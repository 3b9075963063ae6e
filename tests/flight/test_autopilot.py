"""Whole flights in virtual time: a vehicle, its outputs, an autopilot, a network, two logs."""

import random
import time

import numpy as np
import pytest
from flight.mavlink.line import every
from flight.virtual_pair import LISTEN, VirtualPair, events, fly_pair
from repeat import busy_loops
from run.stand_ins import dialect

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.flight.control_loop import SERVO_FRAME
from trimtab.flight.virtual_machine import VirtualMachine
from trimtab.run.replay import replay
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
LENGTH = seconds("1.5")


@pytest.fixture(scope="module")
def scenario():
    return catalogue.load_scenario("hovercraft/zero-velocity")[0]


@pytest.fixture(scope="module")
def flown(scenario):
    """One flight, used by the tests below. Samples received in the pause before the flight are discarded."""
    return fly_pair(scenario, pause=0.3, duration=LENGTH)


def test_flight_arms_flies_its_duration_and_disarms(flown):
    assert flown.flight.arming_time is not None
    assert flown.flight.t - flown.flight.arming_time >= LENGTH
    assert flown.served.release_time is not None
    assert flown.served.disarm_time - flown.served.release_time >= LENGTH
    assert flown.served.disarm_time < flown.served.t
    assert (flown.flight.problems, flown.served.problems) == ((), ())
    told = events(flown.truth)
    armed, disarmed, ended = map(told.index, ("computer: arm request", "disarmed: disarm request", "ended by request"))
    assert armed < disarmed < ended
    assert any("computer: arm request" in line for line in flown.said)


def test_samples_discarded_before_flight_are_not_counted_lost(flown):
    assert flown.flight.log.whole
    assert not flown.log["link.lost"][:100].any()


def test_vehicle_is_held_until_armed_then_moves(flown):
    """In the scenario a sliding and spinning craft is brought to rest."""
    truth, held = flown.truth, flown.truth["firmware.held"].astype(bool)
    speed, yaw = np.hypot(truth["truth.surge_velocity"], truth["truth.sway_velocity"]), truth["truth.yaw_rate"]
    assert held.any()
    assert (speed[held] == speed[0]).all()
    vehicle = flown.scenario.world.vehicle
    energy = vehicle.mass * speed**2 / 2 + vehicle.inertia * yaw**2 / 2
    assert energy[-1] < 0.9 * energy[0]


def test_every_step_is_in_the_log(flown):
    written, kept = flown.flight.log, flown.flight.deadlines
    assert (written.dropped, written.unwritten, written.whole) == (0, 0, True)
    assert written.rows == len(flown.log) == kept.step.summary().n
    period = flown.scenario.autopilot.period
    assert (np.diff(flown.log.ticks) % period == 0).all()
    assert flown.log["loop.skipped"][-1] == flown.flight.skipped
    assert flown.log["vehicle.armed"][-1] == 1
    assert flown.log["link.samples"][-1] <= flown.pair.flyer.autopilot_end.counts.received


def test_sample_times_match_vehicle_log_less_clock_offset(flown):
    """Sample times increase and equal those of the vehicle's log, less one offset, within a fraction of a millisecond.

    Each sample's value, measured at a time by the vehicle's clock, is found in the vehicle's own log.
    """
    log, truth = flown.log, flown.truth
    fresh = log["downlink.navigation.fresh"].astype(bool)
    times = log["downlink.navigation.t"][fresh]
    assert fresh.sum() > 100
    assert (np.diff(times) > 0).all()
    name = next(p for p in log.paths if p.startswith("downlink.navigation.value."))
    measured: dict[float, set[int]] = {}
    for v, t in zip(truth[name].tolist(), truth["downlink.navigation.t"].tolist(), strict=True):
        measured.setdefault(v, set()).add(t)
    once = {v: min(at) for v, at in measured.items() if len(at) == 1}  # held, it may measure the same number again
    pairs = [(t, once[v]) for v, t in zip(log[name][fresh].tolist(), times, strict=True) if v in once]
    assert len(pairs) > 100
    offsets = np.array([there - here for here, there in pairs])
    assert np.ptp(offsets) < ms("2.5")  # the applied offset may turn by 1 ms a second
    age = log["downlink.navigation.age"]
    np.testing.assert_allclose(age, (log.ticks - log["downlink.navigation.t"]) * 1e-7, atol=1e-12)


def test_replayed_frames_give_bit_identical_commands(flown):
    found = replay(flown.log, flown.scenario, backend="c")
    assert (found.exact, found.strict, found.equal, found.first) == (True, True, True, None)
    assert len(found.replayed_log) == len(flown.log)


def test_commands_reach_the_actuators_as_they_were_sent(flown):
    sent = {
        tuple(v)
        for v in np.stack([flown.log["command.value.rudder_pulse"], flown.log["command.value.speed_rpm"]], 1).tolist()
    }
    valid = flown.truth["firmware.command.valid"].astype(bool)
    names = ("firmware.command.value.rudder_pulse", "firmware.command.value.speed_rpm")
    obeyed = np.stack([flown.truth[n] for n in names], 1)[valid]
    assert len(obeyed) > 1000
    assert {tuple(v) for v in obeyed.tolist()} <= sent


def test_every_deadline_is_met_on_a_quiet_network(flown):
    kept = flown.flight.deadlines
    assert (kept.own, kept.scheduler, flown.flight.skipped) == (0, 0, 0)
    assert kept.late.longest == 0
    assert np.ptp(flown.log["link.implausible"][flown.log["vehicle.armed"].astype(bool)]) == 0
    assert flown.pair.outputs_said[0].endswith("safe, 0.0 ms after the last row: the vehicle has ended")


def test_commands_are_sent_once_per_servo_frame(flown):
    sent = np.diff(flown.truth.t[flown.truth["firmware.command.fresh"].astype(bool)])
    assert sent.min() > 0.9e-7 * SERVO_FRAME
    assert sent.max() < 1.1e-7 * SERVO_FRAME


def test_same_seed_gives_same_hash_and_others_differ(scenario, flown):
    assert fly_pair(scenario, pause=0.3, duration=LENGTH).digest == flown.digest
    assert fly_pair(scenario, 2, pause=0.3, duration=LENGTH).digest != flown.digest


@pytest.mark.parametrize("overrun", ["halt", "count"])
def test_overrun_halts_the_flight_or_is_counted(scenario, overrun):
    def work(pair):
        pair.time.keep_busy(pair.flying, 0.2)

    one = fly_pair(scenario, act=work, duration=LENGTH, overrun=overrun)
    halted = overrun == "halt"
    assert one.flight.deadlines.scheduler == 0
    assert one.flight.deadlines.own == 1 if halted else one.flight.deadlines.own > 150
    assert ("an overrun: the work of period" in one.flight.cause) == halted == (one.flight.cause in one.flight.problems)
    assert (f"ended: {one.flight.cause}" in one.said) == halted == (one.flight.t < LENGTH)
    assert (f"ended: {one.flight.cause}" in events(one.log)) == halted
    assert one.pair.vehicle.duties.mode.mode == "disarmed"


def test_scheduler_stall_is_not_counted_as_own_overrun(scenario):
    one = fly_pair(scenario, act=lambda pair: pair.here.freeze(0.2), duration=LENGTH)
    assert one.flight.deadlines.own == 0
    assert one.flight.deadlines.scheduler > 150
    assert one.flight.deadlines.late.longest == pytest.approx(0.2e9, rel=0.01)


def test_autopilot_skips_missed_periods_after_a_stall(scenario):
    one = fly_pair(scenario, act=lambda pair: pair.here.freeze(1.0), duration=seconds(3))
    assert one.flight.skipped == pytest.approx(1000, abs=2)
    assert any(text.startswith(("this end stalled for 0.99", "this end stalled for 1.0")) for text in events(one.log))
    assert any(text.startswith("failsafe: no command") for text in events(one.truth))
    t = one.truth.t[one.truth["firmware.mode"] == 3][0]
    last = one.truth.t[one.truth["firmware.command.fresh"].astype(bool) & (one.truth.t < t)][-1]
    assert t - last == pytest.approx(0.25, abs=0.0015)


def test_flood_of_unsigned_packets_delays_no_period(scenario):
    """Sixty unsigned packets per millisecond are refused. Samples and commands continue."""

    def pour(pair):
        def flood(machine):
            link = machine.open_link("udp://127.0.0.1:14550")
            for k in range(300):
                for _ in range(60):
                    link.send(bytes([k % 256]) * 40)
                machine.clock.wait(None, 0.001)

        VirtualMachine(pair.time, pair.network, "attacker").start(flood)

    one = fly_pair(scenario, act=pour, duration=LENGTH)
    assert one.truth["wire.garbage"][-1] > 300 * 60 * 30
    assert "failsafe:" not in " ".join(events(one.truth))
    assert one.served.lateness.longest == 0


def test_lost_commands_are_counted_without_failsafe(scenario):
    def drop(pair):
        pair.network.path("autopilot", "vehicle").cut_until = pair.time.now + 50_000_000

    one = fly_pair(scenario, act=drop, duration=LENGTH)
    assert 2 <= one.truth["wire.lost"][-1] <= 5
    assert "failsafe:" not in " ".join(events(one.truth))


@pytest.mark.parametrize("kind", ["kill", "freeze"])
def test_outputs_go_safe_50_ms_after_the_last_row(scenario, kind):
    def stop(pair):
        getattr(pair.there, kind)(*([] if kind == "kill" else [0.1]))

    pair = VirtualPair(scenario)
    pair.start_vehicle(until=lambda: pair.time.seconds > 4.0)
    pair.start_autopilot(duration=LENGTH)
    pair.when_armed(lambda: stop(pair))
    pair.run()
    first = pair.outputs_said[0]
    if kind == "kill":
        assert first.endswith(": the vehicle's process is gone")
        assert float(first.split("safe, ")[1].split(" ms")[0]) <= 5.1
    else:
        assert "safe, 50.0 ms after the last row: the vehicle's process is stopped" in first
        truth = pair.logs()[1]
        assert "outputs went safe: no data for" in " ".join(events(truth))
        assert truth["firmware.late"].max() == pytest.approx(0.1, abs=0.001)
    assert pair.outputs_said[-1].endswith(("at rest; the vehicle's process is gone", "at rest; the vehicle has ended"))


def test_vehicle_ends_and_reports_dead_outputs_process(scenario):
    one = fly_pair(scenario, act=lambda pair: pair.time.kill(pair.there.outputs[-1]), duration=seconds(3))
    assert "the outputs' process died" in one.served.problems
    assert "ended: the outputs' process died" in events(one.truth)


def test_vehicle_ends_within_100_ms_of_frozen_outputs(scenario):
    one = fly_pair(scenario, act=lambda pair: pair.time.freeze(pair.there.outputs[-1], 2.0), duration=seconds(3))
    assert "the outputs' process is frozen" in one.served.problems
    times = {event["text"]: event["t"] for event in one.truth.metadata["events"]}
    frozen_at = times["computer: arm request"] + 0.5  # or up to 10 ms later, see VirtualPair.when_armed
    assert 0.09 < times["ended: the outputs' process is frozen"] - frozen_at < 0.11
    assert "at rest; the vehicle has ended" in one.pair.outputs_said[-1]


def test_rejects_clock_an_hour_ahead_and_names_difference(scenario):
    pair = VirtualPair(scenario)
    pair.start_vehicle()
    pair.there.step_clock(3600.0)
    pair.start_autopilot(duration=LENGTH)
    with pytest.raises(InputError, match=r"wrong clock: clocks differ by 3600\.\d s"):
        pair.run()


def test_autopilot_interrupted_before_arming_sends_no_disarm(scenario):
    """Another pilot may be flying the vehicle."""

    def fly(flyer, machine):
        flyer.link.send(flyer.endpoint.pack("COMMAND_LONG", {"command": 400, "param1": 1.0}))
        while pair.vehicle.release_time is None:
            flyer.link.receive(0.01)
        flight = flyer.fly(stop=lambda: True)
        machine.clock.wait(None, 0.1)
        return flight, pair.vehicle.duties.mode

    pair = VirtualPair(scenario)
    pair.start_vehicle()
    pair.start_autopilot(fly)
    pair.run()
    flight, mode = pair.flying.result
    assert (flight.arming_time, flight.t, flight.log) == (None, 0, None)
    assert mode == ("computer", "arm request")


def test_connect_without_vehicle_suggests_the_vehicle_command(scenario):
    def run(machine):
        flyer = pair.make_autopilot(machine)
        with pytest.raises(InputError, match="no vehicle answers") as refused:
            flyer.connect(start_patience=0.1)
        assert f"trimtab vehicle {scenario.name} --listen" in refused.value.fix
        assert pair.time.seconds == pytest.approx(0.12, abs=0.021)
        flyer.connect(patience=30.0, stop=lambda: True)
        assert pair.time.seconds < 0.2

    pair = VirtualPair(scenario)
    pair.flying = pair.here.start(run)
    pair.run()


def test_fly_waits_for_a_vehicle_that_starts_a_minute_later(scenario):
    pair = VirtualPair(scenario)

    def fly(machine):
        flyer = pair.make_autopilot(machine)
        flyer.connect(tell=lambda text: pair.said.append((pair.time.seconds, text)))
        return pair.time.seconds

    pair.flying = pair.here.start(fly)
    pair.time.call_at(60.0, lambda: pair.start_vehicle(until=pair.has_autopilot_ended))
    pair.run()
    (told, text), *_ = pair.said
    assert 3.0 < told < 3.1
    assert text.startswith("no vehicle answers: there is no connection yet; waiting 120 s. ")
    assert f"To start the vehicle: trimtab vehicle {scenario.name} --listen" in text
    assert 60.0 < pair.flying.result < 65.0


def test_connect_waits_three_times_longer_if_heartbeats_arrive(scenario):
    """With heartbeats alone the clock stays unknown, and the error names the clock."""

    def beat(machine):
        link = machine.open_link(LISTEN, listen=True)
        theirs = pair.endpoint(machine, pair.flyer.endpoint.dialect, 1)
        link.receive(1.0)
        link.accept_sender()
        link.send(theirs.pack("HEARTBEAT", {"autopilot": 0}))
        machine.clock.wait(None, 5.0)

    def run(machine):
        flyer = pair.make_autopilot(machine)
        pair.there.start(beat)
        with pytest.raises(InputError, match="its clock is not known yet"):
            flyer.connect(patience=0.1)
        assert pair.time.seconds == pytest.approx(0.32, abs=0.021)

    pair = VirtualPair(scenario)
    pair.flying = pair.here.start(run)
    pair.run()


def test_rejects_vehicle_with_different_sensors_before_arming(scenario):
    def run(machine):
        _, other = dialect({"compass": every()}, every())
        flyer, theirs = pair.make_autopilot(machine), pair.endpoint(machine, other, 1)
        beat = theirs.pack("HEARTBEAT", {"autopilot": 0})
        version = theirs.pack("AUTOPILOT_VERSION", {"flight_custom_version": theirs.dialect.fingerprint})
        for packet in (beat, version):
            flyer.parts.handle_data(packet)
        with pytest.raises(InputError, match="different sensors") as refused:
            flyer.connect(patience=30.0)
        assert "the same --set on both ends" in refused.value.fix

    pair = VirtualPair(scenario)
    pair.flying = pair.here.start(run)
    pair.run()


def test_rejects_vehicle_of_different_mass_unless_accepted(scenario):
    def run(machine):
        flyer = pair.make_autopilot(machine)
        with pytest.raises(
            InputError, match=r"wrong scenario: .*\n  world\.vehicle\.mass: 2\.8 on the vehicle, 2\.6 here"
        ) as refused:
            flyer.connect()
        assert "--accept world.vehicle.mass" in refused.value.fix
        meant = pair.make_autopilot(machine, accepts=["world.vehicle.mass"])
        meant.connect(tell=pair.said.append)
        assert meant.remote.is_ready
        assert "accepted: world.vehicle.mass: 2.8 on the vehicle, 2.6 here" in pair.said

    heavier = replace(scenario, world=replace(scenario.world, vehicle=replace(scenario.world.vehicle, mass=2.8)))
    pair = VirtualPair(scenario)
    pair.start_vehicle(heavier)
    pair.flying = pair.here.start(run)
    pair.run()


@pytest.mark.thorough
@pytest.mark.timeout(3600)
def test_hash_of_each_seed_is_unaffected_by_load(scenario):
    """The second flight of each seed runs with a busy loop and random sleeps at one hand-over in a thousand."""
    draw, digests = random.Random(), set()
    for seed in range(100):
        quiet = fly_pair(scenario, seed, duration=seconds("0.5")).digest
        with busy_loops(1):
            other = fly_pair(
                scenario,
                seed,
                duration=seconds("0.5"),
                hand_over=lambda: time.sleep(draw.uniform(0.0, 1e-3)) if draw.random() < 1e-3 else None,
            )
        assert other.digest == quiet
        digests.add(quiet)
    assert len(digests) == 100
