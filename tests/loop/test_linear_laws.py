"""Laws from gains and compensators: the columns match the states, and the loops are stable in simulation."""

import control
import numpy as np
import pytest
from design.test_coordinates import Dart, DartInput, steady_turn

from examples.my_cart import LIMITS, Cart, CartState, Push, scenario
from trimtab import simulate
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.core.time import ms
from trimtab.design.bryson import weigh_by_limits
from trimtab.design.certificate import design_certificate
from trimtab.design.certificate_file import certificate_json
from trimtab.design.coordinates import error_model
from trimtab.design.linearise import linearise
from trimtab.loop.linear_laws import compensator_law, feedback_law, read_feedback
from trimtab.loop.model_mismatch import model_mismatches


@pytest.fixture(scope="module")
def certificate():
    linear = linearise(error_model(Cart(), CartState(), Push()))
    return design_certificate(weigh_by_limits("cart", linear, LIMITS))


def test_gain_read_from_file_keeps_its_columns(certificate, tmp_path):
    file = tmp_path / "gain.json"
    file.write_text(certificate_json(certificate), encoding="utf-8")
    found = read_feedback(file, CartState(), Push())
    assert found.reads == ("position", "velocity", "lean", "lean_rate")
    np.testing.assert_array_equal(found.K, certificate.K)
    with pytest.raises(InputError, match="the vehicle's are FX, FY"):
        read_feedback(file, CartState(), PlanarForce(0.0, 0.0))


@pytest.mark.thorough
def test_dart_law_equals_linear_feedback_on_error_coordinates():
    """For a state off the steady turn, the law gives u0 + K e, with e of `design.coordinates`."""
    x, u = steady_turn()
    model = error_model(Dart(), x, u)
    linear = linearise(model)
    states = [n for n in linear.states if not n.startswith(("p_W", "fuel"))]
    limits = dict.fromkeys((*states, *linear.inputs), 1.0)
    system = weigh_by_limits("dart", linear.part(states=states), limits)
    found = feedback_law(design_certificate(system), x, u)
    assert (found.reads, found.turned, found.attitude) == (("v_W", "q_WB", "w"), ("v_W",), "q_WB")
    e = 0.05 * np.random.default_rng(3).normal(size=13)
    e[[0, 1, 2, 12]] = 0.0
    now = Estimate(t=0, age=0.0, fresh=True, valid=True, state=model.state(model.x0 + e), dt=0.01)
    demand = found.step(0, found.init(None), now)[1].demand
    wanted = np.concatenate([u.force, u.moment]) + design_certificate(system).K @ e[3:12]
    np.testing.assert_allclose(np.concatenate([demand.force, demand.moment]), wanted, atol=1e-12)
    assert isinstance(demand, DartInput)


@pytest.mark.thorough
def test_feedback_balances_the_cart_and_returns_it():
    log = simulate(scenario())
    assert abs(log["truth.lean"][0]) == pytest.approx(0.1)
    assert abs(log["truth.lean"][-1]) < 1e-3
    assert abs(log["truth.position"][-1]) < 5e-3


def test_reports_mismatch_between_law_model_and_vehicle():
    flown = scenario()
    heavier = replace(flown.world, vehicle=Cart(bob=0.3))
    (one,) = model_mismatches(flown.autopilot, heavier.vehicle)
    assert (one.path, one.assumed, one.actual) == ("bob", "0.1", "0.3")
    other = scenario(Cart(bob=0.3))
    assert not np.allclose(other.autopilot.law.K, flown.autopilot.law.K)
    assert model_mismatches(other.autopilot, heavier.vehicle) == []


@pytest.mark.thorough
def test_python_control_compensator_stabilises_the_cart(certificate):
    """A Kalman filter and gain of python-control, from position and lean alone, replace the state feedback."""
    linear = linearise(error_model(Cart(), CartState(), Push()))
    C = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
    gain, _, _ = control.lqr(linear.A, linear.B, np.diag([4.0, 1, 50, 1]), [[0.1]])
    observer, _, _ = control.lqe(linear.A, np.eye(4), C, np.diag([1.0, 10, 1, 100]), 1e-4 * np.eye(2))
    A = linear.A - linear.B @ gain - observer @ C
    compensator = control.ss(A, observer, -gain, np.zeros((1, 2)))
    made = compensator_law(compensator, ("position", "lean"), np.zeros(2), Push(), period=ms(5))
    flown = scenario()
    flown = replace(flown, autopilot=replace(flown.autopilot, law=made), initial=CartState(lean=0.05))
    log = simulate(flown)
    assert abs(log["truth.lean"][-1]) < 1e-3
    wrong = replace(flown, autopilot=replace(flown.autopilot, law=replace(made, C=-made.C)))
    assert np.nanmax(np.abs(simulate(wrong)["truth.lean"])) > 1  # the pole falls
    with pytest.raises(InputError, match=r"inputs \(errors\): 1, outputs \(inputs of the vehicle\): 1"):
        compensator_law(compensator, ("position",), np.zeros(1), Push(), period=ms(5))
