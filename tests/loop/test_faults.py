"""Faults: each kind on each type of part against its documentation, fault texts, and dormant faults."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.actuators.allocation import DirectActuation
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, period, quantity, record, replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion, PlanarForce, Sample, new_sample
from trimtab.core.time import ms, seconds
from trimtab.links.wire import Wire
from trimtab.loop.fault_text import add_dormant_faults, fault_locations, inject_faults, parse_fault, watchable_paths
from trimtab.loop.faults import KINDS, Fault, FaultyActuators, FaultyChannel, FaultySensor
from trimtab.loop.structure import strengthen_types
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

STEP = ms(10)
START, END = 100, 200
"""Steps between which the fault acts; 10 ms each."""
N, SLOTS = 300, 40


@record
class Reading:
    """Reading of the odometer. Source: this test."""

    distance: Scalar = quantity("m", "Rises by one a step, from 100.")
    ok: Scalar = quantity("1", "Always.", kind="flag")
    steps: Scalar = quantity("1", "So far.", kind="count")


@record
class Odometer:
    """Source: this test."""

    period: int = period("Period.", default=STEP)

    def init(self, key):
        return ()

    def measure(self, motion):
        return Reading(motion.p_WB[0], jnp.asarray(True), jnp.round(motion.p_WB[0]).astype(np.int32))

    def step(self, t, state, motion):
        return state, new_sample(t, self.measure(motion))


def motion(t):
    k = jnp.asarray(t) // STEP
    zero = jnp.zeros(3)
    return Motion(t, jnp.array([100.0, 0, 0]) + k * jnp.array([1.0, 0, 0]), zero, zero, zero, zero, zero)


def fault(word, severity=1.0, **more):
    told = {"start": START * STEP, "duration": (END - START) * STEP} | more
    return Fault(kind=KINDS.index(word), severity=severity, **told)


@functools.partial(jax.jit, static_argnums=(1, 2))
def _scanned(part, given, carried):
    state = part.init(key(3), given(np.int64(0))) if carried else part.init(key(3))

    def body(s, t):
        return part.step(t, s, given(t))

    return jax.lax.scan(body, strengthen_types(state), jnp.arange(N, dtype=np.int64) * STEP)[1]


def flown(part, given, carried=False):
    """Return the outputs of N steps as numpy arrays; compiled once for all fault kinds."""
    return jax.tree.map(np.asarray, _scanned(to_arrays(part), given, carried))


def sensor(word, severity=1.0, **more):
    return flown(FaultySensor(Odometer(), fault(word, severity, **more), capacity=SLOTS), motion)


def sent(t):
    k = jnp.asarray(t) // STEP
    return new_sample(t, Reading(100.0 + k, jnp.asarray(True), (100 + k).astype(np.int32)))


def channel(word, severity=1.0, **more):
    return flown(FaultyChannel(Wire(period=STEP), fault(word, severity, **more), capacity=SLOTS), sent, carried=True)


def commanded(t):
    k = jnp.asarray(t) // STEP
    return new_sample(t, PlanarForce(1.0 + k, -(1.0 + k)))


def actuators(word, severity=1.0, **more):
    return flown(
        FaultyActuators(DirectActuation(period=STEP), fault(word, severity, **more), capacity=SLOTS), commanded
    ).u


K = np.arange(N)
ACTS = (K >= START) & (K < END)
TRUE = 100.0 + K


def assert_unchanged(out: Sample, where):
    """Assert that the samples equal those of the part without a fault."""
    np.testing.assert_array_equal(out.value.distance[where], TRUE[where])
    np.testing.assert_array_equal(out.t[where], K[where] * STEP)
    assert out.fresh[where].all()
    assert out.valid[where].all()
    assert (out.age[where] == 0).all()


def assert_silent(out, where, last):
    """Assert that no sample is newer than step `last` and that the age grows."""
    np.testing.assert_array_equal(out.t[where], np.broadcast_to(last, N)[where] * STEP)
    np.testing.assert_array_equal(out.value.distance[where], (100.0 + np.broadcast_to(last, N))[where])
    np.testing.assert_allclose(out.age[where], (K - last)[where] * 0.01, atol=1e-12)
    assert not out.fresh[where].any()


@pytest.mark.parametrize("make", [sensor, channel])
@pytest.mark.parametrize("word", ["none", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"])
def test_part_is_unchanged_before_and_after_the_fault(make, word):
    out = make(word, 0.2 if word in ("delayed", "intermittent") else 3.0)
    assert_unchanged(out, ~ACTS if word != "none" else K >= 0)


@pytest.mark.parametrize("make", [sensor, channel])
def test_off_delivers_no_new_samples(make):
    assert_silent(make("off"), ACTS, START - 1)


def test_off_from_the_start_is_not_valid():
    assert not sensor("off", start=0).valid[: END - START].any()
    assert not channel("off", start=0).valid[: END - START].any()


def test_stuck_sensor_repeats_its_value_with_new_times():
    out = sensor("stuck")
    assert (out.value.distance[ACTS] == 100.0 + START - 1).all()
    assert (out.value.steps[ACTS] == 100 + START - 1).all()
    np.testing.assert_array_equal(out.t[ACTS], K[ACTS] * STEP)
    assert out.fresh[ACTS].all()


def test_stuck_link_repeats_value_and_timestamp():
    out = channel("stuck")
    assert (out.t[ACTS] == (START - 1) * STEP).all()
    assert (out.value.distance[ACTS] == 100.0 + START - 1).all()
    assert out.fresh[ACTS].all()
    np.testing.assert_allclose(out.age[ACTS], (K[ACTS] - (START - 1)) * 0.01)


def test_garbage_sensor_gives_random_values_and_nan():
    out = sensor("garbage", 10.0)
    wild = out.value.distance[ACTS]
    assert 3 < np.isnan(wild).sum() < 30, "13 % of 100"
    sizes = abs(wild[~np.isnan(wild)]) / TRUE[ACTS][~np.isnan(wild)]
    assert 2 < np.median(sizes) < 10
    assert len(np.unique(wild[~np.isnan(wild)])) == (~np.isnan(wild)).sum()
    assert 20 < out.value.ok[ACTS].sum() < 80
    assert (out.value.steps[ACTS] != 100 + K[ACTS]).mean() > 0.9
    np.testing.assert_array_equal(out.t[ACTS], K[ACTS] * STEP)


def test_garbage_on_a_link_is_discarded():
    assert_silent(channel("garbage"), ACTS, START - 1)


@pytest.mark.parametrize("make", [sensor, channel])
def test_wrong_scales_and_biases_real_numbers(make):
    out = make("wrong", 0.25, bias=-3.0)
    np.testing.assert_allclose(out.value.distance[ACTS], TRUE[ACTS] * 1.25 - 3.0, rtol=1e-15)
    np.testing.assert_array_equal(out.value.steps, 100 + K)
    assert out.value.ok.all()
    np.testing.assert_array_equal(out.t, K * STEP)


@pytest.mark.parametrize("make", [sensor, channel])
def test_slow_passes_every_nth_sample(make):
    out = make("slow", 4)
    passed = (K + 1) % 4 == 0
    assert_unchanged(out, ACTS & passed)
    last = np.maximum((K + 1) // 4 * 4 - 1, START - 1)
    assert_silent(out, ACTS & ~passed, last)


@pytest.mark.parametrize("make", [sensor, channel])
def test_delayed_gives_old_samples_with_original_timestamps(make):
    out = make("delayed", 0.25)
    first = ACTS & (K < START + 25)
    assert_silent(out, first, START - 1)
    then = ACTS & ~first
    np.testing.assert_array_equal(out.t[then], (K[then] - 25) * STEP)
    np.testing.assert_array_equal(out.value.distance[then], TRUE[then] - 25)
    np.testing.assert_allclose(out.age[then], 0.25)
    assert out.fresh[then].all()


@pytest.mark.parametrize("make", [sensor, channel])
def test_intermittent_is_off_in_random_slots(make):
    out = make("intermittent", 0.4, duration=200 * STEP)
    slots = out.fresh[START:300].reshape(-1, 10)
    assert (slots.all(axis=1) | ~slots.any(axis=1)).all(), "a slot of 100 ms is on or off as a whole"
    assert 0 < (~slots.any(axis=1)).sum() < 20
    assert_unchanged(out, out.fresh)


def test_intermittent_link_drops_all_its_messages_together():
    f = FaultyChannel(Wire(period=STEP), fault("intermittent", 0.5, duration=200 * STEP))

    def run(name):
        state = f.init(key(3).at(name), sent(np.int64(0)))
        times = np.arange(0, 300, 10) * STEP
        return jax.jit(jax.vmap(lambda t: f.fault.is_off(state.memory.key, t)))(times).tolist()

    assert run("downlink.imu") == run("downlink.ranging")


def test_faulty_actuators_give_the_expected_output():
    wanted = 1.0 + K
    for word, severity, expected in (
        ("none", 1.0, wanted),
        ("off", 1.0, np.where(ACTS, 0.0, wanted)),
        ("stuck", 1.0, np.where(ACTS, START, wanted)),
        ("wrong", -2.0, np.where(ACTS, -wanted, wanted)),
        ("slow", 5.0, np.where(ACTS, np.maximum(K // 5 * 5 + 1, START), wanted)),
        ("delayed", 0.3, np.where(ACTS, wanted - 30, wanted)),
    ):
        u = actuators(word, severity)
        np.testing.assert_array_equal(u.FX, expected, err_msg=word)
        np.testing.assert_array_equal(u.FY, -expected, err_msg=word)


def test_garbage_actuators_are_finite_with_the_given_deviation():
    u = actuators("garbage", 2.0)
    assert np.isfinite(u.FX).all()
    assert u.FX[ACTS].std() == pytest.approx(2.0, rel=0.3)
    np.testing.assert_array_equal(u.FX[~ACTS], 1.0 + K[~ACTS])


def test_intermittent_actuators_are_neutral_in_random_slots():
    u = actuators("intermittent", 0.5)
    dead = (u.FX == 0)[ACTS].reshape(-1, 10)
    assert (dead.all(axis=1) | ~dead.any(axis=1)).all()
    assert 0 < dead.all(axis=1).sum() < 10


@pytest.mark.thorough
def test_fault_starts_when_the_watched_signal_crosses_its_level():
    out = sensor("off", start=50 * STEP, duration=20 * STEP, watch="p_WB.0", level=250.0)
    acts = (K >= 151) & (K < 171)
    assert_silent(out, acts, 150)
    assert_unchanged(out, ~acts)
    below = sensor("off", start=50 * STEP, duration=20 * STEP, watch="p_WB.0", level=250.0, side="below")
    assert not below.fresh[50:70].any()
    assert below.fresh[~((K >= 50) & (K < 70))].all()


def test_link_fault_triggers_on_a_carried_signal():
    out = channel("off", start=0, duration=5 * STEP, watch="value.distance", level=299.5)
    assert np.nonzero(~out.fresh)[0].tolist() == [200, 201, 202, 203, 204]


def test_fault_kind_changes_at_run_time_without_recompiling():
    """One compiled step runs with several kinds and severities."""
    sensor = to_arrays(FaultySensor(Odometer(), Fault(), capacity=10))
    step = jax.jit(lambda p, t, s: p.step(t, s, motion(t)))
    state = strengthen_types(sensor.init(key(0)))
    for k in range(30):
        word, severity = ("none", 1.0) if k < 10 else ("wrong", 1.0) if k < 20 else ("delayed", 0.05)
        now = replace(sensor, fault=replace(sensor.fault, kind=np.int32(KINDS.index(word)), severity=severity))
        state, out = step(to_arrays(now), np.int64(k * STEP), state)
        expected = 100 + k if k < 10 else 2 * (100 + k) if k < 20 else 2 * 119 if k < 25 else 100 + k - 5
        assert float(out.value.distance) == expected, k
    assert step._cache_size() == 1


@pytest.mark.thorough("channel", "actuators")
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize(
    ("part", "given", "carried"),
    [
        (FaultySensor(Odometer(), Fault(), capacity=SLOTS), motion, False),
        (FaultyChannel(Wire(period=STEP), Fault(), capacity=SLOTS), sent, True),
        (FaultyActuators(DirectActuation(period=STEP), Fault(), capacity=SLOTS), commanded, False),
    ],
    ids=["sensor", "channel", "actuators"],
)
def test_compiled_c_faults_match_jax(part, given, carried):
    part = to_arrays(part)
    compiled = compile(lambda part: _scanned.__wrapped__(part, given, carried), part)
    for word in KINDS:
        now = to_arrays(replace(part, fault=fault(word, 0.2)))
        for a, b in zip(jax.tree.leaves(_scanned(now, given, carried)), jax.tree.leaves(compiled(now)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12, err_msg=word)


@pytest.fixture(scope="module")
def flight():
    scenario, _ = catalogue.load_scenario("hovercraft/heading-bang-bang")
    return replace(scenario, duration=seconds(1))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "backend",
    [
        "jax",
        pytest.param("c", marks=pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")),
    ],
)
def test_dormant_faults_leave_a_run_bit_for_bit_unchanged(flight, backend):
    plain, wrapped = simulate(flight, backend=backend), simulate(add_dormant_faults(flight), backend=backend)
    assert plain.paths == wrapped.paths
    for path in plain.paths:
        assert plain[path].tobytes() == wrapped[path].tobytes(), path


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_garbage_does_not_reach_the_actuators(flight):
    """A NaN in a state that the law reads makes the command invalid while the NaN lasts."""
    log = simulate(inject_faults(flight, ["sensor:navigation garbage @ 300 ms for 300 ms"]), backend="c")
    bad = ~np.isfinite([log[f"estimate.state.{n}"] for n in flight.autopilot.law.reads]).all(axis=0)
    assert bad[300:].any()
    np.testing.assert_array_equal(log["command.valid"] & bad, False)
    for path in log.paths:
        if path.startswith(("truth", "actuators")):
            assert np.isfinite(log[path]).all(), path
    assert log["command.valid"][-200:].all(), "it flies on"


def test_dormant_faults_keep_the_names_of_imperfections(flight):
    assert add_dormant_faults(flight).imperfections().keys() == flight.imperfections().keys()


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        ("sensor:navigation off", "sensor:navigation", {"kind": 1, "start": 0, "severity": 1.0}),
        ("uplink  delayed by 0.3 @ 3 s", "uplink", {"kind": 6, "start": seconds(3), "severity": 0.3}),
        ("uplink off for 200 ms", "uplink", {"duration": ms(200)}),
        ("actuators wrong", "actuators", {"kind": 4, "severity": -2.0}),
        ("downlink wrong by 0 bias -1.5 @2s", "downlink", {"severity": 0.0, "bias": -1.5, "start": seconds(2)}),
        ("downlink stuck for 1 s when age below -2", "downlink", {"watch": "age", "side": "below", "level": -2.0}),
        ("sensor:navigation stuck when p_WB.0 above 1", "sensor:navigation", {"watch": "p_WB.0"}),
        ("uplink off when value.speed_rpm above 100", "uplink", {"watch": "value.speed_rpm"}),
    ],
)
def test_parses_fault_texts_and_injects_them(flight, text, where, what):
    place, found = parse_fault(flight, text)
    assert place == where
    assert {name: getattr(found, name) for name in what} == what
    assert _part(inject_faults(flight, [text]), place).inner is _part(flight, place)


def _part(scenario, place):
    kind, _, name = place.partition(":")
    return scenario.world.sensors[name] if name else getattr(scenario.world, kind)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("off", r"a part and a kind of fault"),
        (
            "sensor:compass off",
            r"unknown part 'sensor:compass'.*\nChoices: sensor:navigation, downlink, uplink, actuators",
        ),
        ("navigation off", r"unknown part 'navigation'(.|\n)*Fix: write 'sensor:navigation'"),
        ("uplink of", r"unknown kind of fault 'of'(.|\n)*intermittent(.|\n)*write 'off'"),
        ("uplink none", r"unknown kind of fault"),
        ("uplink off @ soon", r"'soon' is not a time"),
        ("uplink off @ -1 s", r"the time must not be negative"),
        ("uplink off by", r"not a number"),
        ("uplink off by nan", r"not a number"),
        ("uplink intermittent by 2", r"fraction of time"),
        ("uplink slow by 0.2", r"at least 1"),
        ("uplink delayed by -1", r"not negative"),
        ("uplink off @ 1 s @ 2 s", r"contains the clause '@' twice"),
        ("uplink off when value.speed", r"not a condition"),
        ("uplink off when value.speed above 2", r"has no signal 'value.speed'(.|\n)*value\.speed_rpm"),
        ("uplink off now", r"a part and a kind of fault"),
    ],
)
def test_rejects_invalid_fault_texts_naming_the_choices(flight, text, match):
    with pytest.raises(InputError, match=match):
        inject_faults(flight, [text])


def test_lists_fault_locations_and_watchable_paths(flight):
    assert fault_locations(flight) == ("sensor:navigation", "downlink", "uplink", "actuators")
    assert "p_WB.2" in watchable_paths(flight, "sensor:navigation")
    assert "value.rudder_pulse" in watchable_paths(flight, "actuators")
    assert "value.heading" in watchable_paths(flight, "downlink")


def test_rejects_a_delay_beyond_the_buffer_capacity():
    with pytest.raises(InputError, match="set capacity to 51"):
        FaultySensor(Odometer(), fault("delayed", 0.5)).check()
    FaultySensor(Odometer(), fault("delayed", 0.5), capacity=51).check()


def test_two_faults_on_one_part_are_nested(flight):
    both = inject_faults(flight, ["uplink off @ 1 s for 1 s", "uplink wrong @ 3 s"])
    assert both.world.uplink.inner.inner is flight.world.uplink
    both.check()
