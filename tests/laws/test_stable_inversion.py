"""StableInversion: the demand of one step, its integrals, and invalid values.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.core.time import ms
from trimtab.laws.internal_states import QuasiStaticInternal
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.path_inversion import InputLimits
from trimtab.laws.stable_inversion import StableInversion
from trimtab.loop.checks import check_values
from trimtab.sensors.flight_state import FlexibleTruth, FlexibleTruthReading
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicState

LAW = StableInversion(internal=QuasiStaticInternal(), command=FilteredClimb(dh=1000.0, dV=200.0))
TRIM = FlexibleTruthReading(85000.0, 0.0, 7702.0808, 0.0278691, 0.0, 0.903851, 0.0, 0.755137, 0.0)
step = jax.jit(lambda law, t, state, x: law.step(t, state, Estimate(t=t, age=0.0, fresh=True, valid=True, state=x)))


def flown(law=LAW, x=TRIM, times=(0,)):
    state = law.init(key(0))
    for t in times:
        state, out = step(law, np.int64(t), state, x)
    return state, out


@pytest.mark.thorough
def test_demand_at_the_trim_is_the_trim():
    """Oracle, trim."""
    _, out = flown()
    np.testing.assert_allclose(out.demand.Phi, 0.264449, rtol=1e-4)
    np.testing.assert_allclose(np.rad2deg(out.demand.delta_e), 12.427146, rtol=1e-4)
    assert not (out.saturated | out.unsolvable | out.outside)


@pytest.mark.thorough
def test_vehicle_accelerations_equal_the_demanded_ones():
    """The law's demand, applied to the plant, gives (h'', V') = v."""
    want, gamma = LAW.command.at(20.0), 0.002
    x = HypersonicState(want.h + 1.0, want.V + 0.5, 0.0265, 0.0265 + gamma, 0.0, 0.85, 0.1, 0.8, -0.1)
    _, out = flown(x=FlexibleTruth().measure(x), times=(0, ms(20000)))
    assert not out.saturated
    along, normal = Hypersonic().path_accelerations(0.0, x, out.demand)
    got = [along * np.sin(gamma) + normal * np.cos(gamma), along]
    np.testing.assert_allclose(got, out.v, atol=1e-9)


def test_wanted_acceleration_is_feedforward_plus_nine_state_feedback():
    x = replace(TRIM, h=85010.0, q=0.001, eta2_rate=0.3)
    _, out = flown(x=x, times=(0, ms(25000)))
    want = LAW.command.at(25.0)
    order = ("h", "h_rate", "V", "alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
    wanted = [want.h, want.h_rate, want.V]
    wanted += [getattr(out, f"{n}_reference") for n in order[3:]]
    e = np.array([float(getattr(x, n)) for n in order]) - np.array([float(w) for w in wanted])
    expected = np.array([want.h_acceleration, want.V_rate]) + np.array(LAW.K) @ e
    np.testing.assert_allclose(out.v, expected, rtol=1e-10)


def test_integrals_accumulate_error_and_hold_during_saturation():
    law = replace(LAW, command=FilteredClimb(), Ki=((-1e-3, 0.0), (0.0, -1e-3)))
    state, _ = flown(law, replace(TRIM, h=85001.0), [ms(5 * k) for k in range(101)])
    np.testing.assert_allclose(state.integral, [0.5, 0.0], atol=1e-9)
    held, out = flown(law, replace(TRIM, h=87000.0), [ms(5 * k) for k in range(20)])
    assert out.saturated
    np.testing.assert_array_equal(held.integral, [0.0, 0.0])


def test_demand_is_clipped_to_limits_and_flagged():
    law = replace(LAW, limits=InputLimits(Phi_high=0.25))
    _, out = flown(law)
    assert float(out.demand.Phi) == 0.25
    assert out.saturated


@pytest.mark.parametrize("field", ["h", "V", "alpha", "eta1", "q"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nonfinite_estimate_gives_flagged_demand_within_limits(field, value):
    state, out = flown(x=replace(TRIM, **{field: value}))
    limits = LAW.limits
    assert limits.Phi_low <= float(out.demand.Phi) <= limits.Phi_high
    assert limits.delta_low <= float(out.demand.delta_e) <= limits.delta_high
    assert out.saturated
    assert np.isfinite(state.integral).all()


def test_outside_the_fitted_range_is_flagged():
    assert flown(x=replace(TRIM, h=96000.0))[1].outside
    assert flown(x=replace(TRIM, alpha=0.08))[1].outside


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"K": np.full((2, 9), np.inf)}, "not finite"),
        ({"K": np.zeros((2, 8))}, "shape"),
        ({"limits": InputLimits(Phi_low=1.6)}, "each lower limit must be below its upper limit"),
        ({"command": FilteredClimb(dV=-8000.0)}, "ends at"),
    ],
)
def test_rejects_invalid_values(changes, says):
    with pytest.raises(InputError, match=says):
        check_values({"law": replace(LAW, **changes)})
