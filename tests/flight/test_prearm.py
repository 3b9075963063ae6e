"""A vehicle's checks before arming, its fence, and the conditions for rearming after a failsafe."""

import math
import re

import pytest
from run.stand_ins import KEY

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.time import ms, seconds
from trimtab.flight.injector import add_idle_faults
from trimtab.flight.mavlink.endpoint import Endpoint, FrameCounts
from trimtab.flight.mavlink.protocol import ReceiverChannels
from trimtab.flight.prearm import ArmingGuard, FrameLoss
from trimtab.flight.transports.open_link import open_link
from trimtab.flight.vehicle import LiveVehicle
from trimtab.loop.faults import KINDS
from trimtab.loop.vehicle_limits import VehicleLimits
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
WORD = "world.sensors.navigation.fault.kind"


class Craft:
    """A vehicle whose time the test advances, with its sensors, received frames and arming guard."""

    def __init__(self, vehicle):
        self.vehicle, self.body, self.counts = vehicle, vehicle.body, FrameCounts()
        self.instants = self.body.instants()
        self.limit()

    def limit(self, **limits):
        """Use these limits from now on."""
        rules, silence = self.vehicle.duties.failsafe, lambda now: None
        self.guard = ArmingGuard(self.body, VehicleLimits(**limits), rules, self.counts, silence)

    def set_fault(self, word):
        self.body.world.parameters[WORD].flat[0] = KINDS.index(word)

    def run(self, duration, mode="disarmed"):
        """Advance the time. The vehicle is held, so that it keeps sliding and turning."""
        end = self.body.t + duration
        for t in self.instants:
            self.body.advance(t, fresh=True, is_held=True)
            self.counts.accepted += 1
            self.guard.follow(t, mode)
            if t >= end:
                return

    def check(self, name):
        return next(c for c in self.guard.checks if c.name == name)


@pytest.fixture(scope="module")
def compiled():
    link = open_link("loopback://test-arming", listen=True)
    scenario = add_idle_faults(catalogue.load_scenario("hovercraft/zero-velocity")[0])
    yield Craft(LiveVehicle(scenario, link, lambda d: Endpoint(d, 1, 1, KEY)))
    link.close()


@pytest.fixture
def craft(compiled):
    compiled.set_fault("none")
    compiled.limit()
    compiled.run(seconds("0.3"))
    return compiled


def test_arming_is_refused_before_checks_have_run(craft):
    craft.guard.checks = []
    assert craft.guard.problem == "the checks have not run yet"


@pytest.mark.thorough
def test_healthy_vehicle_may_be_armed_and_lists_its_checks(craft):
    assert (craft.guard.problem, craft.guard.confirmation_problem) == ("", "")
    names = [c.name for c in craft.guard.checks]
    assert names[:2] == ["navigation age", "sensor values not finite"]
    assert craft.check("navigation age").value < 0.01
    assert craft.check("failsafe.timeout").value == 0.25


@pytest.mark.thorough
def test_arming_is_refused_while_the_only_sensor_is_off(craft):
    """Regression: the vehicle was armed, although the documentation promised a refusal."""
    craft.set_fault("off")
    craft.run(seconds("0.2"))
    assert craft.guard.problem == ""
    craft.run(seconds("0.3"))
    assert craft.guard.problem.startswith("navigation age: ")
    assert craft.guard.problem.endswith("s, at most 0.28 s; switch navigation on")
    assert list(craft.guard._silent_sensors(craft.body.t)) == ["navigation"]
    craft.set_fault("none")
    craft.run(seconds("0.2"))
    assert craft.guard.problem == ""


def test_sensor_age_limit_adapts_to_the_sensor_period(craft):
    """Fixes of an ultrasonic network arrive once a second, and are checked each millisecond."""
    outputs, writes = craft.body.world.outputs, craft.body.world.writes
    t = craft.body.t
    for k in range(1, 6):
        outputs[writes["downlink.navigation.t"]] = t + k * seconds(1)
        craft.guard.follow(t + k * seconds(1), "disarmed")
    assert craft.check("navigation age").limit == 5.25
    for _ in range(5):  # it is quicker from now on
        outputs[writes["downlink.navigation.t"]] += ms(6)
        craft.guard.follow(t + seconds(5), "disarmed")
    assert craft.guard._sensors["navigation"].limit == pytest.approx(0.28)


def test_arming_is_refused_for_nan_sensor_values(craft):
    craft.body.world.outputs[craft.body.world.writes["downlink.navigation.value.yaw_rate"]] = math.nan
    craft.guard.follow(craft.body.t + ms(200), "disarmed")
    assert craft.guard.problem.startswith("sensor values not finite: 1, at most 0; ")
    craft.run(ms(350))
    assert craft.guard.problem == ""


def test_rearming_after_failsafe_needs_rest_and_confirmation(craft):
    """The craft is held in a sliding and spinning state. Regression: it was armed again in that state."""
    craft.run(ms(7))
    craft.run(ms(1), "failsafe")  # in that very millisecond: a station had armed it before the next look
    assert craft.guard.problem
    assert craft.guard.confirmation_problem
    craft.run(seconds(2), "disarmed")
    assert craft.guard.problem.startswith("speed after failsafe: ")
    assert "let the vehicle come to rest" in craft.guard.problem
    assert craft.guard.confirmation_problem.startswith("confirmation: 0, at least 1; type --rearm")
    craft.guard.confirm()
    craft.run(ms(200))
    assert craft.guard.confirmation_problem == ""
    assert craft.guard.problem  # a confirmation is no rest
    craft.run(ms(200), "failsafe")
    craft.run(ms(200), "computer")  # once it was let
    assert (craft.guard.problem, craft.guard.confirmation_problem) == ("", "")


def test_vehicle_at_rest_may_be_rearmed_after_failsafe(craft):
    craft.limit(rest_speed=100.0, rest_rate=100.0)
    craft.guard.confirmed = frozenset(("limits.rest_speed", "limits.rest_rate"))
    craft.run(ms(300), "failsafe")
    assert math.isinf(craft.check("speed after failsafe").value)  # it has not been watched for a second yet
    assert craft.guard.problem
    craft.run(seconds("1.2"), "failsafe")
    assert (craft.guard.problem, bool(craft.guard.confirmation_problem)) == ("", True)
    assert 0 < craft.check("speed after failsafe").value < 5


def test_envelope_breach_is_reported_after_its_patience(craft):
    craft.limit(rate=0.5)
    craft.guard.find_breach(craft.body.t)
    craft.run(ms(50))
    assert craft.guard.find_breach(craft.body.t) is None
    craft.run(ms(60))
    breach = craft.guard.find_breach(craft.body.t)
    assert breach.kind == "envelope"
    assert re.fullmatch(r"rate \S+ rad/s, at most 0.5, by navigation", breach.text)
    assert craft.guard.problem.startswith("envelope rate: ")
    craft.set_fault("off")
    craft.run(seconds("0.5"))
    assert "rate not known, no data from navigation for " in craft.guard.find_breach(craft.body.t).text


def test_rejects_limit_that_no_sensor_measures(craft):
    with pytest.raises(InputError, match="no sensor of this vehicle measures the distance") as refused:
        craft.limit(distance=5.0)
    assert refused.value.choices == ("speed", "rate")


def test_guard_of_a_live_vehicle_watches_its_own_link_and_receiver(craft):
    """The guard that answers a request to arm counts the frames of the vehicle's endpoint, and hears its receiver."""
    vehicle, t = craft.vehicle, craft.body.t + seconds(1)
    guard, counts = vehicle.parts.guard, vehicle.endpoint.counts
    vehicle.duties.handle_event(ReceiverChannels((1.5e-3,) * 5), t)
    guard.follow(t, "disarmed")
    values = [{c.name: c.value for c in guard.checks}]
    for k in range(1, 3):
        counts.accepted += 10
        counts.lost += 30 * (k - 1)
        guard.follow(t + k * ms(100), "disarmed")
        values.append({c.name: c.value for c in guard.checks})
    assert [v["receiver silence"] for v in values] == pytest.approx([0.0, 0.1, 0.2])
    assert [v["link silence"] for v in values[1:]] == [0.0, 0.0]
    assert values[2]["frames lost"] == 75
    assert guard._disk is vehicle.parts.machine.disk


def test_frame_loss_covers_recent_frames_only():
    counts = FrameCounts(accepted=100, lost=900)
    loss = FrameLoss(counts)
    for k in range(60):  # a frame each 10 ms, three of four are lost from the 30th on
        loss.follow(k * ms(10))
        counts.accepted += 1
        counts.lost += 3 * (k >= 30)
        if k == 29:
            assert loss.share == 0
    assert 60 < loss.share <= 75
    loss.follow(seconds(3))
    loss.follow(seconds(5))
    assert math.isnan(loss.share)
