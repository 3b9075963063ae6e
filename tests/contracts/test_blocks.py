"""Contracts of every block: step is pure, finite, of stable structure, compilable and batchable."""

import functools
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from contracts import checks, parts
from contracts.parts import blocks, every, example, made, rollout
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.imperfections import imperfections, without
from trimtab.core.record import FAST_COMPILE_OPTIONS, declarations, part, period, record, replace, to_arrays
from trimtab.core.signals import Motion, new_sample
from trimtab.core.time import ms, to_seconds

STEPS = 40
RUNS = 3
FOLDERS = parts.FOLDERS[1:]
BLOCKS = every(blocks, FOLDERS)


def mark_thorough(found, which):
    """Mark as thorough the blocks for which which(folder, cls) holds."""
    marks = ([pytest.mark.thorough] if which(*one.values) else [] for one in found)
    return [pytest.param(*one.values, id=one.id, marks=m) for one, m in zip(found, marks, strict=True)]


LONG_PROGRAMS = {
    *("RecedingHorizon", "RotorLossTracking", "PathTracking", "StableInversion", "Formation", "GeometricTracking"),
    *("UltrasonicRanging", "GnssRanges", "AnchorRanging", "StarTracker"),
    *("MeasuredLatency", "SlaveBus", "RangingPosition", "Particle"),
}
"""Blocks that take several seconds to compile."""


def is_long(folder, cls):
    """Whether the program of a block takes seconds to compile, as those of estimators that fuse several sensors do."""
    return cls.__name__ in LONG_PROGRAMS or (folder == "estimators" and len(made(cls).listens) > 1)


QUICK = mark_thorough(BLOCKS, is_long)
BATCHED = ("Wire", "LatencyTrace", "DelayChain", "Imu", "Gnss", "Encoder", "NoisyPlanarPose")
"""Blocks that the gate flies in batches: they draw random numbers, each in another way."""


OPTIONS = FAST_COMPILE_OPTIONS if os.environ.get("XLA_FLAGS") else {}
"""Half of the time to compile; an empty XLA_FLAGS leaves XLA as users have it."""


@functools.cache
def _example(folder, cls):
    """Inputs that fit: finding them takes as long as a test does."""
    return example(folder, made(cls))


@functools.cache
def _traced(folder, cls):
    """The rollout of a block, traced once for all contracts."""
    return checks.trace(folder, made(cls), _example(folder, cls), STEPS)


@functools.cache
def _alone(folder, cls):
    """State and outputs of each run by itself, compiled once."""
    compiled = _traced(folder, cls).program.lower().compile(compiler_options=OPTIONS)
    return [compiled(made(cls), np.uint32(run)) for run in range(RUNS)]


@pytest.mark.parametrize(("folder", "cls"), QUICK)
def test_block_state_keeps_its_structure(folder, cls):
    checks.assert_stable(_traced(folder, cls))


@pytest.mark.parametrize(("folder", "cls"), QUICK)
def test_step_is_pure(folder, cls):
    again = checks.trace(folder, made(cls), _example(folder, cls), STEPS)
    checks.assert_pure(_traced(folder, cls), again)


@pytest.mark.parametrize(("folder", "cls"), QUICK)
def test_output_is_finite(folder, cls):
    for _, outputs in _alone(folder, cls):
        checks.assert_finite(outputs)


@pytest.mark.thorough
@pytest.mark.parametrize(("folder", "cls"), BLOCKS)
def test_compiled_rollout_equals_single_steps(folder, cls):
    one = made(cls)
    given = _example(folder, cls)
    state = parts.first_state(folder, one, given, 1)
    for k in range(3):
        t = np.int64(k * parts.period(one))
        state, out = one.step(t, state, given(t))
        checks.assert_near(out, jax.tree.map(lambda a, k=k: a[k], _alone(folder, cls)[1][1]))


@pytest.mark.parametrize(
    ("folder", "cls"),
    mark_thorough(BLOCKS, lambda _, cls: cls.__name__ not in BATCHED),
)
def test_batched_rollout_equals_single_runs(folder, cls):
    """Over a batch of keys and of parameters at once: every quantity has a leading axis."""
    one = made(cls)
    given = _example(folder, cls)
    batch = jax.tree.map(lambda leaf: np.stack([leaf] * RUNS), one)
    together = jax.vmap(lambda one, run: rollout(folder, one, given, run, STEPS))
    both = jax.jit(together, compiler_options=OPTIONS)(batch, jnp.arange(RUNS))
    for run, alone in enumerate(_alone(folder, cls)):
        checks.assert_near(jax.tree.map(lambda a, run=run: a[run], both), alone)


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize(("folder", "cls"), BLOCKS)
def test_generated_c_equals_jax(folder, cls):
    """Exportable: the generator writes C for it, and the C gives what JAX gives."""
    one = made(cls)
    given = _example(folder, cls)
    run = compile(lambda one, run: rollout(folder, one, given, run, STEPS), one, np.uint32(0))
    for seed, (state, outputs) in enumerate(_alone(folder, cls)):
        checks.assert_near((state, outputs), run(one, np.uint32(seed)))


def sensors(late):
    """Those that give a sample at each step, or (LATE) those whose samples come out after they were measured."""
    return [p for p in every(blocks, ("sensors",)) if getattr(p.values[1], "LATE", False) == late]


@pytest.mark.parametrize(("folder", "cls"), mark_thorough(sensors(late=False), is_long))
def test_sensor_timestamps_are_current_and_values_match_measure(folder, cls):
    one = made(cls)
    _, samples = _alone(folder, cls)[0]
    np.testing.assert_array_equal(samples.t, np.arange(STEPS) * one.period)
    assert (np.asarray(samples.age) == 0).all()
    assert np.asarray(samples.fresh).all()
    assert np.asarray(samples.valid).all()
    measured_there = jax.eval_shape(one.measure, parts.felt(one)(np.int64(0)))
    assert jax.tree.structure(samples.value) == jax.tree.structure(measured_there)


@pytest.mark.parametrize(("folder", "cls"), mark_thorough(sensors(late=True), is_long))
def test_delayed_sensor_reports_measurement_time_and_matches_measure(folder, cls):
    """Nothing from the future; fresh when it comes out, once; as old as it says. Two seconds, 10 ms a step."""
    one = replace(made(cls), period=ms(10))
    _, samples = jax.jit(lambda one: rollout(folder, one, example(folder, one), 0, 200))(one)
    now, t = np.arange(200) * one.period, np.asarray(samples.t)
    fresh, valid = np.asarray(samples.fresh), np.asarray(samples.valid)
    assert 2 <= fresh.sum() < 200
    np.testing.assert_array_equal(valid, np.cumsum(fresh) > 0)
    assert (t[valid] <= now[valid]).all()
    assert (np.diff(t[valid]) >= 0).all()
    assert not (np.diff(t)[~fresh[1:]]).any(), "another time, yet not fresh"
    np.testing.assert_allclose(np.asarray(samples.age)[valid], (now - t)[valid] * 1e-7, atol=1e-12)
    measured_there = jax.eval_shape(one.measure, parts.felt(one)(np.int64(0)))
    assert jax.tree.structure(samples.value) == jax.tree.structure(measured_there)


@functools.cache
def _channel(cls):
    """Number of steps in two seconds, and the outputs of a channel in them: of valid samples, and of invalid ones."""
    one = made(cls)
    n = int(2 / to_seconds(one.period))

    def run(one, valid):
        def given(t):
            return replace(new_sample(t, parts.planar_state(t)), valid=valid, fresh=valid)

        return rollout("links", one, given, 1, n)[1]

    compiled = jax.jit(run, compiler_options=OPTIONS)
    return n, compiled(one, True), compiled(one, False)


@pytest.mark.parametrize(("folder", "cls"), mark_thorough(every(blocks, ("links",)), is_long))
def test_channel_delivers_sent_samples_with_correct_time(folder, cls):
    """Nothing from the future, nothing altered; the age is the time since the measurement."""
    n, out, _ = _channel(cls)
    now = np.arange(n) * made(cls).period
    valid = np.asarray(out.valid)
    assert valid[-1], "two seconds of fresh samples and none came out"
    assert (np.diff(valid.astype(int)) >= 0).all(), "valid was taken back"
    t = np.asarray(out.t)[valid]
    assert (t <= now[valid]).all()
    assert (np.diff(t) >= 0).all(), "an older sample replaced a newer one"
    np.testing.assert_allclose(np.asarray(out.age)[valid], (now[valid] - t) * 1e-7, rtol=1e-9, atol=1e-12)
    checks.assert_near(jax.tree.map(lambda a: a[valid], out.value), parts.planar_state(t))
    fresh = np.asarray(out.fresh)[valid]
    changed = np.diff(t, prepend=-1) > 0
    np.testing.assert_array_equal(fresh, changed, err_msg="fresh is not 'newly arrived'")


@pytest.mark.parametrize(("folder", "cls"), mark_thorough(every(blocks, ("links",)), is_long))
def test_channel_is_invalid_before_first_valid_sample(folder, cls):
    _, _, out = _channel(cls)
    assert not np.asarray(out.valid).any()
    checks.assert_finite(out)


@pytest.mark.parametrize(("folder", "cls"), mark_thorough(every(blocks, ("laws",)), is_long))
def test_law_outputs_demand_and_reads_only_declared_states(folder, cls):
    one = made(cls)
    _, out = _alone(folder, cls)[0]
    assert hasattr(out, "demand")
    known = set(declarations(_example(folder, cls)(np.int64(0)).state))
    assert set(one.reads) <= known


@pytest.mark.parametrize(
    ("folder", "cls"), [p for p in every(blocks, ("actuators",)) if hasattr(p.values[1], "neutral")]
)
def test_actuators_stay_neutral_until_a_command_is_valid(folder, cls):
    one = made(cls)
    given = _example(folder, cls)

    def invalid(t):
        return replace(given(t), valid=False, fresh=False)

    _, out = jax.jit(lambda one: rollout(folder, one, invalid, 0, STEPS))(one)
    neutral = one.neutral()
    assert jax.tree.structure(jax.tree.map(lambda a: a[0], out)) == jax.tree.structure(neutral)
    for u in jax.tree.leaves(out.u):
        np.testing.assert_array_equal(u, 0.0)
    for u in jax.tree.leaves(neutral.u):
        np.testing.assert_array_equal(u, 0.0)


@pytest.mark.parametrize(("folder", "cls"), BLOCKS)
def test_each_imperfection_can_be_switched_off(folder, cls):
    one = made(cls)
    for name in imperfections(one):
        assert type(without(one, name)) is cls
        assert jax.tree.structure(without(without(one, name), name)) == jax.tree.structure(without(one, name))


@pytest.mark.thorough
@pytest.mark.parametrize("cls", [pytest.param(c, id=c.__name__) for c in parts.vehicles()])
def test_vehicle_is_pure_finite_differentiable_and_batchable(cls):
    one = made(cls)
    state = next(
        f for f in parts.states()[1:] if type(f(np.int64(0))) is parts.typing.get_type_hints(cls.dynamics)["x"]
    )
    takes = parts.typing.get_type_hints(cls.dynamics)["u"]
    x, u = state(np.int64(0)), to_arrays(parts.vehicle_input(takes, ms(20)))
    rate = jax.jit(lambda c, x, u: c.dynamics(0.0, x, u))(one, x, u)
    assert jax.tree.structure(rate) == jax.tree.structure(x)
    checks.assert_finite(rate)
    checks.assert_near(one.dynamics(0.0, x, u), rate)
    checks.assert_finite(jax.jacfwd(lambda x: one.dynamics(0.0, x, u))(x))
    motion = one.motion(np.int64(0), x, u)
    assert type(motion) is Motion
    checks.assert_finite(motion)
    batch = jax.vmap(lambda x: one.dynamics(0.0, x, u))(jax.tree.map(lambda a: np.stack([a, 2 * a]), x))
    checks.assert_near(jax.tree.map(lambda a: a[0], batch), rate)


@record
class _Counter:
    """A sensor that is wrong in a way of choice. Source: this test."""

    period: int = period("Period.", default=ms(1))
    memory: object = part("Where an impure one counts.", default=None)

    def init(self, key):
        return jnp.asarray(0.0)

    def step(self, t, state, motion):
        return state + 1.0, new_sample(t, parts.planar_state(t))


@record
class _Forgetful(_Counter):
    """A sensor whose state changes its type. Source: this test."""

    def init(self, key):
        return 0


@record
class _Impure(_Counter):
    """A sensor that counts its calls. Source: this test."""

    calls = 0

    def step(self, t, state, motion):
        type(self).calls += 1
        return state, new_sample(t, parts.planar_state(t + self.calls))


def test_contract_checks_detect_violations():
    """A good block passes; a state that changes type, an impure step and a NaN do not."""
    checks.assert_stable(checks.trace("sensors", _Counter()))
    checks.assert_pure(*(checks.trace("sensors", _Counter()) for _ in range(2)))
    with pytest.raises(AssertionError, match="became"):
        checks.assert_stable(checks.trace("sensors", _Forgetful()))
    with pytest.raises(AssertionError, match="two calls differ"):
        checks.assert_pure(*(checks.trace("sensors", _Impure()) for _ in range(2)))
    with pytest.raises(AssertionError):
        checks.assert_finite({"x": jnp.asarray(np.nan)})
