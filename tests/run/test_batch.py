"""simulate_batch: dispersed parameters, reductions on the fly, refusals; equal on every backend."""

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace, with_leaf
from trimtab.core.time import ms, seconds
from trimtab.run.runner import LEAST_LANE_RUNS
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios import catalogue

RUNS = LEAST_LANE_RUNS + 3
MASSES = np.linspace(2.2, 3.2, RUNS)
SPREAD = {"world.vehicle.mass": MASSES}
needs_c = pytest.mark.skipif(find_compiler("c++") is None, reason="no C++ compiler here")


@pytest.fixture(scope="module")
def short():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    return replace(scenario, duration=seconds("0.4"))


@pytest.fixture(scope="module")
def lanes(short):
    return simulate_batch(short, seeds=range(RUNS), spread=SPREAD, log=True, log_period=ms(1))


@pytest.mark.thorough
@needs_c
def test_batch_run_equals_the_single_run(short, lanes):
    assert lanes.backend == "c lanes"
    for i in (0, 20, RUNS - 1):
        heavy = with_leaf(short, "world.vehicle.mass", lambda old, declared, i=i: MASSES[i])
        alone = simulate(heavy, seed=i, backend="c")
        for path in alone.paths:
            np.testing.assert_array_equal(lanes.log[path][i], alone[path], err_msg=path)
        for path, value in alone.final.items():
            assert lanes.final[path][i] == value


WORDS = np.random.default_rng(1).integers(0, 2**32, (RUNS, 32), dtype=np.uint32)


def with_words(scenario, words):
    return replace(scenario, words=tuple(int(word) for word in words))


@pytest.mark.thorough
@needs_c
def test_random_key_words_give_same_noise_in_batch_and_alone(short):
    """Key words per run, and key words of a scenario to which the run number is added."""
    seeds = [5] * RUNS
    batch = simulate_batch(with_words(short, [0] * 32), seeds=seeds, runs=WORDS, log=True, log_period=ms(1))
    assert batch.backend == "c lanes"
    path = "sensors.navigation.value.yaw_rate"
    for i in (0, 33):
        alone = simulate(with_words(short, WORDS[i]), seed=5)
        np.testing.assert_array_equal(batch.log[path][i], alone[path])
        assert alone.metadata["words"] == WORDS[i].tolist()
    numbered = simulate_batch(with_words(short, WORDS[0]), seeds=seeds, runs=range(RUNS), log=True, log_period=ms(1))
    for run in (0, 7):
        alone = simulate(with_words(short, WORDS[0]), seed=5, run=run)
        np.testing.assert_array_equal(numbered.log[path][run], alone[path])
        same = simulate(with_words(short, WORDS[0] + np.uint32(run)), seed=5)
        np.testing.assert_array_equal(same[path], alone[path])
    assert not np.array_equal(numbered.log[path][0], numbered.log[path][7])


def test_rejects_random_key_words_of_wrong_size(short):
    with pytest.raises(InputError, match="run numbers: "):
        simulate_batch(short, seeds=[0] * RUNS, runs=WORDS)
    with pytest.raises(InputError, match="random key words for each run: 32, in the scenario: 8"):
        simulate_batch(with_words(short, [0] * 8), seeds=[0] * RUNS, runs=WORDS)


@needs_c
def test_reductions_match_the_log(lanes):
    for path in ("truth.yaw_rate", "law.demand.FX", "actuators.u.FY"):
        rows = lanes.log[path]
        np.testing.assert_array_equal(lanes.least[path], rows.min(axis=1))
        np.testing.assert_array_equal(lanes.most[path], rows.max(axis=1))
        np.testing.assert_allclose(lanes.mean[path], rows.mean(axis=1), atol=1e-12)
        np.testing.assert_allclose(lanes.rms[path], np.sqrt((rows**2).mean(axis=1)), atol=1e-12)


@pytest.mark.thorough
def test_jax_and_c_draw_the_same_noise_from_key_words(short):
    own = with_words(short, WORDS[0])
    c, on_jax = simulate(own, seed=5), simulate(own, seed=5, backend="jax")
    for path in ("sensors.navigation.value.yaw_rate", "truth.yaw_rate"):
        np.testing.assert_allclose(c[path], on_jax[path], atol=1e-11)


@pytest.mark.thorough
def test_jax_and_c_batches_agree(short):
    chosen = {"seeds": range(5), "spread": {"world.vehicle.mass": MASSES[:5]}, "signals": ("truth",), "log": True}
    c, on_jax = simulate_batch(short, **chosen), simulate_batch(short, **chosen, backend="jax")
    assert on_jax.backend == "jax"
    for path in c.log:
        np.testing.assert_allclose(c.log[path], on_jax.log[path], atol=1e-11)
        np.testing.assert_allclose(c.rms[path], on_jax.rms[path], atol=1e-11)
        np.testing.assert_allclose(c.most[path], on_jax.most[path], atol=1e-11)
    for path in c.final:
        np.testing.assert_allclose(c.final[path], on_jax.final[path], atol=1e-11)


@pytest.mark.thorough
def test_disabled_log_keeps_only_reductions(short):
    batch = simulate_batch(short, seeds=[1, 2], signals=("truth.yaw_rate",))
    assert batch.log == {}
    assert list(batch.rms) == ["truth.yaw_rate"]
    assert batch.rms["truth.yaw_rate"].shape == (2,)


@pytest.mark.parametrize(
    ("spread", "says"),
    [
        ({"world.vehicle.mas": [1.0, 2.0]}, "world.vehicle.mass"),
        ({"world.vehicle.mass": [1.0]}, r"shape \(1,\)"),
        ({"world.vehicle.mass": [1.0, np.nan]}, "finite"),
        ({"key.seed": [1, 2]}, "unknown parameter"),
    ],
)
def test_rejects_invalid_spread(short, spread, says):
    with pytest.raises(InputError, match=says):
        simulate_batch(short, seeds=[1, 2], spread=spread)


def test_rejects_unknown_signal_and_backend(short):
    with pytest.raises(InputError, match="truth"):
        simulate_batch(short, seeds=[1], signals=("thruth",))
    with pytest.raises(InputError, match="auto"):
        simulate_batch(short, seeds=[1], backend="gpu")
