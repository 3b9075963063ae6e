"""The monitor against the offline semantics, bit for bit; invalid formulas; replayed flights."""

import re

import jax
import numpy as np
import pytest
from oracles.temporal_logic import draw_pair, robustness_at, write_formula

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.formula import parse_formula
from trimtab.core.formula_units import fit_formula, look_ahead
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.time import ms, seconds
from trimtab.logs.robustness import EQUALITY_ROBUSTNESS, HOLDS, PENDING, VERDICTS, VIOLATED, fit_to_log, robustness
from trimtab.loop.monitor import Monitor, MonitorInput
from trimtab.loop.structure import strengthen_types
from trimtab.run.replay import replay
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios.build import build

FORMULAS = "autopilot.monitor.formulas"
C = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


@record
class Seen:
    """Source: this test."""

    x: Scalar = quantity("m", "A number.")
    y: Scalar = quantity("m", "Another.")


def given(x, y):
    return MonitorInput(estimate=Seen(x=x, y=y), law=(), command=(), downlink=())


def watch(monitor, x, y, times=None, compiler=jax.jit):
    """Return the outputs by name, each (n,), of a monitor that receives x and y (n,) at integer times."""
    times = np.arange(len(x)) * monitor.period if times is None else times
    state = strengthen_types(monitor.init(given(0.0, 0.0)))

    def fly(state, rows):
        def body(s, row):
            t, x, y = row
            after = monitor.step(t, s, given(x, y))
            return after, after.outputs

        return jax.lax.scan(body, state, rows)

    rows = (np.asarray(times, np.int64), np.asarray(x, np.float64), np.asarray(y, np.float64))
    _, outputs = (jax.jit(fly) if compiler is jax.jit else compiler(fly, state, rows))(state, rows)
    return {name: (np.asarray(o.robustness), np.asarray(o.verdict)) for name, o in outputs.items()}


def drawn_formulas(n):
    """Return random formulas that can be monitored in flight, by number."""
    found = {}
    for k in range(20 * n):
        tree = draw_pair(k)[0]
        if len(found) < n and look_ahead(parse_formula(write_formula(tree))) is not None:
            found[k] = tree
    assert len(found) == n
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("compiler", [jax.jit, pytest.param(compile, marks=C)], ids=["jax", "c"])
def test_monitor_matches_offline_robustness_in_every_row(compiler):
    trees = drawn_formulas(60)
    words = {word for tree in trees.values() for word in re.findall(r"[a-z]{2,}", write_formula(tree))}
    assert {"always", "eventually", "until", "once", "historically", "since", "not", "implies"} <= words
    rng = np.random.default_rng(5)
    x, y = np.round(rng.normal(size=(2, 90)) * 8) / 4
    texts = {f"f{k}": re.sub(r"\b([xy])\b", r"estimate.\1", write_formula(tree)) for k, tree in trees.items()}
    monitor = Monitor("; ".join(f"{name}: {text}" for name, text in texts.items()), period=seconds(1))
    monitor.check()
    found = watch(monitor, x, y, compiler=compiler)
    for name, text in texts.items():
        formula = fit_formula(text, {"estimate.x": (), "estimate.y": ()}, {"estimate.x": "m", "estimate.y": "m"})
        ticks = np.arange(90) * seconds(1)
        offline = robustness(formula, ticks, {"estimate.x": x[None], "estimate.y": y[None]}.__getitem__)[0]
        delay = look_ahead(formula.root) // seconds(1)
        value, verdict = found[name]
        assert value[delay:].tobytes() == offline[: 90 - delay].tobytes(), text
        assert (verdict[delay:] == np.where(offline[: 90 - delay] > 0, HOLDS, VIOLATED)).all()
        assert not value[:delay].any()
        assert (verdict[:delay] == PENDING).all()
        for i in range(0, 90 - delay, 29):
            wanted = robustness_at(trees[int(name[1:])], {"x": x.tolist(), "y": y.tolist()}, i)
            assert value[i + delay] == wanted or (abs(value[i + delay]) == EQUALITY_ROBUSTNESS and wanted == 0), text


@pytest.mark.thorough("2", "7", "8", "9", "31", "64")
@pytest.mark.parametrize("width", [1, 2, 3, 7, 8, 9, 31, 64, 100])
def test_windows_of_any_length_match_direct_evaluation(width):
    rng = np.random.default_rng(width)
    x, y = rng.normal(size=(2, 300))
    text = f"a: always[0,{width - 1}](estimate.x > 0); u: (estimate.x > -1) until[3,{width + 2}] (estimate.y > 1)"
    found = watch(Monitor(text, period=seconds(1)), x, y)
    least = [x[i : i + width].min() for i in range(301 - width)]
    assert found["a"][0][width - 1 :].tolist() == least
    until = [
        max(min(y[j] - 1, (x[i:j] + 1).min()) for j in range(i + 3, i + width + 3)) for i in range(300 - width - 2)
    ]
    assert found["u"][0][width + 2 :].tolist() == until


def test_outermost_always_keeps_the_minimum_and_eventually_stays_pending():
    x = np.array([3.0, 2.0, 4.0, -1.0, 5.0, 6.0])
    text = "a: always(estimate.x > 0); b: always[2, inf](estimate.x > 0); e: eventually(estimate.x > 4)"
    text += "; n: always(eventually[0, 1](estimate.x > 3.5))"
    found = watch(Monitor(text, period=seconds(1)), x, x)
    assert found["a"][0].tolist() == [3, 2, 2, -1, -1, -1]
    assert found["b"][0].tolist() == [0, 0, 4, -1, -1, -1]
    assert found["e"][0].tolist() == [-1, -1, -EQUALITY_ROBUSTNESS, -EQUALITY_ROBUSTNESS, 1, 2]
    assert found["n"][0].tolist() == [0, -0.5, -0.5, -0.5, -0.5, -0.5]
    names = {name: "".join(VERDICTS[v][0] for v in verdict) for name, (_, verdict) in found.items()}
    assert names == {"a": "hhhvvv", "b": "pphvvv", "e": "pppphh", "n": "pvvvvv"}


def test_nan_violates_a_formula_while_inside_its_window():
    x = np.array([1.0, np.nan, 1.0, 1.0, 1.0])
    found = watch(
        Monitor("historically[0, 1](estimate.x > 0); not once[0, 1](estimate.x < 0)", period=seconds(1)), x, x
    )
    for name in ("requirement_1", "requirement_2"):
        assert found[name][0].tolist() == [1, -np.inf, -np.inf, 1, 1]


def test_monitor_evaluates_each_period_and_holds_between():
    x = np.arange(12.0)
    found = watch(Monitor("estimate.x > 0", period=ms(4)), x, x, np.arange(12) * ms(1))
    assert found["requirement"][0].tolist() == [
        -EQUALITY_ROBUSTNESS,
        *[-EQUALITY_ROBUSTNESS] * 3,
        4,
        4,
        4,
        4,
        8,
        8,
        8,
        8,
    ]


@pytest.mark.parametrize(
    ("formulas", "period", "says"),
    [
        ("", ms(10), "'' must be FORMULA"),
        ("always(estimate.x > 0);", ms(10), "'' must be FORMULA"),
        ("A: always(estimate.x > 0)", ms(10), "is not allowed in a formula"),
        ("a: always(estimate.x > 0); a: once(estimate.x > 0)", ms(10), "two formulas are named 'a'"),
        ("eventually(always(estimate.x > 0))", ms(10), "looks ahead without a time limit"),
        ("always(estimate.x > 0) and once(estimate.x > 0)", ms(10), "looks ahead without a time limit"),
        (
            "once[11 ms, 19 ms](estimate.x > 0)",
            ms(10),
            "the interval of once contains no evaluation, because the monitor's period is 10 ms",
        ),
        ("always[0, 200 s](estimate.x > 0)", ms(1), "needs to store 20"),
        ("always(estimate.x >)", ms(10), "at column 20"),
    ],
)
def test_rejects_formulas_that_cannot_be_monitored_in_flight(formulas, period, says):
    with pytest.raises(InputError) as refused:
        Monitor(formulas, period=period).check()
    assert says in str(refused.value)
    assert refused.value.fix


@pytest.mark.parametrize(
    ("formula", "says"),
    [
        ("always(truth.yaw_rate < 1 rad/s)", "Choices: estimate.state.yaw_rate"),
        ("always(yaw_rate < 1 rad/s)", "Choices: estimate.state.yaw_rate"),
        ("always(estimate.state.yaw_rate < 1 m)", "rad/s and m are compared"),
    ],
)
def test_rejects_formulas_on_truth_signals(formula, says):
    with pytest.raises(InputError, match=re.escape(says)) as refused:
        simulate(build("hovercraft/spin", {FORMULAS: formula}), duration=ms(10))
    assert str(refused.value).startswith("autopilot.monitor: formula")


TURN = "always[0.2 s, 2 s](abs(estimate.state.yaw_rate - 3 rad/s) < 1.5 rad/s)"
BRAKE = "(estimate.state.yaw_rate < 2 rad/s) until[0, 1.5 s] (law.demand.FX > 0.1 N or estimate.age > 50 ms)"
SAFE = "always(command.valid == 1 implies once[0, 300 ms](estimate.age < 0.1 s))"


def spin(**settings):
    flown = {FORMULAS: f"turn: {TURN}; brake: {BRAKE}; safe: {SAFE}", **settings}
    return build("hovercraft/spin", flown)


@pytest.fixture(scope="module")
def flights():
    """Return the same flight on each available backend."""
    backends = ("c", "jax") if find_compiler("c") is not None else ("jax",)
    return {b: simulate(spin(), seed=3, duration=seconds(8), backend=b) for b in backends}


@pytest.mark.thorough
@pytest.mark.parametrize("backend", ["jax", pytest.param("c", marks=C)])
def test_logged_robustness_matches_offline_evaluation_of_the_log(flights, backend):
    log = flights[backend]
    rows = log.ticks % ms(10) == 0
    for name, text, delay in (("turn", TURN, 200), ("brake", BRAKE, 150)):
        formula = fit_to_log(text, log)
        offline = robustness(formula, log.ticks[rows], lambda path: log[path][rows][None])[0]
        value = log[f"monitor.{name}.robustness"][rows]
        assert value[delay:].tobytes() == offline[: len(value) - delay].tobytes()
        assert len(np.unique(log[f"monitor.{name}.verdict"])) == 3
    assert (log["monitor.safe.verdict"] == HOLDS).all()
    assert log.declarations["monitor.turn.verdict"].modes == VERDICTS


@pytest.mark.thorough
@C
def test_monitor_leaves_the_flight_unchanged_and_replays_bit_for_bit(flights):
    log = flights["c"]
    without = simulate(build("hovercraft/spin"), seed=3, duration=seconds(8), backend="c")
    for path in without.paths:
        assert log[path].tobytes() == without[path].tobytes(), path
    again = replay(log, spin())
    assert again.exact
    assert "monitor.turn.robustness" in again.replayed_log
    changed = dict(log.signals) | {"monitor.turn.robustness": log["monitor.turn.robustness"] + 1e-12}
    assert not replay(replace_signals(log, changed), spin()).exact


@pytest.mark.thorough
@C
def test_batch_runs_match_single_runs():
    batch = simulate_batch(spin(), seeds=[3] * 11, runs=range(11), signals=("monitor",), log=True, log_period=ms(10))
    for run in (0, 7, 10):
        alone = simulate(spin(), seed=3, run=run, signals=("monitor",), log_period=ms(10), backend="c")
        for path in alone.paths:
            assert np.asarray(batch.log[path][run], alone[path].dtype).tobytes() == alone[path].tobytes(), path


def replace_signals(log, signals):
    return type(log)(log.t, log.ticks, signals, log.declarations, log.metadata, log.final)


def test_ideal_twin_and_default_scenario_have_no_monitor():
    scenario = spin()
    assert scenario.ideal().autopilot.monitor is None
    assert build("hovercraft/spin").autopilot.monitor is None
