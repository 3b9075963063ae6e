"""Each check before arming, just inside and just outside of its limit, on the vehicle and on the autopilot.

The vehicle and the compiled autopilot are stand-ins that have only what the checks read.
"""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from trimtab.actuators.drive import drive_failsafe
from trimtab.core.record import Quantity
from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.endpoint import FrameCounts
from trimtab.flight.mavlink.time_sync import TimeSync
from trimtab.flight.prearm import CHECK_PERIOD, ArmingGuard
from trimtab.flight.preflight import Preflight
from trimtab.flight.station.arming import RemoteChecks
from trimtab.loop.supervisor import CHECKS
from trimtab.loop.vehicle_limits import VehicleLimits

FOLDER = Path("/virtual")
ALPHA = "downlink.vane.value.alpha"


class Disk:
    """Disk whose free space the test sets."""

    def __init__(self):
        self.free_mb = 1000.0

    def free_bytes(self, folder):
        assert folder == FOLDER
        return round(self.free_mb * 1e6)


class Vehicle:
    """Guard of a vehicle that has received 100 frames, and whose only sensor measures the angle of attack."""

    def __init__(self):
        slots = {"downlink.vane.t": 0, "downlink.vane.valid": 1, ALPHA: 2}
        self.world = SimpleNamespace(writes=slots, outputs=np.array([0.0, 1.0, 0.0]))
        self.samples, self.scenario = {"vane": None}, SimpleNamespace(world=SimpleNamespace(sensors={}))
        self.counts, self.disk, self.radio = FrameCounts(), Disk(), None
        limits = VehicleLimits(angle=0.2)
        self.guard = ArmingGuard(self, limits, drive_failsafe(), self.counts, lambda now: self.radio, self.disk)
        self.guard.log_folder = FOLDER
        for k in range(12):
            self.receive(10, at=k * ms(100))
        self.t = k * ms(100)
        assert self.guard.problem == ""

    def receive(self, accepted, lost=0, *, at):
        """Receive and lose frames, and follow the guard at that time."""
        self.counts.accepted += accepted
        self.counts.lost += lost
        self.guard.follow(at, "disarmed")

    def check(self, later=CHECK_PERIOD):
        """Return the reason for which arming is refused at a later time."""
        self.guard.follow(self.t + later, "disarmed")
        assert self.guard.may_be_armed == (self.guard.problem == "")
        return self.guard.problem


def keep_silent(vehicle, time_s):
    return vehicle.check(round(time_s * seconds(1)))


def lose_frames(vehicle, lost):
    """20 frames, of which some are lost."""
    vehicle.counts.accepted += 20 - lost
    vehicle.counts.lost += lost
    return vehicle.check()


def silence_receiver(vehicle, time_s):
    vehicle.radio = round(time_s * seconds(1))
    return vehicle.check()


def fill_disk(vehicle, free_mb):
    vehicle.disk.free_mb = free_mb
    return vehicle.check()


def incline(vehicle, angle):
    vehicle.world.outputs[vehicle.world.writes[ALPHA]] = angle
    return vehicle.check()


@pytest.mark.parametrize(
    ("impair", "passing", "failing", "sentence"),
    [
        (keep_silent, 3.0, 3.01, "link silence: 3.01 s, at most 3 s; check the link"),
        (lose_frames, 10, 11, "frames lost: 55 %, at most 50 %; move the two ends closer"),
        (silence_receiver, 0.5, 0.51, "receiver silence: 0.51 s, at most 0.5 s; switch the pilot's transmitter on"),
        (fill_disk, 100.0, 99.9, "space for the log: 99.9 MB, at least 100 MB; free disk space"),
        (incline, 0.2, 0.21, "envelope angle: 0.21 rad, at most 0.2 rad; let the vehicle come to rest"),
        (incline, -0.2, -0.21, "envelope angle: 0.21 rad, at most 0.2 rad; let the vehicle come to rest"),
    ],
)
def test_vehicle_refuses_arming_only_outside_each_limit(impair, passing, failing, sentence):
    assert impair(Vehicle(), passing) == ""
    assert impair(Vehicle(), failing) == sentence


def test_vehicle_may_be_armed_after_the_cause_of_a_refusal_is_gone():
    vehicle = Vehicle()
    assert keep_silent(vehicle, 4.0).startswith("link silence: ")
    vehicle.receive(1, at=vehicle.t + seconds("4.1"))
    assert vehicle.guard.problem == ""
    vehicle.receive(5, 30, at=vehicle.t + seconds("4.2"))
    assert vehicle.guard.problem.startswith("frames lost: ")
    vehicle.receive(20, at=vehicle.t + seconds("4.3"))
    assert vehicle.guard.problem == ""


def test_vehicle_ignores_quantities_that_it_cannot_measure():
    """No receiver, no log, and fewer than 20 frames within a second."""
    vehicle = Vehicle()
    vehicle.guard.log_folder = None
    vehicle.disk.free_mb = 0.0
    vehicle.receive(2, 10, at=vehicle.t + seconds("1.1"))
    assert vehicle.guard.problem == ""
    texts = {check.name: check.value_text for check in vehicle.guard.checks}
    assert [texts[n] for n in ("frames lost", "receiver silence", "space for the log")] == ["not measured"] * 3


SIGMAS = {"north": ("m", 1.0), "surge_velocity": ("m/s", 0.5), "heading": ("rad", 0.35), "yaw_rate": ("rad/s", 0.2)}
UNREAD = "estimate.state.sigma_east"
OUTPUTS = {
    "estimate.valid": ("1", 1.0),
    "estimate.age": ("s", 0.01),
    "supervisor.check": ("1", 0.0),
    UNREAD: ("m", 99.0),
    **{f"estimate.state.sigma_{name}": (unit, 0.0) for name, (unit, _) in SIGMAS.items()},
}


class Flight:
    """Checks of an autopilot whose vehicle reports none, with a law that reads four estimated quantities."""

    def __init__(self, stale_age=None):
        signals = [SimpleNamespace(path=p, shape=(), declaration=Quantity(unit, p)) for p, (unit, _) in OUTPUTS.items()]
        self.slots, self.outputs = {p: k for k, p in enumerate(OUTPUTS)}, np.array([v for _, v in OUTPUTS.values()])
        step = SimpleNamespace(writes=self.slots, outputs=self.outputs, text=SimpleNamespace(outputs=signals))
        self.end, self.counts, self.disk, self.silence = (
            SimpleNamespace(step=step, has_command=True),
            FrameCounts(),
            Disk(),
            0,
        )
        supervisor = None if stale_age is None else SimpleNamespace(stale_age=stale_age)
        scenario = SimpleNamespace(
            autopilot=SimpleNamespace(supervisor=supervisor, law=SimpleNamespace(reads=tuple(SIGMAS)))
        )
        remote = SimpleNamespace(
            wants_checks=False,
            arming=SimpleNamespace(is_asking=False, confirms=False),
            checks=RemoteChecks(),
            clock=SimpleNamespace(sync=TimeSync()),
            comparison=SimpleNamespace(count_differences=lambda: 0, first_difference=lambda: ""),
        )
        remote.checks.has_none = True
        self.sync = remote.clock.sync
        self.preflight = Preflight(scenario, self.end, remote, self.counts, self.disk)
        self.preflight.log_folder = FOLDER

    def set(self, path, value):
        self.outputs[self.slots[path]] = value

    def answer_clock(self, round_trip):
        """Answer one request for the vehicle's time after this time (100 ns)."""
        asked = self.sync.ask(0)
        assert self.sync.handle_answer(1, asked["ts1"], round_trip)

    def check(self, accepted=30, lost=0):
        """Run the checks for four seconds. Return the failing check, which the flight waits for.

        accepted, lost: numbers of frames in each tenth of a second.
        """
        may_arm = False
        for k in range(41):
            self.counts.accepted += accepted
            self.counts.lost += lost if k else 0
            may_arm = self.preflight.update(k * ms(100), self.silence)
        assert may_arm == (self.preflight.obstacle == "")
        return self.preflight.obstacle


def outdate(flight, age_s):
    flight.set("estimate.age", age_s)
    return flight.check()


def object_to(flight, check):
    flight.set("supervisor.check", CHECKS.index(check))
    return flight.check()


def send(flight, valid):
    flight.end.has_command = valid
    return flight.check()


def silence_vehicle(flight, time_s):
    flight.silence = round(time_s * seconds(1))
    return flight.check()


def lose_share(flight, lost):
    return flight.check(100 - lost, lost)


def delay_clock(flight, time_s):
    flight.answer_clock(round(time_s * seconds(1)))
    return flight.check()


def fill_own_disk(flight, free_mb):
    flight.disk.free_mb = free_mb
    return flight.check()


SENSORS, LINK = "check the vehicle's sensors", "check the link"


@pytest.mark.parametrize(
    ("impair", "passing", "failing", "sentence"),
    [
        (outdate, 0.4, 0.401, f"estimate age: 0.401 s, at most 0.4 s; {SENSORS}"),
        (object_to, CHECKS[0], "link silent", "supervisor's objections: 1, at most 0; reason: link silent"),
        (send, True, False, "command valid: 0, at least 1; wait for the law's first command"),
        (silence_vehicle, 0.25, 0.251, f"link silence: 0.251 s, at most 0.25 s; {LINK}"),
        (lose_share, 50, 51, "frames lost: 51 %, at most 50 %; move the two ends closer"),
        (delay_clock, 0.3, 0.301, f"clock round trip: 0.301 s, at most 0.3 s; {LINK}"),
        (fill_own_disk, 100.0, 99.9, "space for the log: 99.9 MB, at least 100 MB; free disk space"),
    ],
)
def test_autopilot_refuses_arming_only_outside_each_limit(impair, passing, failing, sentence):
    assert impair(Flight(), passing) == ""
    assert impair(Flight(), failing) == sentence


@pytest.mark.parametrize("check", CHECKS[1:])
def test_autopilot_names_the_objection_of_the_supervisor(check):
    assert object_to(Flight(), check) == f"supervisor's objections: 1, at most 0; reason: {check}"


@pytest.mark.parametrize("name", SIGMAS)
def test_arming_is_refused_for_uncertain_estimate_that_the_law_reads(name):
    """The limit depends on the unit. An estimate that the law does not read is not checked."""
    unit, limit = SIGMAS[name]
    flight = Flight()
    flight.set(f"estimate.state.sigma_{name}", limit)
    assert flight.check() == ""
    flight = Flight()
    flight.set(f"estimate.state.sigma_{name}", limit + 0.01)
    advice = "wait until the estimator has settled"
    assert flight.check() == f"sigma_{name}: {limit + 0.01:.3g} {unit}, at most {limit:.3g} {unit}; {advice}"


def test_limit_of_estimate_age_is_that_of_the_supervisor():
    assert outdate(Flight(stale_age=1.0), 0.99) == ""
    assert outdate(Flight(stale_age=0.1), 0.11) == f"estimate age: 0.11 s, at most 0.1 s; {SENSORS}"


def test_infinite_age_and_uncertainty_refuse_arming():
    assert outdate(Flight(), math.inf).startswith("estimate age: ∞ s, ")
    flight = Flight()
    flight.set("estimate.state.sigma_north", math.inf)
    assert flight.check().startswith("sigma_north: ∞ m, ")
