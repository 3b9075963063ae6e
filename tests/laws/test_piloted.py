"""The pilot's law: the claims of its docstring by independent equations, and tracking in flights."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.signals import STICK_MODES, Estimate, PlanarState, Sample, Stick
from trimtab.core.time import ms, seconds
from trimtab.laws.piloted import Piloted, PilotedState
from trimtab.loop.fault_text import inject_faults
from trimtab.loop.stick_script import stick_script
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue

M, J, D = 2.6, 0.096, 0.32
A = J / (M * D)
MANUAL, DAMPED, ASSISTED = range(3)
LAW = Piloted()
NOW = ms(1000)
STATES = np.random.default_rng(0).uniform(-1, 1, (400, 4)) * [1.0, 1.0, 1.5, 3.0]


def sample(forward, turn, mode, age=0.0, *, valid=True):
    stick = Stick(np.float64(forward), np.float64(turn), np.int32(mode))
    return Sample(stick, np.int64(NOW), np.float64(age), np.bool_(True), np.bool_(valid))


def under_way(mode, **changes):
    """Return the state of a law that has just been stepped at this instant, so that references do not ramp."""
    held = PilotedState(
        t=np.int64(NOW),
        mode=np.int32(mode),
        began=np.bool_(True),
        speed=np.float64(0.0),
        rate=np.float64(0.0),
        course=np.float64(0.0),
        backing=np.bool_(False),
    )
    return replace(held, **changes)


@jax.jit
def ask(law, state, x, stick, t=NOW):
    estimate = Estimate(t=t, age=0.0, fresh=True, valid=True, state=PlanarState(*x), stick=stick)
    return law.step(t, state, estimate)


def rates(x, force):
    """Return u', v', r', heading' of the vehicle, from independent equations."""
    u, v, r, _ = x
    return jnp.stack([v * r + force.FX / M, -u * r + force.FY / M, -D * force.FY / J, r])


def test_manual_stick_sets_the_thrust_vector():
    def push(forward, turn):
        demand = ask(LAW, under_way(MANUAL), STATES[0], sample(forward, turn, MANUAL))[1].demand
        return float(demand.FX), float(demand.FY)

    assert push(1.0, 0.0) == pytest.approx((1.2, 0.0))
    FX, FY = push(0.5, 0.7)
    assert np.hypot(FX, FY) == pytest.approx(0.6)
    assert np.arctan2(-FY, FX) == pytest.approx(0.7 * 0.36), "to the right: the tail is pushed to the left"
    assert push(-0.5, 0.7) == pytest.approx((-FX, -FY)), "backward the same rudder turns the other way"
    assert push(0.0, 1.0) == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize("rate", [-1.3, -0.2, 0.2, 0.9])
def test_damped_turns_have_a_linear_yaw_rate(rate):
    """(r - r_r)' = -(k2 d^2/J)(r - r_r), whatever sway and surge, 1e-9."""
    state, turn = under_way(DAMPED, rate=np.float64(rate)), sample(0.3, rate / 1.5, DAMPED)
    found = jax.vmap(lambda x: rates(x, ask(LAW, state, x, turn)[1].demand)[2])(STATES)
    np.testing.assert_allclose(found, -2.5 * D**2 / J * (STATES[:, 2] - rate), atol=1e-9)


def steering(speed, k2=2.5):
    """Return the Jacobian of (v', r') in (v, r) at constant surge, without turn input."""
    state = under_way(DAMPED, speed=np.float64(speed))

    def rate(y):
        x = jnp.stack([jnp.asarray(speed), y[0], y[1], jnp.asarray(0.0)])
        return rates(x, ask(Piloted(k2=k2), state, x, sample(speed / 0.8, 0.0, DAMPED))[1].demand)[1:3]

    return np.asarray(jax.jacfwd(rate)(jnp.zeros(2)))


@pytest.mark.thorough
@pytest.mark.parametrize("speed", [-0.8, -0.3, -0.1, 0.1, 0.4, 0.8])
def test_damped_straight_motion_is_stable_in_both_directions(speed):
    """det = d k2 s u_r/J, so that s u_r > 0 is necessary; with trace < 0 sufficient."""
    jacobian = steering(speed)
    s = 1.0 if speed > 0 else -0.5
    assert np.linalg.det(jacobian) == pytest.approx(D * 2.5 * s * speed / J)
    assert np.linalg.eigvals(jacobian).real.max() < 0
    wrong_way = jacobian - 2 * np.array([[-2.5 * s / M, 0.0], [D * 2.5 * s / J, 0.0]])
    assert np.linalg.eigvals(wrong_way).real.max() > 0


def test_side_force_does_not_accelerate_the_assisted_point():
    """v_P' = n (FX/m - a r^2), by differentiation of v_P in W along the vehicle's motion, 1e-9."""

    def velocity(x):
        u, v, r, psi = x
        c, n = jnp.cos(psi), jnp.sin(psi)
        return jnp.stack([c * u - n * (v + A * r), n * u + c * (v + A * r)])

    assert float(LAW.model.percussion_arm) == pytest.approx(A)
    for x, FX, FY in zip(jnp.asarray(STATES[:20]), STATES[20:40, 0], STATES[40:60, 1], strict=True):
        force = type(ask(LAW, under_way(MANUAL), x, sample(0, 0, MANUAL))[1].demand)(FX, FY)
        _, found = jax.jvp(velocity, (x,), (rates(x, force),))
        nose = np.array([np.cos(x[3]), np.sin(x[3])])
        np.testing.assert_allclose(found, nose * (FX / M - A * x[2] ** 2), atol=1e-9)


@pytest.mark.parametrize(("speed", "backing"), [(0.6, False), (0.0, False), (0.0, True), (-0.4, False)])
def test_velocity_error_never_grows_at_constant_course_and_speed(speed, backing):
    """E' = -m k (n.e)^2 where FX is not limited, 1e-9; and E' <= 0 where it is, for 400 states."""
    course, turn = 0.7, sample(speed / 0.8, 0.0, ASSISTED)
    state = under_way(ASSISTED, speed=np.float64(speed), course=np.float64(course), backing=np.bool_(backing))

    def error(x):
        u, v, r, psi = x
        c, n = jnp.cos(psi), jnp.sin(psi)
        v_P = jnp.stack([c * u - n * (v + A * r), n * u + c * (v + A * r)])
        return speed * jnp.stack([jnp.cos(course), jnp.sin(course)]) - v_P

    def change(x):
        out = ask(LAW, state, x, turn)[1]
        _, rate = jax.jvp(lambda x: M * error(x) @ error(x) / 2, (x,), (rates(x, out.demand),))
        free = (out.demand.FX < 1.4) & (out.demand.FX > -0.7)
        return rate, free, -M * 0.8 * (error(x) @ jnp.stack([jnp.cos(x[3]), jnp.sin(x[3])])) ** 2

    rate, free, form = map(np.asarray, jax.vmap(change)(jnp.asarray(STATES)))
    assert 100 < free.sum() < 400
    np.testing.assert_allclose(rate[free], form[free], atol=1e-9)
    assert rate.max() <= 1e-12


@pytest.mark.thorough("0.0-True", "0.6-False")
@pytest.mark.parametrize("backing", [False, True])
@pytest.mark.parametrize("speed", [0.0, 0.6])
def test_velocity_error_does_not_persist_at_the_wanted_heading(speed, backing):
    """For 400 errors of 0.03 to 0.4 m/s, n.e is at least of order e^2, so E' is zero only at e = 0."""
    draws = np.random.default_rng(3)
    state = under_way(ASSISTED, speed=np.float64(speed), course=np.float64(0.7), backing=np.bool_(backing))
    e, angle = draws.uniform(0.03, 0.4, 400), draws.uniform(-np.pi, np.pi, 400)

    def settled(e, angle):
        v = speed * jnp.stack([jnp.cos(0.7), jnp.sin(0.7)]) - e * jnp.stack([jnp.cos(angle), jnp.sin(angle)])

        def turn(_, carry):  # where the nose is wanted depends, at rest, on where it is
            now, psi, _ = carry
            c, n = jnp.cos(psi), jnp.sin(psi)
            x = jnp.stack([c * v[0] + n * v[1], c * v[1] - n * v[0], jnp.asarray(0.0), psi])
            now, out = ask(LAW, now, x, sample(speed / 0.8, 0.0, ASSISTED))
            return now, psi + 0.5 * (out.heading_reference - psi), psi

        _, psi, before = jax.lax.fori_loop(0, 400, turn, (state, jnp.asarray(0.7), jnp.asarray(0.0)))
        return jnp.abs(jnp.cos(angle - psi)), jnp.abs(psi - before)

    along, moves = jax.jit(jax.vmap(settled))(e, angle)
    worst = np.asarray(along) / np.minimum(e / 0.17, 1.0)
    assert np.asarray(moves).max() < 1e-2
    assert worst.min() > 0.05


def test_assisted_heading_loop_is_linear():
    """r' = kr (r_d - r), with r_d from the wanted heading, 1e-9, while FY is not limited."""
    state = under_way(ASSISTED, speed=np.float64(0.5), rate=np.float64(0.2))
    found = jax.vmap(lambda x: ask(LAW, state, x, sample(0.5 / 0.8, 0.2 / 0.6, ASSISTED))[1])(STATES)
    r, psi = STATES[:, 2], STATES[:, 3]
    wanted = np.clip(0.2 + np.asarray(found.heading_reference) - psi, -1, 1)
    FY = np.asarray(found.demand.FY)
    free = np.abs(FY) < 0.4
    assert 50 < free.sum() < 400
    np.testing.assert_allclose(-D * FY[free] / J, 3.0 * (wanted - r)[free], atol=1e-9)
    assert (np.abs(np.asarray(found.heading_reference) - psi) <= np.pi + 1e-9).all()


@pytest.mark.thorough
def test_lost_stick_is_released_and_keeps_the_mode():
    x, full = STATES[3], {"forward": 0.7, "turn": 0.4}
    for mode in (MANUAL, DAMPED, ASSISTED):
        state = under_way(mode, speed=np.float64(0.4), course=np.float64(0.2))
        _, wanted = ask(LAW, state, x, sample(0.0, 0.0, mode), NOW + ms(1))
        other = (mode + 1) % 3
        lost = {
            "old": sample(**full, mode=other, age=0.301),
            "never": sample(**full, mode=other, valid=False),
            "no number": sample(np.nan, 0.4, other),
            "no mode": sample(**full, mode=7),
        }
        assert not bool(wanted.stick_lost)
        for why, stick in lost.items():
            _, out = ask(LAW, state, x, stick, NOW + ms(1))
            assert bool(out.stick_lost), why
            for a, b in zip(jax.tree.leaves(out), jax.tree.leaves(replace(wanted, stick_lost=True)), strict=True):
                np.testing.assert_array_equal(a, b, err_msg=why)
        _, out = ask(LAW, state, x, sample(**full, mode=mode, age=0.3), NOW + ms(1))
        assert not bool(out.stick_lost)
    estimate = Estimate(t=NOW, age=0.0, fresh=True, valid=True, state=PlanarState(*x))
    _, out = LAW.step(NOW, LAW.init(None), estimate)
    assert (bool(out.stick_lost), int(out.mode)) == (True, DAMPED)


def test_stick_input_is_clipped_to_full_deflection():
    for mode in range(3):
        state = under_way(mode)
        a, b = (ask(LAW, state, STATES[1], sample(f, -f, mode), NOW + ms(50))[1] for f in (1.0, 3.0))
        assert float(a.demand.FX) == float(b.demand.FX)
        assert float(a.rate_reference) == float(b.rate_reference)


def test_references_start_at_the_current_vehicle_state():
    """References restart after a pause, a mode change and at the first step; within 100 ms they continue."""
    x, push = np.array([0.3, 0.4, 0.5, 1.0]), {"forward": 1.0, "turn": 0.0}
    stale = under_way(ASSISTED, speed=np.float64(0.8), course=np.float64(-2.0), rate=np.float64(0.3))
    _, goes_on = ask(LAW, stale, x, sample(**push, mode=ASSISTED), NOW + ms(100))
    assert float(goes_on.speed_reference) == pytest.approx(0.8)
    for state, later in ((stale, ms(101)), (replace(stale, mode=np.int32(DAMPED)), ms(1)), (LAW.init(None), ms(1))):
        _, out = ask(LAW, state, x, sample(**push, mode=ASSISTED), NOW + later)
        assert float(out.speed_reference) == pytest.approx(0.5)
        assert float(out.course_reference) == pytest.approx(1.0 + np.arctan2(0.4, 0.3))
        assert float(out.rate_reference) == 0.0
        _, out = ask(LAW, replace(state, mode=np.int32(ASSISTED)), x, sample(**push, mode=DAMPED), NOW + later)
        assert (float(out.speed_reference), float(out.rate_reference)) == pytest.approx((0.3, 0.5))
    _, out = ask(LAW, LAW.init(None), x * [-1, 1, 1, 1], sample(**push, mode=ASSISTED))
    assert float(out.speed_reference) == pytest.approx(-0.5), "sliding backward is a negative speed"
    assert float(out.course_reference) == pytest.approx(1.0 - np.arctan2(0.4, 0.3))


def test_references_are_ramped_and_wait_for_a_lagging_vehicle():
    on = sample(1.0, 1.0, ASSISTED)
    state = under_way(ASSISTED, speed=np.float64(0.4))
    for error, share in ((0.0, 1.0), (0.2, 1.0), (0.3, 0.5), (0.4, 0.0), (0.9, 0.0)):
        new, _ = ask(LAW, state, np.array([0.4 - error, 0.0, 0.0, 0.0]), on, NOW + ms(10))
        assert float(new.speed) == pytest.approx(0.4 + share * 0.3 * 0.01)
        assert float(new.rate) == pytest.approx(0.3 * 0.01)
        assert float(new.course) == pytest.approx(share * 0.3 * 0.01**2)
    new, _ = ask(LAW, under_way(DAMPED), np.zeros(4), sample(-1.0, -1.0, DAMPED), NOW + ms(10))
    assert (float(new.speed), float(new.rate)) == pytest.approx((-0.3 * 0.01, -1.0 * 0.01))
    fast = under_way(ASSISTED, speed=np.float64(0.8), rate=np.float64(0.4375))
    new, _ = ask(LAW, fast, np.array([0.8, 0.0, 0.0, 0.0]), on, NOW + ms(10))
    assert float(new.rate) == pytest.approx(0.35 / 0.8), "no turn that the fan can't hold"


@cache
def flown(*entries, duration=30, ideal=True, without=(), faults=(), seeds=1):
    """Return logs of stick entries (s, forward, turn, mode), always three, so that one compiled loop flies all."""
    scenario, _ = catalogue.load_scenario("hovercraft/pilot")
    script = stick_script(*((seconds(t), f, w, mode) for t, f, w, mode in entries))
    scenario = replace(
        scenario,
        duration=seconds(duration),
        world=replace(scenario.world, sensors={**scenario.world.sensors, "stick": script}),
    )
    for name in without:
        scenario = scenario.without(name)
    scenario = inject_faults(scenario.ideal() if ideal else scenario, faults)
    return simulate_many(scenario, seeds=range(seeds), log_period=ms(10))


def motion(log):
    """Return speed and unwrapped course of the assisted point, the heading relative to it, and the yaw rate."""
    u, v, r, psi = (log[f"truth.{n}"] for n in ("surge_velocity", "sway_velocity", "yaw_rate", "heading"))
    north = u * np.cos(psi) - (v + A * r) * np.sin(psi)
    east = u * np.sin(psi) + (v + A * r) * np.cos(psi)
    course = np.unwrap(np.arctan2(east, north))
    return np.hypot(north, east), course, np.mod(psi - course + np.pi, 2 * np.pi) - np.pi, r


@pytest.mark.thorough
def test_damped_tracks_surge_and_yaw_rate():
    """Ideal: ahead at 0.6 m/s, then a spin on the spot at 0.9 rad/s, to 0.02 m/s and 1e-3 rad/s, without sway."""
    (log,) = flown((0, 0.75, 0.0, "damped"), (12, 0.0, 0.0, "damped"), (18, 0.0, 0.6, "damped"))
    ahead, spin = log.between(10, 12), log.between(26, 30)
    assert np.abs(ahead["truth.surge_velocity"] - 0.6).max() < 0.02
    assert np.abs(spin["truth.yaw_rate"] - 0.9).max() < 1e-3
    for part in (ahead, spin):
        assert np.abs(part["truth.sway_velocity"]).max() < 0.02
    assert np.abs(spin["truth.surge_velocity"]).max() < 0.02


@pytest.mark.thorough
def test_long_damped_turn_ends_with_nose_toward_the_centre():
    """u -> 0 and v -> -k1 u_r/(m r_r), 1 %, at constant yaw rate: a property of the vehicle, not of the law."""
    (log,) = flown((0, 0.5, 0.0, "damped"), (3, 0.5, 0.4, "damped"), (29, 0.5, 0.4, "damped"))
    end = log.between(25, 30)
    assert np.abs(end["truth.yaw_rate"] - 0.6).max() < 1e-3
    assert np.abs(end["truth.surge_velocity"]).max() < 0.01
    np.testing.assert_allclose(end["truth.sway_velocity"], -2.0 * 0.4 / (M * 0.6), rtol=0.02)


@pytest.mark.thorough("-0.6")
@pytest.mark.parametrize("turn", [-0.6, 0.6])
def test_assisted_turn_holds_speed_and_course_rate(turn):
    """Ideal: 0.6 m/s to 2 %, the course at 0.36 rad/s to 1 %, the nose within 0.4 rad of the centre, both ways."""
    (log,) = flown((0, 0.75, 0.0, "assisted"), (6, 0.75, turn, "assisted"), (29, 0.75, turn, "assisted"))
    speed, course, nose, _ = motion(log)
    held = log.t > 20
    assert np.abs(speed[held] - 0.6).max() < 0.012
    rate = np.polyfit(log.t[held], course[held], 1)[0]
    assert rate == pytest.approx(0.6 * turn, rel=0.01)
    assert np.abs(nose[held] - np.sign(turn) * np.pi / 2).max() < 0.4


@pytest.mark.thorough
@pytest.mark.parametrize("turn", [-0.6, 0.6])
def test_assisted_turn_over_the_radio_holds_speed_and_course_rate(turn):
    """Delays of 76 ms, rudder and fan with their limits, exact sensors: the same to 0.05 m/s and 0.02 rad/s."""
    script = (0, 0.75, 0.0, "assisted"), (6, 0.75, turn, "assisted"), (29, 0.75, turn, "assisted")
    (log,) = flown(*script, ideal=False, without=("navigation-error",))
    speed, course, _, _ = motion(log)
    held = log.t > 16
    assert np.abs(speed[held].mean() - 0.6) < 0.05
    assert speed[held].std() < 0.05
    assert np.polyfit(log.t[held], course[held], 1)[0] == pytest.approx(0.6 * turn, abs=0.02)


def test_assisted_stops_and_remains_at_rest():
    """From a turn: below 0.04 m/s after eight seconds; dead zone and slow turning cause most of the rest."""
    (log,) = flown((0, 0.75, 0.0, "assisted"), (6, 0.75, 0.6, "assisted"), (14, 0.0, 0.0, "assisted"))
    speed, *_ = motion(log)
    assert speed[log.t > 22].max() < 0.04
    assert not log["law.stick_lost"].any()


@pytest.mark.thorough
def test_lost_stick_brings_the_craft_to_rest():
    """No stick data from 8 s on: lost 0.3 s after the last sample; the craft then comes to rest."""
    script = (0, 0.75, 0.0, "assisted"), (29, 0.75, 0.0, "assisted"), (29.5, 0.75, 0.0, "assisted")
    (log,) = flown(*script, faults=("sensor:stick off @ 8 s",))
    lost = log["law.stick_lost"].astype(bool)
    first = log.t[lost][log.t[lost] > 1][0]
    assert 8.27 <= first <= 8.32
    assert lost[log.t > first].all()
    assert set(log["law.mode"][log.t > 1]) == {STICK_MODES.index("assisted")}
    speed, *_ = motion(log)
    assert speed[log.t < 8].max() > 0.5
    assert speed[log.t > 16].max() < 0.03


@pytest.mark.thorough
def test_c_and_jax_backends_agree():
    """8 s in all three modes, to 1e-9 of each signal's size."""
    scenario, _ = catalogue.load_scenario("hovercraft/pilot")
    script = stick_script(
        (0, 0.5, 0.0, "damped"), (seconds(2), 0.75, 0.5, "assisted"), (seconds(6), -0.5, 0.3, "manual")
    )
    scenario = replace(scenario, world=replace(scenario.world, sensors={**scenario.world.sensors, "stick": script}))
    logs = [simulate(scenario.ideal(), duration=seconds(8), backend=b) for b in ("c", "jax")]
    assert set(logs[0]["law.mode"]) == {MANUAL, DAMPED, ASSISTED}
    for path in logs[0].paths:
        a, b = (np.asarray(log[path], float) for log in logs)
        np.testing.assert_allclose(a, b, atol=1e-9 * max(1.0, np.abs(a).max()), err_msg=path)
