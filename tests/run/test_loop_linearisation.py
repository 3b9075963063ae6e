"""The whole loop as a linear map: against simulated flights and analytical loops."""

import numpy as np
import pytest
from scipy.signal import cont2discrete

from examples.my_cart import CartState, scenario
from trimtab import build, simulate
from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.design.coordinates import error_model
from trimtab.design.linearise import linearise
from trimtab.design.loop_map import loop_margins
from trimtab.links.wire import DelayChain
from trimtab.run.loop_linearisation import linearise_loop


@pytest.fixture(scope="module")
def cart():
    return linearise_loop(scenario())


def sampled_cart(delay):
    """Return the analytical cart loop: exact steps of 5 ms, `delay` steps in the command, integral before the gain."""
    law = scenario().autopilot.law
    linear = linearise(error_model(scenario().world.vehicle, CartState(), law.u0))
    F, G, *_ = cont2discrete((linear.A, linear.B, np.eye(4), np.zeros((4, 1))), 0.005)
    n = 5 + delay
    whole = np.zeros((n, n))
    whole[:4, :4], whole[4, 4], whole[4, 0] = F, 1.0, 0.005
    issued = np.zeros((1, n))
    issued[:, :4], issued[:, 4] = law.K, law.L
    issued = issued @ (np.eye(n) + np.outer(np.eye(n)[4], 0.005 * np.eye(n)[0]))  # integrated first
    if not delay:
        whole[:4] += G @ issued
        return whole
    whole[:4, 5:6] += G
    for i in range(delay - 1):
        whole[5 + i, 6 + i] = 1.0
    whole[n - 1] = issued
    return whole


def test_poles_match_the_analytical_cart_loop(cart):
    wanted = np.linalg.eigvals(sampled_cart(2))
    found = cart.poles()[: len(wanted)]
    for pole in wanted:
        assert np.abs(found - pole).min() < 1e-7, pole
    assert cart.period == pytest.approx(0.005)


@pytest.mark.thorough
def test_margins_match_the_analytical_cart_loop(cart):
    margins = loop_margins(cart)
    size = {d: np.abs(np.linalg.eigvals(sampled_cart(d))).max() for d in range(2, 14)}
    last = max(d for d in size if size[d] < 1)
    assert margins.delay == pytest.approx((last - 2) * 0.005)
    assert margins.gain_up > 2
    assert 0.1 < margins.gain_down < 0.5  # with too little gain the pole falls


@pytest.mark.thorough
def test_frequency_response_matches_the_analytical_cart_loop(cart):
    """Opened at the command: two steps of delay, the plant with a hold, gain and integral."""
    w = np.array([0.7, 5.0, 22.0, 90.0])
    z = np.exp(1j * w * 0.005)
    whole = sampled_cart(0)
    closed = [np.linalg.det(v * np.eye(5) - whole) for v in z]
    free = whole.copy()
    free[:4] = sampled_cart(2)[:4, :5]
    free[:4, 4] = 0
    opened = [np.linalg.det(v * np.eye(5) - free) for v in z]
    wanted = (np.array(closed) / np.array(opened) - 1) / z**2  # 1 + L = closed/open, L delayed by two steps
    np.testing.assert_allclose(cart.response(w)[:, 0, 0], wanted, rtol=1e-6)


@pytest.fixture(scope="module")
def boat():
    """The hovercraft's loop with wires and direct actuation; sensor and command have their own periods."""
    return build("hovercraft/forward", {"links": "none"})


def fly_off_the_trim(scenario, delay):
    """Return the yaw rate of a noise-free flight from 1e-5 rad/s off its equilibrium, with the given delay in ms."""
    ideal = scenario.without("navigation-error")
    world = replace(
        ideal.world,
        uplink=DelayChain(period=ms(1), steps=delay),
        actuators=DirectActuation(neutral_input=ideal.world.actuators.neutral().u, period=ms(1)),
    )
    x = replace(ideal.autopilot.law.equilibrium(), yaw_rate=1e-5)
    autopilot = replace(ideal.autopilot, allocation=DirectAllocation())
    flown = replace(ideal, world=world, autopilot=autopilot, initial=x, duration=seconds(40))
    return np.abs(np.asarray(simulate(flown)["truth.yaw_rate"]))


@pytest.mark.thorough
def test_delay_margin_matches_simulated_flights_to_a_millisecond(boat):
    """A small deviation decays at the delay margin of the poles and grows at one millisecond more."""
    loop = linearise_loop(boat, direct=True)
    last = round(loop_margins(loop).delay * 1e3)
    grows = []
    for delay in (last, last + 1):
        rate = fly_off_the_trim(boat, delay)
        quarter = len(rate) // 4
        growth = rate[3 * quarter :].max() / rate[quarter : 2 * quarter].max()
        wanted = loop.growth(delay=delay) ** (20 / loop.period)  # two quarters of 40 s
        assert growth == pytest.approx(wanted, rel=0.02)
        grows.append(growth > 1)
    assert grows == [False, True]
    assert last == pytest.approx(191 - 3, abs=1)  # 191 ms of a continuous loop, less half of what is held


@pytest.mark.thorough
def test_radio_links_halve_the_delay_margin():
    """36 ms down and 40 ms up, in frames of 20 ms; the ring buffers of both links are states of the loop."""
    loop = linearise_loop(build("hovercraft/forward"), direct=True)
    assert loop.period == pytest.approx(0.06)
    margins = loop_margins(loop)
    assert margins.delay == pytest.approx(0.102)
    (crossing,) = margins.crossings["FY"]
    assert crossing[0] == pytest.approx(6.24, rel=2e-3)  # docs, Margins: 6.244 rad/s of the continuous loop


@pytest.mark.thorough
def test_rejects_a_non_differentiable_loop_and_an_unstable_loop(boat):
    with pytest.raises(InputError, match="zero thrust"):
        linearise_loop(boat)
    falling = scenario()
    own = falling.autopilot.law
    broken = replace(falling, autopilot=replace(falling.autopilot, law=replace(own, K=0.1 * own.K)))
    grown = linearise_loop(broken, x=CartState(), settle=0.1)
    assert grown.growth() > 1.001
    with pytest.raises(InputError, match="the loop is not stable"):
        loop_margins(grown)


def hover_by_hand():
    """Return the height loop of a hover: drag, rotor lag of 20 ms, 5 ms of delay each way, the law's two gains."""
    mass, drag, lag, kx, kv = 4.34, 0.2, 0.02, 16 * 4.34, 5.6 * 4.34
    A = np.array([[0, 1, 0], [0, -drag / mass, -1 / mass], [0, 0, -1 / lag]])  # down, its rate, thrust
    F, G, *_ = cont2discrete((A, np.array([[0], [0], [1 / lag]]), np.eye(3), np.zeros((3, 1))), 0.005)
    whole = np.zeros((6, 6))  # and what was measured a step ago, and what was asked for a step ago
    whole[:3, :3], whole[:3, 5:] = F, G
    whole[3:5, :2] = np.eye(2)
    whole[5, 3:5] = [kx, kv]
    return whole


@pytest.mark.thorough
def test_hover_poles_match_analysis_without_a_quaternion_length_pole():
    loop = linearise_loop(build("quadrotor/track", {"trajectory": "place"}))
    kept = [n for n, idle in zip(loop.states, loop.idle, strict=True) if not idle]
    assert [n for n in kept if n.startswith("s.x.attitude")] == [f"s.x.attitude.{a}" for a in "xyz"]
    assert loop.growth() < 0.99  # a quaternion's length would stay, with a pole of one
    for pole in np.linalg.eigvals(hover_by_hand()):
        if abs(pole) > 1e-9:
            assert np.abs(loop.poles() - pole).min() < 2e-5, pole
    assert loop_margins(loop).delay == pytest.approx(0.01)


@pytest.mark.thorough
def test_circle_flight_linearises_with_idle_phase_state():
    """One round takes 5 s: a deviation decays with the slowest pole, and the phase of the circle is idle."""
    scenario = build("quadrotor/track")
    with pytest.raises(InputError, match="round"):
        linearise_loop(scenario)
    loop = linearise_loop(scenario, round_time=5.0)
    assert "a.law.time" in [n for n, idle in zip(loop.states, loop.idle, strict=True) if idle]
    slowest = loop.continuous_poles().real.max()
    assert slowest == pytest.approx(-2.86, rel=0.02)  # of the hover: the circle's tilt of 14 degrees hardly changes it
    with pytest.raises(InputError, match="must be a multiple of the loop's period"):
        linearise_loop(scenario, round_time=5.001)


@pytest.mark.parametrize("settle", [-5.0, float("nan"), 1e9])
def test_refuses_impossible_settle_times(settle):
    with pytest.raises(InputError, match="settle: must be between 0 and 100000 s"):
        linearise_loop(scenario(), settle=settle)


@pytest.mark.thorough
def test_slow_climb_linearises_after_its_reference_becomes_constant():
    climb = build("hypersonic/climb-large")
    with pytest.raises(InputError, match=r"does not come to rest: after 10 s of flight, .* changes by"):
        linearise_loop(climb, settle=10.0)
    margins, cruise = (loop_margins(linearise_loop(s)) for s in (climb, build("hypersonic/impulse")))
    assert margins.delay == cruise.delay == pytest.approx(0.165)
    assert margins.gain_up == pytest.approx(cruise.gain_up, rel=0.01)


@pytest.mark.thorough
def test_loop_that_diverges_is_not_at_rest():
    with pytest.raises(InputError, match=r"does not come to rest: after 100 s of flight, .* is not finite") as refused:
        linearise_loop(build("hypersonic/printed-gains"))
    assert refused.value.fix == "stabilise the loop first; its flight:  trimtab run hypersonic/printed-gains"
