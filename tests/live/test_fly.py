"""A whole flight in one process: a vehicle in a thread, an autopilot, a loopback line, two logs."""

import threading
from time import monotonic, sleep
from types import SimpleNamespace

import numpy as np
import pytest
from run.stand_ins import KEY, dialect
from wire.line import every

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.links.open_link import open_link
from trimtab.live.fly import LiveAutopilot
from trimtab.live.vehicle import LiveVehicle
from trimtab.logs.mcap import read_mcap
from trimtab.native.compiler import find_compiler
from trimtab.run.blocks import replace_links
from trimtab.run.replay import replay
from trimtab.scenarios import catalogue
from trimtab.wire.mavlink import Endpoint

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
LENGTH = seconds("1.5")


class Pair:
    """A vehicle that serves in a thread, and an autopilot that may fly it."""

    def __init__(self, scenario, name, step=None):
        self.there, self.here = open_link(f"loopback://{name}", listen=True), open_link(f"loopback://{name}")
        self.vehicle = LiveVehicle(replace_links(scenario), self.there, lambda d: Endpoint(d, 1, 1, KEY))
        self.flyer = LiveAutopilot(scenario, self.here, lambda d: Endpoint(d, 1, 191, KEY), step=step)
        self._ended, self.served = threading.Event(), []
        self.thread = threading.Thread(target=self._serve)

    def _serve(self):
        self.served.append(self.vehicle.serve(log=self.log, stop=self._ended.is_set))

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


@pytest.fixture(scope="module")
def scenario():
    """Its failsafe waits for longer than a busy machine may keep one of the two threads from running."""
    found = catalogue.load_scenario("hovercraft/zero-velocity")[0]
    return replace(found, failsafe=replace(found.failsafe, timeout=seconds(8), age_max=8.0))


@pytest.fixture
def step(flown):
    flown.pair.flyer.autopilot_end.step.reset()
    return flown.pair.flyer.autopilot_end.step


@pytest.fixture(scope="module")
def flown(scenario, tmp_path_factory):
    """One flight that every test below looks at."""
    folder, said = tmp_path_factory.mktemp("flown"), []
    pair = Pair(scenario, "test-fly")
    pair.start(folder / "vehicle.mcap")
    try:
        pair.flyer.connect()
        sleep(0.3)  # what comes in that time is thrown away
        flight = pair.flyer.fly(duration=LENGTH, log=folder / "flight.mcap", wanted_real_time=False, tell=said.append)
    finally:
        served = pair.end()
    logs = [read_mcap(folder / f"{name}.mcap") for name in ("flight", "vehicle")]
    return SimpleNamespace(
        flight=flight, served=served, log=logs[0], truth=logs[1], said=said, scenario=scenario, pair=pair
    )


def test_it_was_armed_flew_its_time_and_was_disarmed(flown):
    assert flown.flight.arming_time is not None
    assert flown.flight.t - flown.flight.arming_time >= LENGTH
    assert flown.served.release_time is not None
    assert flown.served.disarm_time - flown.served.release_time >= LENGTH
    assert flown.served.disarm_time < flown.served.t
    assert (flown.flight.problems, flown.served.problems) == ((), ())
    told = [event["text"] for event in flown.truth.metadata["events"]]
    armed, disarmed, ended = map(told.index, ("computer: arm request", "disarmed: disarm request", "ended by request"))
    assert armed < disarmed < ended
    assert any("computer: arm request" in line for line in flown.said)


def test_what_came_before_the_flight_and_was_thrown_away_is_no_loss(flown):
    assert flown.flight.log.whole
    assert not flown.log["link.lost"][:100].any()


def test_the_vehicle_is_held_until_then_and_moves_after(flown):
    """The scenario stops a craft that slides and spins."""
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
    assert flown.log["loop.skipped"][-1] == flown.pair.flyer.skipped
    assert flown.log["vehicle.armed"][-1] == 1
    assert flown.log["link.samples"][-1] <= flown.pair.flyer.autopilot_end.received_samples


def test_samples_are_measured_when_the_vehicle_says_on_the_autopilots_clock(flown):
    """Times of samples rise and are those of the vehicle's log, less one offset, to a fraction of a millisecond.

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


def test_the_same_frames_give_the_same_commands_to_the_bit(flown):
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


@pytest.mark.parametrize("overrun", ["halt", "count"])
def test_a_late_period_halts_the_flight_or_is_counted(scenario, step, tmp_path, overrun):
    pair, said, asked = Pair(scenario, f"test-fly-{overrun}", step), [], []
    pair.start()

    def sleep_once_armed():
        asked.append(pair.flyer.arming_time is not None)
        if asked.count(True) == 3:
            sleep(0.2)
        return False

    try:
        pair.flyer.connect()
        flight = pair.flyer.fly(
            duration=LENGTH,
            log=tmp_path / "flight.mcap",
            wanted_real_time=False,
            overrun=overrun,
            stop=sleep_once_armed,
            tell=said.append,
        )
    finally:
        pair.end()
    assert flight.deadlines.own + flight.deadlines.scheduler >= 1
    halted, log = overrun == "halt", read_mcap(tmp_path / "flight.mcap")
    assert ("an overrun: the work of period" in flight.cause) == halted == (flight.cause in flight.problems)
    assert (f"ended: {flight.cause}" in said) == halted == (flight.t < LENGTH)
    assert (f"ended: {flight.cause}" in [e["text"] for e in log.metadata["events"]]) == halted
    assert pair.vehicle.duties.mode.mode == "disarmed"


def test_interrupted_before_it_was_armed_it_disarms_nobody(scenario, step):
    """Somebody else may be flying the vehicle."""
    pair = Pair(scenario, "test-fly-stopped", step)
    said = []
    pair.start()
    try:
        pair.flyer.connect()
        pair.here.send(pair.flyer.endpoint.pack("COMMAND_LONG", {"command": 400, "param1": 1.0}))
        end = monotonic() + 10
        while pair.vehicle.release_time is None and monotonic() < end:
            pair.here.receive(0.01)
        flight = pair.flyer.fly(wanted_real_time=False, stop=lambda: True, tell=said.append)
        end = monotonic() + 0.1
        while monotonic() < end:
            pair.here.receive(0.01)
        flown_by = pair.vehicle.duties.mode
    finally:
        pair.end()
    assert (flight.arming_time, flight.t, flight.log) == (None, 0, None)
    assert flown_by == ("computer", "arm request")


def test_where_nobody_answers_it_says_what_to_type(scenario, step):
    link = open_link("loopback://test-fly-nobody")
    try:
        flyer = LiveAutopilot(scenario, link, lambda d: Endpoint(d, 1, 191, KEY), step=step)
        with pytest.raises(InputError, match="no vehicle answers") as refused:
            flyer.connect(patience=0.1)
        assert f"trimtab vehicle {scenario.name} --listen" in refused.value.fix
        began = monotonic()
        flyer.connect(patience=30.0, stop=lambda: True)
        assert monotonic() - began < 5
    finally:
        link.close()


def test_where_frames_come_it_waits_longer_for_the_clock(scenario, step):
    """Heartbeats and nothing else: the clock is never known, and the answer names it, after three times as long."""
    there, link = open_link("loopback://test-fly-deaf", listen=True), open_link("loopback://test-fly-deaf")
    try:
        flyer = LiveAutopilot(scenario, link, lambda d: Endpoint(d, 1, 191, KEY), step=step)
        theirs = Endpoint(flyer.endpoint.dialect, 1, 1, KEY)
        while link.receive(0.0) is None:  # until both ends have met
            there.receive(0.0)
            there.send(b"?")
        there.send(theirs.pack("HEARTBEAT", {"autopilot": 0}))
        began = monotonic()
        with pytest.raises(InputError, match="its clock is not known yet"):
            flyer.connect(patience=0.1)
        assert monotonic() - began >= 0.3
    finally:
        link.close()
        there.close()


def test_a_vehicle_with_other_sensors_is_refused_before_it_is_armed(scenario, step):
    _, other = dialect({"compass": every()}, every())
    link = open_link("loopback://test-fly-other")
    try:
        flyer = LiveAutopilot(scenario, link, lambda d: Endpoint(d, 1, 191, KEY), step=step)
        theirs = Endpoint(other, 1, 1, KEY)
        beat = theirs.pack("HEARTBEAT", {"autopilot": 0})
        version = theirs.pack("AUTOPILOT_VERSION", {"flight_custom_version": theirs.dialect.fingerprint})
        for packet in (beat, version):
            flyer._handle_data(packet)
        with pytest.raises(InputError, match="other sensors") as refused:
            flyer.connect(patience=30.0)
        assert "the same --set on both ends" in refused.value.fix
    finally:
        link.close()


def test_a_vehicle_of_another_mass_is_refused_by_path_and_flown_where_that_is_meant(scenario, step):
    heavier = replace(scenario, world=replace(scenario.world, vehicle=replace(scenario.world.vehicle, mass=2.8)))
    there, here = open_link("loopback://test-fly-mass", listen=True), open_link("loopback://test-fly-mass")
    vehicle = LiveVehicle(replace_links(heavier), there, lambda d: Endpoint(d, 1, 1, KEY))
    ended, said = threading.Event(), []
    serving = threading.Thread(target=vehicle.serve, kwargs={"stop": ended.is_set})
    serving.start()
    try:
        flyer = LiveAutopilot(scenario, here, lambda d: Endpoint(d, 1, 191, KEY), step=step)
        with pytest.raises(
            InputError, match=r"wrong scenario: .*\n  world\.vehicle\.mass: 2\.8 there, 2\.6 here"
        ) as refused:
            flyer.connect()
        assert "--accept world.vehicle.mass" in refused.value.fix
        meant = LiveAutopilot(
            scenario, here, lambda d: Endpoint(d, 1, 191, KEY), step=step, accepts=["world.vehicle.mass"]
        )
        meant.remote.tell = said.append
        meant.connect()
        assert meant.remote.is_ready
        assert "accepted: world.vehicle.mass: 2.8 there, 2.6 here" in said
    finally:
        ended.set()
        serving.join(20)
        here.close()
        there.close()
