"""Faults with ranges and piecewise inputs: parsing, rejection, and flights equal to explicitly written ones."""

import numpy as np
import pytest

from trimtab.analysis.campaign.sampling.spread import parse_factors, resolve_spread, spread_arrays, spread_values
from trimtab.analysis.campaign.sampling.varying import parse_fault_range, parse_pieces, pieces_spread, with_pieces
from trimtab.analysis.campaign.workers.prepare import build_scenario, plan_search, prepare_campaign
from trimtab.core.errors import InputError
from trimtab.core.time import ms, seconds
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios.build import build

NAME, SHORT = "hovercraft/zero-velocity", {"duration": "1 s"}
COMMON = {"settings": SHORT, "without": (), "seed": 0, "runs": 1}


@pytest.fixture(scope="module")
def braking():
    return build(NAME, SHORT)


def test_fault_range_unit_is_read_once_or_twice(braking):
    found = parse_fault_range(braking, "downlink off @ 2..10 s for 100 ms..2 s")
    assert found.where == "downlink"
    assert found.text == "downlink off @ 10 s for 2 s"
    assert found.ranges == {"start": (seconds(2), seconds(10)), "duration": (ms(100), seconds(2))}
    found = parse_fault_range(braking, "sensor:navigation wrong by -0.5..0.5 bias 1e-2..0.2 when v_WB_B.0 above -1..2")
    assert found.ranges == {"severity": (-0.5, 0.5), "bias": (0.01, 0.2), "level": (-1.0, 2.0)}
    assert parse_fault_range(braking, "uplink off @ 1..2").ranges == {"start": (seconds(1), seconds(2))}
    assert parse_fault_range(braking, "uplink off @ 500..900 ms").ranges == {"start": (ms(500), ms(900))}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("downlink off @ 2 s", "no range"),
        ("downlink off @ 3..2 s", "must be below the second"),
        ("downlink off @ 2..2 s", "lower and the upper end of each range are equal"),
        ("downlink gone @ 1..2 s", "unknown kind of fault"),
        ("sensor:sonar off @ 1..2 s", "unknown part"),
        ("uplink intermittent by 0.2..1.5", "not valid"),
        ("uplink off @ 1..2 m", "not a time"),
    ],
)
def test_rejects_invalid_fault_range(braking, text, message):
    with pytest.raises(InputError, match=message):
        parse_fault_range(braking, text)


def values_at(plan, u):
    """Return the scenario and the arrays of a plan at a point of its spread."""
    ready = prepare_campaign(plan)
    spread = resolve_spread(ready.scenario, parse_factors(plan.spread))
    values = spread_values(spread, ready.scenario, np.array([u]))
    return ready, spread_arrays(spread, ready.scenario, values)


@pytest.mark.thorough
def test_varied_faults_fly_like_explicitly_written_faults():
    """Two faults of one part, one of another, and one without ranges, all in one program."""
    texts = ("uplink off @ 100..300 ms for 50..150 ms", "uplink delayed by 0.01..0.05 @ 500 ms")
    texts += ("sensor:navigation wrong bias -1..1 @ 0.4..0.6",)
    standing = ("uplink slow by 2 @ 700 ms",)
    plan = plan_search("test", NAME, {}, fault_ranges=texts, faults=standing, **COMMON)
    names = [path for path, _ in plan.spread]
    assert names == [
        "world.sensors.navigation.fault.bias",
        "world.sensors.navigation.fault.start",
        "world.uplink.fault.severity",
        "world.uplink.inner.fault.duration",
        "world.uplink.inner.fault.start",
    ]
    ready, arrays = values_at(plan, [0.75, 0.5, 0.25, 0.5, 0.1])
    batch = simulate_batch(ready.scenario, seeds=[3], spread=arrays, log=True, log_period=ms(1))
    written = ("uplink off @ 120 ms for 100 ms", "uplink delayed by 0.02 @ 500 ms")
    written += ("sensor:navigation wrong bias 0.5 @ 500 ms",)
    log = simulate(build(NAME, SHORT, (), (*standing, *written)), seed=3)
    assert not np.array_equal(log["truth.yaw_rate"], simulate(build(NAME, SHORT), seed=3)["truth.yaw_rate"])
    for path in ("truth.yaw_rate", "uplink.age", "sensors.navigation.value.yaw_rate"):
        np.testing.assert_array_equal(batch.log[path][0], log[path], err_msg=path)


@pytest.mark.thorough
def test_stick_pieces_override_only_the_varied_field():
    texts = ("stick.turn=pieces(4, -1:0.5)",)
    plan = plan_search(
        "test", "hovercraft/pilot", {}, vary=texts, faults=(), **{**COMMON, "settings": {"duration": "4"}}
    )
    assert [path for path, _ in plan.spread] == [f"world.sensors.stick.turn[{k}]" for k in range(4)]
    ready, arrays = values_at(plan, [0.0, 0.2, 0.4, 1.0])
    batch = simulate_batch(ready.scenario, seeds=[0], spread=arrays, log=True, log_period=ms(100))
    turn, forward, mode = (batch.log[f"sensors.stick.value.{name}"][0] for name in ("turn", "forward", "mode"))
    np.testing.assert_allclose(turn, np.repeat([-1.0, -0.7, -0.4, 0.5], 10), atol=1e-12)
    np.testing.assert_array_equal(forward, np.repeat([0.0, 0.75], 20))  # as the demonstration has it from 2 s on
    np.testing.assert_array_equal(mode, np.repeat([0, 2], 20))


def test_pieces_of_a_faulty_stick_use_the_inner_path():
    faulty = build("hovercraft/pilot", {"duration": "4"}, (), ("sensor:stick off @ 3 s",))
    texts = ("stick.turn=pieces(2, -1:1)", "stick.forward=pieces(2, 0:1)")
    paths = list(pieces_spread(with_pieces(faulty, texts), texts))
    assert paths == [f"world.sensors.stick.inner.{name}[{k}]" for name in ("turn", "forward") for k in range(2)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stick.turn=pieces(5, 1)", "must be SENSOR.FIELD"),
        ("stick.turn=pieces(0, -1:1)", "must be from 1 to 100"),
        ("stick.mode=pieces(3, 0:2)", "no field 'mode'"),
        ("stick.turn=pieces(3, -2:1)", "must rise and lie within"),
        ("stick.turn=pieces(3, 1:-1)", "must rise and lie within"),
        ("navigation.turn=pieces(3, -1:1)", "is not a stick"),
    ],
)
def test_rejects_invalid_pieces(text, message):
    with pytest.raises(InputError, match=message):
        with_pieces(build("hovercraft/pilot"), (text,))


def test_rejects_unequal_piece_counts_and_missing_stick(braking):
    with pytest.raises(InputError, match="already has 3 pieces"):
        with_pieces(build("hovercraft/pilot"), ("stick.turn=pieces(3, -1:1)", "stick.forward=pieces(4, 0:1)"))
    with pytest.raises(InputError, match="which has no stick"):
        with_pieces(braking, ("stick.turn=pieces(3, -1:1)",))
    assert parse_pieces("stick.turn = pieces( 3 , -1 : 0.5 )").high == 0.5


def test_rejects_spread_of_an_already_varied_fault(braking):
    spread = {"world.uplink.fault.start": "uniform(0, 10)"}
    with pytest.raises(InputError, match="already varies"):
        plan_search("test", NAME, spread, fault_ranges=("uplink off @ 0.1..0.5 s",), faults=(), **COMMON)
    with pytest.raises(InputError, match="given by name"):
        plan_search("test", braking, {}, fault_ranges=("uplink off @ 0.1..0.5 s",), faults=(), seed=0)
    plan = plan_search("test", NAME, {}, fault_ranges=("uplink off @ 0.1..0.5 s",), faults=(), **COMMON)
    assert int(build_scenario(plan).world.uplink.fault.start) == seconds(0.5)
