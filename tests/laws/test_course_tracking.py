"""Course tracking by feedforward and feedback: interpolation, ends, and flights along a non-minimum phase output."""

import numpy as np
import pytest

from examples.my_cart_course import scenario
from trimtab import simulate
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.signals import Estimate, PlanarForce, PlanarState
from trimtab.design.output_inversion import smooth_course
from trimtab.laws.course_tracking import CourseTracking
from trimtab.laws.state_feedback import StateFeedback

CHANNEL_NAMES = "speed", "vane", "altitude", "attitude", "rate", "load"
NO_ERRORS = dict.fromkeys([f"{n}_{w}" for n in CHANNEL_NAMES for w in ("noise", "bias")], 0.0)
K = np.array([[-1.0, 0.0, 0.0, 0.5], [0.0, -2.0, 3.0, 0.0]])
LAW = CourseTracking(
    StateFeedback(K=K, u0=PlanarForce(0.3, 0.0)),
    x=np.array([[0.0, 0, 0, 0], [1.0, 2, 0, 0], [1.0, 2, 4, 0]]),
    du=np.array([[0.0, 0], [2.0, 0], [2.0, 1.0]]),
    spacing=0.2,
)


def test_interpolates_between_nodes_and_holds_past_the_end():
    state, demands = LAW.init(None), []
    for _ in range(8):
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=PlanarState(0.5, 1.0, 0.0, 0.0), dt=0.1)
        state, out = LAW.step(0, state, estimate)
        demands.append((float(out.demand.FX), float(out.demand.FY)))
    # at 0.1 s: half of the first interval, where the state is; at 0.3 s: half of the second; from 0.4 s on: the end
    assert demands[1] == pytest.approx((0.3 + 1.0, 0.0))
    assert demands[3] == pytest.approx((0.3 + 2.0 + 0.5, 0.5 + 2.0 - 6.0))
    assert demands[5] == demands[7] == pytest.approx((0.3 + 2.0 + 0.5, 1.0 + 2.0 - 12.0))


def test_rejects_a_course_that_does_not_match_its_gain():
    LAW.check()
    with pytest.raises(InputError, match=r"give x \(k, 4\)"):
        replace(LAW, x=np.zeros((3, 5))).check()
    with pytest.raises(InputError, match="k at least 2"):
        replace(LAW, x=np.zeros((1, 4)), du=np.zeros((1, 2))).check()


@pytest.mark.thorough
def test_course_feedforward_tracks_better_than_a_setpoint_change():
    """Half a metre in 1.5 s with a zero at +4.4 1/s; the 10 ms of delay cause most of the remaining error."""
    flown = scenario()
    law = flown.autopilot.law
    wanted = None

    def deviation(law):
        nonlocal wanted
        position = np.asarray(simulate(replace(flown, autopilot=replace(flown.autopilot, law=law)))["truth.position"])
        times = np.arange(len(position)) * 0.005
        wanted = smooth_course(times, {"position": (0.0, 0.5)}, 2.0, 3.5, 2).derivatives["position"][0]
        return np.abs(position - wanted).max()

    place = law.x.copy()
    place[:, 1:] = 0.0
    whole, alone = deviation(law), deviation(replace(law, x=place, du=0 * law.du))
    print(f"off its course by {1e3 * whole:.2f} mm; told the place alone, by {1e3 * alone:.0f} mm")
    assert whole < 0.002
    assert alone > 0.2  # the same course, of the place alone


@pytest.mark.thorough
def test_f16_climb_tracks_better_with_the_full_course():
    """30 m in 4 s, a zero at +13.8 1/s, instruments without errors, lagging surfaces, 10 ms of loop delay."""
    from examples import f16_climb

    flown = f16_climb.scenario()
    law = flown.autopilot.law
    still = replace(flown.world, sensors={"instruments": replace(flown.world.sensors["instruments"], **NO_ERRORS)})

    def deviation(law):
        log = simulate(replace(flown, world=still, autopilot=replace(flown.autopilot, law=law)))
        altitude = np.asarray(log["truth.altitude"])
        low = law.feedback.x0[law.reads.index("altitude")]
        span = f16_climb.BEGIN, f16_climb.END
        course = smooth_course(np.asarray(log.t), {"h": (low, low + f16_climb.CLIMB)}, *span, order=2)
        return np.abs(altitude - course.derivatives["h"][0]).max()

    alone = np.tile(law.feedback.x0, (len(law.x), 1))
    alone[:, law.reads.index("altitude")] = law.x[:, law.reads.index("altitude")]
    whole, by_altitude = deviation(law), deviation(replace(law, x=alone, du=0 * law.du))
    print(f"F-16: {whole:.3f} m off by the whole course, {by_altitude:.2f} m by its altitude alone")
    assert whole < 0.08
    assert by_altitude > 20 * whole
