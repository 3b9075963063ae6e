"""Predictor: against SciPy, against the later truth, and against the loop without delay."""

import itertools

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.actuators.allocation import DirectActuation
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record, replace, to_arrays
from trimtab.core.rng import key as root_key
from trimtab.core.signals import Command, Estimate, PlanarForce, PlanarState
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.export.export_c import export_c
from trimtab.export.verify import verify_folder
from trimtab.links.slave_bus import SlaveBus
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.calibration import Calibration, Entry
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.predictor import Predictor, predictor_for
from trimtab.run.replay import replay
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

NO_NOISE = ("navigation-error",)
FIELDS = ("surge_velocity", "sway_velocity", "yaw_rate", "heading")
CRAFT = Hovercraft(friction=Friction(force_viscous=0.4, torque_viscous=0.02))


def on(name, settings=None, without=NO_NOISE, faults=()):
    return build(f"hovercraft/{name}", {"predictor": "on", **(settings or {})}, without, faults)


def columns(log, prefix, fields=FIELDS):
    return np.column_stack([log[f"{prefix}.{name}"] for name in fields])


# By itself


def direct(**changes):
    made = Predictor(
        craft=CRAFT,
        actuators=DirectActuation(period=ms(20)),
        start=HovercraftState(),
        uplink_delay=0.053,
        horizon=ms(300),
    )
    return to_arrays(replace(made, **changes))


def estimate(t, age, state, valid=True):
    return Estimate(t=np.int64(t), age=np.float64(age), fresh=True, valid=np.bool_(valid), state=state)


def first(predictor):
    return predictor.init(root_key(0), estimate(0, 0.0, PlanarState(0.0, 0.0, 0.0, 0.0)))


predict, note = jax.jit(Predictor.predict), jax.jit(Predictor.note)


def send(predictor, state, t, force):
    command = Command(t=np.int64(t), valid=np.bool_(True), value=PlanarForce(*map(np.float64, force)))
    return note(predictor, np.int64(t), state, command)


def integrate(x, begin, end, changes, craft=CRAFT):
    """Return SciPy's solution. changes: (time in s, (FX, FY)), the force from each time on; zero before the first."""

    def rate(t, v):
        force = next((f for when, f in reversed(changes) if when <= t), (0.0, 0.0))
        d = craft.dynamics(t, HovercraftState(*v[:3], 0.0, 0.0, v[3]), PlanarForce(*force))
        return [float(getattr(d, name)) for name in FIELDS]

    if end <= begin:
        return x
    knots = [begin, *[w for w, _ in changes if begin < w < end], end]
    with jax.disable_jit():
        for a, b in itertools.pairwise(knots):
            middle = np.nextafter(b, a)
            x = solve_ivp(lambda t, v, m=middle: rate(min(t, m), v), (a, b), x, rtol=1e-9, atol=1e-11).y[:, -1]
    return x


@pytest.mark.thorough
def test_prediction_integrates_the_craft_over_commands_in_transit():
    """Commands each 20 ms, two of them missing: the last force is held. Age and delay fit no period."""
    predictor, rng = direct(), np.random.default_rng(3)
    state, changes = first(predictor), []
    for k in range(30):
        if k not in (21, 25):
            force = rng.normal(size=2)
            state = send(predictor, state, ms(20) * k, force)
            changes.append((0.02 * k + 0.053, tuple(force)))
    t, age, x = ms(600), 0.0937, [0.8, -0.3, 2.5, 0.7]
    state, ahead = predict(predictor, np.int64(t), state, estimate(t, age, PlanarState(*x)))
    wanted = integrate(x, 0.6 - age, 0.6 + 0.053, changes)
    np.testing.assert_allclose([float(getattr(ahead.state, n)) for n in FIELDS], wanted, rtol=0, atol=2e-6)
    assert float(state.prediction.horizon) == pytest.approx(age + 0.053)
    assert bool(ahead.valid)
    assert float(ahead.age) == age


@pytest.mark.thorough
def test_prediction_stops_at_its_horizon_and_reports_the_limit():
    predictor, x = direct(), [0.8, -0.3, 2.5, 0.7]
    state = send(predictor, first(predictor), 0, (1.0, 0.2))
    t = ms(400)
    state, ahead = predict(predictor, np.int64(t), state, estimate(t, 0.4, PlanarState(*x)))
    wanted = integrate(x, 0.0, 0.3, [(0.053, (1.0, 0.2))])
    np.testing.assert_allclose([float(getattr(ahead.state, n)) for n in FIELDS], wanted, rtol=0, atol=1e-3)
    assert bool(state.prediction.limited)
    assert float(state.prediction.horizon) == pytest.approx(0.3)


@pytest.mark.thorough
def test_prediction_is_held_between_two_commands():
    predictor = direct()
    state, one = predict(predictor, np.int64(0), first(predictor), estimate(0, 0.0, PlanarState(1.0, 0.0, 0.0, 0.0)))
    _, two = predict(predictor, np.int64(ms(1)), state, estimate(ms(1), 0.0, PlanarState(9.0, 0.0, 0.0, 0.0)))
    assert float(one.state.surge_velocity) == float(two.state.surge_velocity) != 9.0


def test_prediction_is_valid_after_the_first_valid_estimate():
    predictor, still = direct(), PlanarState(1.0, 0.0, 0.0, 0.0)
    state, ahead = predict(predictor, np.int64(0), first(predictor), estimate(0, 0.0, still, valid=False))
    assert not bool(ahead.valid)
    state, ahead = predict(predictor, np.int64(ms(1)), state, estimate(ms(1), 0.0, still))
    assert not bool(ahead.valid), "what was predicted from nothing"
    _, ahead = predict(predictor, np.int64(ms(20)), state, estimate(ms(20), 0.0, still))
    assert bool(ahead.valid)


def test_older_measurement_or_long_gap_resets_the_predictor():
    predictor, still = direct(), PlanarState(1.0, 0.0, 0.0, 0.0)
    state, resets = first(predictor), []
    ages = {20: 0.0, 40: 0.0, 60: 0.08, 80: 0.0, 480: 0.0, 500: 0.0}
    for t, age in ages.items():
        state, _ = predict(predictor, np.int64(ms(t)), state, estimate(ms(t), age, still))
        resets.append(int(state.prediction.resets))
    assert resets == [0, 0, 1, 1, 2, 2]


def test_angle_innovation_is_wrapped():
    """A heading measured in [0, 2 pi) jumps at a full turn; the innovation stays zero."""
    predictor = direct(uplink_delay=0.02, craft=Hovercraft())
    state = first(predictor)
    for k in range(6):
        heading = np.mod(2 * np.pi - 0.05 + 0.02 * k, 2 * np.pi)
        now = PlanarState(0.0, 0.0, 1.0, heading)
        state, _ = predict(predictor, np.int64(ms(20) * k), state, estimate(ms(20) * k, 0.0, now))
        if k >= 2:
            assert float(state.prediction.innovation.heading) == pytest.approx(0.0, abs=1e-12)


@record
class Fast:
    """Source: this test."""

    surge_velocity: Scalar = quantity("m/s", "Surge.")


@record
class Blank:
    """Source: this test."""

    flow: Scalar = quantity("m/s", "No field of a hovercraft's state.")


@pytest.mark.parametrize(
    ("state", "says"),
    [(Fast(0.0), "depends on sway_velocity, yaw_rate"), (Blank(0.0), "depends on surge_velocity, sway_velocity")],
)
def test_rejects_an_estimate_without_required_states(state, says):
    with pytest.raises(InputError, match=says) as refused:
        direct().init(root_key(0), estimate(0, 0.0, state))
    assert "leave the predictor out" in refused.value.fix


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"actuators": DirectActuation(period=ms(15))}, "actuators.period"),
        ({"horizon": ms(10)}, "horizon"),
        ({"period": ms(30), "actuators": on("forward").autopilot.predictor.actuators}, "period"),
    ],
)
def test_rejects_incompatible_periods(change, part):
    with pytest.raises(InputError) as refused:
        replace(direct(), **change).check()
    assert refused.value.part == part


# In a flight


@pytest.mark.thorough
def test_prediction_equals_the_later_truth():
    """Without noise or model error: the state 40 ms later, across stops, tables, dead zone and brake."""
    log = simulate(on("zero-velocity", {"duration": "6 s"}), seed=0, log_period=ms(20))
    assert log["actuators.brakings"][-1] > 0
    lead = 2  # rows of 20 ms: the chain's 40 ms
    known = log["predictor.valid"][:-lead].astype(bool)
    made, came = columns(log, "predictor.state")[:-lead], columns(log, "truth")[lead:]
    assert known[5:].all()
    np.testing.assert_allclose(made[5:], came[5:], rtol=0, atol=1e-6)
    plain = columns(log, "estimate.state")[:-lead]
    assert np.abs(plain[5:] - came[5:]).max() > 0.1


@pytest.mark.thorough
def test_prediction_error_reveals_a_brake_time_difference():
    """A brake that acts half a tick late gives a visible prediction error: the test above can fail."""
    scenario = on("zero-velocity", {"duration": "6 s"})
    log = simulate(with_brake(scenario, ms(140)), seed=0, log_period=ms(20))
    made, came = columns(log, "predictor.state")[:-2], columns(log, "truth")[2:]
    assert np.abs(made[5:] - came[5:]).max() > 1e-3


def with_brake(scenario, brake):
    predictor = scenario.autopilot.predictor
    controller = replace(predictor.actuators.controller, brake=brake)
    predictor = replace(predictor, actuators=replace(predictor.actuators, controller=controller))
    return replace(scenario, autopilot=replace(scenario.autopilot, predictor=predictor))


@pytest.mark.thorough
@pytest.mark.parametrize("steps", [3, 18])
def test_predicted_delayed_loop_equals_the_undelayed_loop_shifted(steps):
    """For 60 and 360 ms: after the first command the flight equals one without a link from that state."""
    late = ms(20) * steps

    def flight(start, uplink, duration):
        scenario = build("hovercraft/zero-velocity", {}, NO_NOISE)
        scenario = replace(scenario, initial=start, duration=duration)
        world = replace(scenario.world, downlink=Wire(), uplink=uplink)
        made = predictor_for(world, scenario.autopilot, start)
        autopilot = replace(scenario.autopilot, predictor=made)
        return simulate(replace(scenario, world=world, autopilot=autopilot), seed=0, log_period=ms(20))

    start = build("hovercraft/zero-velocity").initial
    far = flight(start, DelayChain(period=ms(20), steps=steps), seconds(5) + late)
    there = HovercraftState(**{n: float(far[f"truth.{n}"][steps]) for n in (*FIELDS, "north", "east")})
    near = flight(there, DelayChain(period=ms(20), steps=0), seconds(5))
    np.testing.assert_allclose(columns(far, "truth")[steps:], columns(near, "truth"), rtol=0, atol=1e-5)


@pytest.mark.thorough
def test_disarmed_supervisor_predicts_a_coasting_craft():
    """Without arming the fan stays off, whatever the law demands, and the craft coasts as predicted."""
    scenario = on("forward", {"supervisor": "automatic", "initial.yaw_rate": "0.8", "initial.sway_velocity": "0.3"})
    supervisor = replace(scenario.autopilot.supervisor, automatic=False)
    scenario = add_pilot_sensor(replace(scenario, autopilot=replace(scenario.autopilot, supervisor=supervisor)))
    log = simulate(scenario, seed=0, duration=seconds(3), log_period=ms(20))
    assert not log["command.valid"].any()
    made, came = columns(log, "predictor.state")[5:-2], columns(log, "truth")[7:]
    np.testing.assert_allclose(made, came, rtol=0, atol=1e-6)


@pytest.mark.thorough
def test_innovation_is_measurement_minus_prediction():
    """With a heavier vehicle: the measurement minus the prediction of the last command, propagated by SciPy."""
    scenario = on("forward", {"world.vehicle.mass": "3.2", "initial.yaw_rate": "0.8", "duration": "4 s"})
    log = simulate(scenario, seed=0, log_period=ms(1))
    for k in range(1000, 4000, 340):
        row = k - k % 20  # the last instant of a prediction
        measured = int(log["downlink.navigation.t"][row])
        acts = measured - measured % ms(20)
        made, at = acts // ms(1) - 40, acts // ms(1)
        x = [log[f"predictor.state.{name}"][made] for name in FIELDS]
        force = log["actuators.u.FX"][at], log["actuators.u.FY"][at]
        there = integrate(x, acts * 1e-7, measured * 1e-7, [(acts * 1e-7, force)], Hovercraft())
        for name, expected in zip(FIELDS, there, strict=True):
            missed = log[f"downlink.navigation.value.{name}"][row] - expected
            assert log[f"predictor.innovation.{name}"][row] == pytest.approx(missed, abs=1e-9)
    assert np.abs(columns(log, "predictor.innovation")[1000:]).max() > 1e-3


@pytest.mark.thorough
def test_innovation_is_logged_without_links():
    log = simulate(on("forward", {"links": "none", "world.vehicle.mass": "3.2"}), seed=0, duration=seconds(1))
    assert np.abs(log["predictor.innovation.surge_velocity"]).max() > 1e-4


@pytest.mark.thorough
def test_downlink_outage_limits_the_horizon_and_then_resets():
    log = simulate(on("forward", {"duration": "5 s"}, faults=["downlink off @ 2 s for 1 s"]), seed=0, log_period=ms(20))
    limited = log["predictor.limited"].astype(bool)
    assert log["predictor.horizon"].max() <= 0.5 + 1e-9
    assert limited[(log.t > 2.55) & (log.t < 3)].all()
    assert not limited[(log.t < 2.4) | (log.t > 3.1)].any()
    assert log["predictor.resets"][-1] == 1


@pytest.mark.thorough
def test_ablated_uplink_delay_sets_the_predicted_delay_to_zero():
    scenario = on("forward", without=(*NO_NOISE, "uplink-delay"))
    assert float(scenario.autopilot.predictor.uplink_delay) == 0
    log = simulate(scenario, seed=0, log_period=ms(20), duration=seconds(2))
    np.testing.assert_allclose(columns(log, "predictor.state")[5:], columns(log, "truth")[5:], rtol=0, atol=1e-6)


def test_rejects_links_of_unknown_latency_and_unknown_choices():
    scenario = build("hovercraft/forward")
    bus = replace(scenario.world, uplink=SlaveBus(size=8, queue=ms(40), capacity=8))
    with pytest.raises(InputError, match="SlaveBus"):
        predictor_for(bus, scenario.autopilot, scenario.initial)
    with pytest.raises(InputError, match="maybe") as refused:
        build("hovercraft/forward", {"predictor": "maybe"})
    assert refused.value.fix == 'settings={"predictor": "on"}'


@pytest.mark.thorough
def test_prediction_uses_the_calibrated_parameters():
    entries = {"Hovercraft.inertia": 0.11, "Thruster.coefficient": 0.0125, "Friction.torque_viscous": 0.02}
    units = ("kg m^2", "N/krpm^2", "N m s")
    boat = Calibration({name: Entry(v, unit, 1e-3) for (name, v), unit in zip(entries.items(), units, strict=True)})
    scenario = build("hovercraft/zero-velocity", {"predictor": "on"}, NO_NOISE, calibration=boat)
    assert float(scenario.world.vehicle.inertia) == 0.11
    log = simulate(scenario, seed=0, duration=seconds(4), log_period=ms(20))
    made, came = columns(log, "predictor.state")[5:-2], columns(log, "truth")[7:]
    np.testing.assert_allclose(made, came, rtol=0, atol=1e-6)


@pytest.mark.thorough
def test_rejects_hypersonic_vehicle_without_pitch_estimate():
    with pytest.raises(InputError, match="depends on theta"):
        simulate(build("hypersonic/noise", {"predictor": "on"}), duration=seconds(1))


def test_off_setting_and_ideal_twin_have_no_predictor():
    assert build("hovercraft/forward", {"predictor": "off"}).autopilot.predictor is None
    scenario = on("forward")
    assert scenario.ideal().autopilot.predictor is None
    assert scenario.autopilot.predictor.craft is not None
    assert to_seconds(scenario.autopilot.predictor.period) == pytest.approx(0.02)


def test_predictor_and_law_share_one_vehicle_model():
    with pytest.raises(InputError, match="two parts have different models"):
        on("forward", {"autopilot.predictor.craft.mass": "3"})
    lighter = on("forward", {"craft": "lighter"}).autopilot
    assert float(lighter.predictor.craft.mass) == float(lighter.law.model.mass) < 2.4


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("settings", [{}, {"links": "measured", "supervisor": "automatic"}])
def test_flight_replays_bit_for_bit_and_backends_agree(settings):
    scenario = on("zero-velocity", settings, without=())
    log = simulate(scenario, seed=2, log_period=ms(1), duration=seconds(2), backend="c")
    again = replay(log, rebuild_scenario(log), backend="c")
    assert again.exact, again.first
    assert {p for p in log.paths if p.startswith("predictor.")} <= set(again.recorded_log.paths)
    other = simulate(scenario, seed=2, log_period=ms(1), duration=seconds(2), backend="jax")
    np.testing.assert_allclose(columns(other, "predictor.state"), columns(log, "predictor.state"), rtol=0, atol=1e-9)


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_c_export_of_the_predictor_is_verified(tmp_path):
    export_c(on("forward", without=()), tmp_path, steps=300)
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first
