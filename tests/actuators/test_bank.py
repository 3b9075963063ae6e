"""A bank of actuators on a user's vehicle: stages of each field, C and JAX, faults, imperfections switched off."""

import jax.numpy as jnp
import numpy as np
import pytest
from loop.lander import Thrust, hover

from trimtab import simulate
from trimtab.actuators.backlash import Backlash, DeadBand
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag, SecondOrderLag
from trimtab.actuators.transport_delay import TransportDelay
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import PlanarForce, new_sample
from trimtab.core.time import ms, seconds
from trimtab.loop.fault_text import inject_faults, parse_fault
from trimtab.loop.faults import FaultyActuators
from trimtab.loop.settings import with_settings
from trimtab.scenarios.catalogue import load_scenario

ROW = (
    TransportDelay(delay=0.0125),
    DeadBand(half_width=0.02),
    FirstOrderLag(0.05, rate_limit=200.0, low=-30.0, high=5.0),
)


def lander(row, name="F"):
    """A lander whose thrust, three numbers, goes through a row of stages."""
    scenario = hover()
    bank = ActuatorBank(Thrust(np.zeros(3)), {name: row}, period=ms(2))
    return replace(scenario, world=replace(scenario.world, actuators=bank))


def test_only_fields_with_stages_are_delayed():
    bank = ActuatorBank(PlanarForce(0.0, 0.0), {"FX": FirstOrderLag(time_constant=0.01)}, period=ms(10))
    state, out = bank.step(0, bank.init(None), new_sample(0, PlanarForce(1.0, 2.0)))
    assert float(out.u.FX) == pytest.approx(1 - np.exp(-1))
    assert float(out.u.FY) == 2.0
    silent = replace(new_sample(0, PlanarForce(5.0, 5.0)), valid=jnp.asarray(False))
    _, out = bank.step(ms(10), state, silent)  # goes back to neutral at its own pace
    assert float(out.u.FX) == pytest.approx((1 - np.exp(-1)) * np.exp(-1))
    assert float(out.u.FY) == 0.0


def test_stages_act_in_sequence():
    stages = (TransportDelay(delay=0.02, capacity=4), Backlash(width=0.2), FirstOrderLag(0.0, high=0.5))
    bank = ActuatorBank(PlanarForce(0.0, 0.0), {"FX": stages}, period=ms(10))
    state, got, limited = bank.init(None), [], []
    for k in range(4):
        state, out = bank.step(ms(10 * k), state, new_sample(0, PlanarForce(0.3 * (k + 1), 0.0)))
        got.append(float(out.u.FX))
        limited.append(bool(out.limited))
    assert got == pytest.approx([0.0, 0.0, 0.2, 0.5])
    assert limited == [False, False, False, False]
    _, out = bank.step(ms(40), state, new_sample(0, PlanarForce(1.5, 0.0)))
    assert float(out.u.FX) == 0.5
    assert out.limited


@pytest.mark.thorough
@pytest.mark.parametrize("row", [ROW, (SecondOrderLag(rate_limit=100.0), Backlash(0.1))], ids=["first", "second"])
def test_bank_in_c_matches_jax(row):
    logs = [simulate(lander(row), duration=seconds(1), backend=b) for b in ("c", "jax")]
    for path in ("truth.r", "truth.v", "actuators.u.F", "actuators.limited"):
        np.testing.assert_allclose(logs[0][path], logs[1][path], atol=1e-10)
    assert np.ptp(logs[0]["actuators.u.F"][:, 2]) > 1


@pytest.mark.thorough
def test_stages_can_be_set_and_imperfections_switched_off():
    scenario = with_settings(lander(ROW), {"world.actuators.stages.F.2.time_constant": "0.2"})
    assert scenario.world.actuators.stages["F"][2].time_constant == 0.2
    names = {"actuator-delay", "dead-band", "actuator-lag", "rate-limit", "saturation"}
    assert names <= set(scenario.imperfections())
    for name in names:
        scenario = scenario.without(name)
    free, direct = simulate(scenario, duration=seconds(1)), simulate(hover(), duration=seconds(1))
    np.testing.assert_allclose(free["truth.r"], direct["truth.r"], atol=1e-9)  # the same as without actuators


@pytest.mark.thorough
def test_stuck_actuator_holds_its_position():
    log = simulate(
        inject_faults(lander(FirstOrderLag(0.05)), ["actuators stuck @ 1 s for 500 ms"]), duration=seconds(2)
    )
    during = (log.t > 1.0) & (log.t < 1.5)
    assert np.ptp(log["actuators.u.F"][during], axis=0).max() == 0.0
    assert np.ptp(log["actuators.u.F"][~during], axis=0).max() > 1.0


BOTH = ActuatorBank(PlanarForce(0.0, 0.0), {"FX": FirstOrderLag(0.05), "FY": FirstOrderLag(0.05)})


def planar():
    """A scenario whose vehicle has the input of BOTH."""
    scenario, _ = load_scenario("hovercraft/zero-velocity")
    return replace(scenario, world=replace(scenario.world, actuators=BOTH))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("word", "gives"),
    [
        ("stuck", lambda before, good: np.full_like(good, before)),
        ("wrong by -0.4", lambda before, good: 0.6 * good),  # loss of effectiveness
        ("wrong by -1 bias 0.7", lambda before, good: np.full_like(good, 0.7)),  # hard over
        ("off", lambda before, good: np.zeros_like(good)),
    ],
)
def test_fault_in_one_field_leaves_the_other_unaffected(word, gives):
    fault = parse_fault(planar(), f"actuators:FX {word} @ 500 ms")[1]
    bad = FaultyActuators(BOTH, fault)
    state, clean = bad.init(key(0, 0)), BOTH.init(None)
    rows = []
    for k in range(600):
        command = new_sample(ms(k), PlanarForce(np.sin(0.01 * k), np.cos(0.01 * k)))
        state, out = bad.step(np.int64(ms(k)), state, command) if k > 490 else (state, None)
        clean, good = BOTH.step(np.int64(ms(k)), clean, command)
        if k == 490:
            state = replace(state, inner=clean)
        if k > 490:
            rows.append([float(v) for v in (out.u.FX, out.u.FY, good.u.FX, good.u.FY)])
    got = np.array(rows)
    np.testing.assert_allclose(got[:, 1], got[:, 3], atol=1e-15)
    np.testing.assert_allclose(got[:9, 0], got[:9, 2], atol=1e-15)
    np.testing.assert_allclose(got[9:, 0], gives(got[8, 0], got[9:, 2]), atol=1e-12)


def test_rejects_fault_of_unknown_field():
    with pytest.raises(InputError, match="unknown part 'actuators:G'") as refused:
        inject_faults(lander(FirstOrderLag()), ["actuators:G stuck"])
    assert "actuators:F" in refused.value.choices


@pytest.mark.parametrize(
    ("row", "name", "match"),
    [
        (FirstOrderLag(), "G", "has no field 'G'"),
        (SecondOrderLag(frequency=400.0), "F", "a period of at most"),
        (TransportDelay(delay=1.0), "F", "set capacity to 502"),
        (hover(), "F", "is not a stage"),
    ],
)
def test_rejects_stages_that_do_not_fit_the_bank(row, name, match):
    with pytest.raises(InputError, match=match):
        lander(row, name).check()
