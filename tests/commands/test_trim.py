"""`trimtab trim`, `linearise` and `zeros`: conditions by name, tables, files, and invalid arguments."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.linearise import print_modes
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.signals import Motion
from trimtab.design.linear_file import read_linear
from trimtab.design.linearise import LinearModel
from trimtab.run.design_point import find_point, smooth_model
from trimtab.run.plant import load_plant, plant_of_vehicle

CART = "examples/my_cart.py:scenario"
OWN = """
import jax.numpy as jnp
from trimtab.design.model import model_of_functions

def system():
    return model_of_functions(lambda x, u: jnp.stack([x[1], -x[0] - x[1]**3 + u[0]]), ("x", "v"), ("F",))

def number():
    return 3
"""


@pytest.fixture
def own(tmp_path):
    file = tmp_path / "my_system.py"
    file.write_text(OWN, encoding="utf-8")
    return file


def call(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


def data(*words, code=0):
    done = call(*words, "--json")
    assert done.exit_code == code, done.output
    return json.loads(done.stdout)


@pytest.mark.thorough
def test_trims_turn_with_friction_from_named_conditions():
    """Conditions by name and unit, a free state, a moving position."""
    friction = (
        "--set",
        "world.vehicle.friction.force_viscous=0.8",
        "--set",
        "world.vehicle.friction.torque_viscous=0.05",
    )
    at = ("--at", "surge_velocity=100 cm/s", "--at", "yaw_rate=10 deg/s")
    found = data("trim", "hovercraft/forward", *at, *friction)
    assert found["is_found"]
    assert found["states"]["yaw_rate"] == pytest.approx(np.radians(10))
    assert found["rates"]["heading"] == pytest.approx(np.radians(10))
    assert found["rates"]["north"] != 0
    moving = {"north", "east", "heading"}
    assert all(abs(v) < 1e-12 for n, v in found["rates"].items() if n not in moving)
    # the force at the tail turns against friction: -d FY = D r
    assert found["inputs"]["FY"] == pytest.approx(-0.05 * np.radians(10) / 0.32)


@pytest.mark.thorough
def test_missing_trim_is_reported_with_reason():
    done = call("trim", "hovercraft/forward", "--at", "surge_velocity=1", "--at", "yaw_rate=0.2")
    assert done.exit_code == 1
    assert "NO trim" in done.output
    assert "sway_velocity'" in done.output


def test_accepts_rates_bounds_and_unconstrained_rates(own):
    found = data("trim", own, "--at", "v'=0.5", "--at", "x'=any", "--at", "v=2", "--at", "x=0", "--at", "F=-100..100")
    assert found["inputs"]["F"] == pytest.approx(8.5)
    bound = data("trim", own, "--at", "v=0", "--at", "x=2", "--at", "F=0..1", code=1)
    assert bound["at_bound"] == {"F": "high"}


@pytest.mark.thorough
def test_linearise_gives_poles_of_cart_and_writes_file(tmp_path):
    file = tmp_path / "model.json"
    found = data("linearise", CART, "--out", file)
    fast = max(m["pole"][0] for m in found["modes"])
    g, length, bob, cart = 9.80665, 0.5, 0.1, 1.0
    assert fast == pytest.approx(np.sqrt(g / length * (1 + bob / cart)), rel=5e-3)  # no drag
    linear, about = read_linear(file)
    assert about["vehicle"] == CART
    np.testing.assert_array_equal(linear.A, found["A"])
    assert found["files"] == [str(file)]
    held = data("linearise", CART, "--state", "lean", "--state", "lean_rate")
    assert np.shape(held["A"]) == (2, 2)


@pytest.mark.thorough
def test_zeros_of_cart_match_analytic_value():
    """Zeros from force to position lie at plus and minus sqrt(g/l). Source: textbooks on the inverted pendulum."""
    found = data("zeros", CART, "--output", "position")
    assert found["verdict"] == "non-minimum phase"
    assert sorted(z["zero"][0] for z in found["zeros"]) == pytest.approx(
        [-np.sqrt(9.80665 / 0.5), np.sqrt(9.80665 / 0.5)]
    )
    assert [z["is_right"] for z in found["zeros"]] == [True, False]
    assert data("zeros", CART, "--output", "lean")["verdict"] != "non-minimum phase"
    assert "inputs: 1, outputs: 4" in call("zeros", CART).output


@pytest.mark.thorough
def test_zeros_of_hypersonic_vehicle_are_non_minimum_phase():
    text = call("zeros", "hypersonic", "--output", "h", "--output", "V").output
    assert "RIGHT: non-minimum phase" in text
    assert "+3.2894" in text


@pytest.mark.thorough
def test_closed_loop_of_cart_reports_stability_and_delay_margin(tmp_path):
    picture = tmp_path / "bode.png"
    found = data("linearise", CART, "--closed-loop", "--plot", picture)
    assert picture.stat().st_size > 5000
    assert found["is_stable"]
    assert found["delay"] == pytest.approx(0.04)
    text = call("linearise", CART, "--closed-loop").output
    assert "additional delay: stable with 40 ms, unstable with 45 ms" in text
    assert "force alone: gain crosses 1 at" in text
    grown = call("linearise", CART, "--closed-loop", "--set", "autopilot.law.K=[[1,1,1,1]]", "--settle", "0.05")
    assert "NOT stable" in grown.output or "does not come to rest" in grown.output


@pytest.mark.thorough
def test_invalid_arguments_are_rejected_with_command_to_type(own):
    for words, wanted in (
        (("trim", "hovercraft/forwrd"), "trimtab trim hovercraft/forward"),
        (("trim", CART, "--at", "leen=1"), "--at lean=1"),
        (("trim", CART, "--at", "lean"), "--at force=free"),
        (("trim", CART, "--at", "lean=much"), "NUMBER"),
        (("trim", CART, "--at", "lean=1 kg"), "does not fit a quantity in rad"),
        (("trim", f"{own}:number"), "model_of_functions"),
        (("trim", own, "--set", "a.b=1"), "leave --set out"),
        (("linearise", CART, "--direct"), "add --closed-loop"),
        (("linearise", CART, "--closed-loop", "--at", "lean=0"), "leave --at out"),
        (("linearise", CART, "--closed-loop", "--round", "5", "--plot", "bode.png"), "leave --plot out"),
        (("linearise", CART, "--round", "5"), "add --closed-loop"),
        (("linearise", own, "--closed-loop"), "hovercraft/forward --closed-loop"),
        (("linearise", "hovercraft/forward", "--closed-loop"), "--direct"),
        (("linearise", CART, "--horizon", "0"), "above 0"),
    ):
        done = call(*words)
        assert done.exit_code == 2, (words, done.output)
        assert wanted in done.output, (words, done.output)


@pytest.mark.thorough
def test_boat_without_position_is_at_rest_only_at_zero_velocity():
    boat = str(Path(__file__).parents[2] / "examples" / "my_boat.py")
    assert "\nat rest\n" in call("trim", boat, "--at", "surge_velocity=0").output
    assert "in steady motion at surge_velocity 1 m/s" in call("trim", boat, "--at", "surge_velocity=1").output


@pytest.mark.thorough
def test_quadrotor_trim_defaults_to_hover():
    """Lift equals weight, 4.34 kg by 9.81 m/s^2, though the search starts from rotors at rest."""
    plant = load_plant("quadrotor/track")
    point = find_point(plant, ())
    hover = dict(zip((*plant.model.states, *plant.model.inputs), (*point.x, *point.u), strict=True))
    assert point.is_found
    assert [hover[f"velocity.{n}"] for n in ("forward", "starboard", "down")] == pytest.approx([0, 0, 0], abs=1e-9)
    assert 8e-5 * sum(hover[f"speed[{i}]"] ** 2 for i in range(4)) == pytest.approx(4.34 * 9.81)


@pytest.mark.thorough
def test_outputs_without_slope_at_rest_are_omitted_or_rejected():
    plant = load_plant("quadrotor/track")
    point = find_point(plant, ())
    model = smooth_model(plant, point)
    assert not {"speed", "climb", "angle_of_attack", "sideslip"} & set(model.outputs)
    with pytest.raises(InputError, match="stands still"):
        smooth_model(plant, point, ("climb",))


@pytest.mark.thorough
def test_quadrotor_trim_at_requested_forward_speed():
    """The pitch angle is drag over weight, at a drag of 0.3 N s/m."""
    plant = load_plant("quadrotor/track")
    point = find_point(plant, ("velocity.forward=1", "velocity.starboard=0", "velocity.down=0"))
    flown = dict(zip(plant.model.states, point.x, strict=True))
    assert flown["attitude.pitch"] == pytest.approx(-0.3 / (4.34 * 9.81), rel=1e-3)


@pytest.mark.thorough
def test_servo_state_and_servo_command_have_distinct_names():
    done = call("trim", "vessel/path", "--at", "surge_velocity=0.5", "--at", "u.rudder=free", "--at", "heading=0.5")
    assert done.exit_code == 0, done.output
    assert "u.rudder" in done.output
    assert "in steady motion: north changes by" in done.output
    assert "--at surge_velocity" not in done.output


@record
class GliderState:
    """A mass in the air, by speed, path angle, bank and course. Frames: W north-east-down. Source: this test."""

    V: Scalar = quantity("m/s", "Speed.", default=50.0)
    gamma: Scalar = quantity("rad", "Path, up.", default=-0.2, kind="angle")
    bank: Scalar = quantity("rad", "Starboard wing down.", default=0.4, kind="angle")
    course: Scalar = quantity("rad", "Clockwise from north.", default=0.3, kind="angle")
    height: Scalar = quantity("m", "Over ground.", default=100.0)


@record
class GliderControls:
    """Thrust and lift over mass, roll rate. Source: this test."""

    thrust: Scalar = quantity("m/s^2", "Thrust over mass.", default=0.0)
    lift: Scalar = quantity("m/s^2", "Lift over mass.", default=0.0)
    roll: Scalar = quantity("rad/s", "Roll rate.", default=0.0)


class Glider:
    """Drag is V^2/1000 of its mass."""

    def dynamics(self, t, x, u):
        return GliderState(
            V=u.thrust - x.V**2 / 1000 - 9.81 * jnp.sin(x.gamma),
            gamma=(u.lift * jnp.cos(x.bank) - 9.81 * jnp.cos(x.gamma)) / x.V,
            bank=u.roll,
            course=u.lift * jnp.sin(x.bank) / (x.V * jnp.cos(x.gamma)),
            height=x.V * jnp.sin(x.gamma),
        )

    def motion(self, t, x, u):
        still, ahead = jnp.zeros(3), jnp.array([1.0, 0.0, 0.0])
        angles = jnp.stack([x.bank, x.gamma, x.course])
        return Motion(t, jnp.stack([0.0, 0.0, -x.height]), angles, x.V * ahead, still, still, still)


@pytest.mark.thorough
def test_glider_trim_defaults_to_level_flight_at_initial_speed():
    """The initial banked dive is not a trim. At 50 m/s thrust over mass is 2.5 m/s^2, and lift equals weight."""
    plant = plant_of_vehicle("glider", Glider(), GliderState(), GliderControls(lift=9.81))
    point = find_point(plant, ()).require_trim()
    assert dict(point.taken) == {"V": 50.0, "course": 0.3, "gamma": 0.0, "bank": 0.0}
    assert point.undetermined_unknowns == ()
    np.testing.assert_allclose(point.x, [50.0, 0.0, 0.0, 0.3, 100.0], atol=1e-9)
    np.testing.assert_allclose(point.u, [2.5, 9.81, 0.0], atol=1e-9)
    turn = find_point(plant, ("course'=0.1", "V=40")).require_trim()
    assert turn.taken == {"course": 0.3, "gamma": 0.0}, "what is said is not taken, and a turn needs its bank"
    assert turn.x[2] == pytest.approx(np.arctan(40 * 0.1 / 9.81))
    assert find_point(plant, ("V=40", "bank=0", "course=0", "gamma=0")).taken == {}


def test_zero_initial_speed_is_not_assumed_in_trim():
    plant = plant_of_vehicle("glider", Glider(), replace(GliderState(), V=0.0), GliderControls(0.0, 9.81, 0.0))
    assert "V" not in find_point(plant, ("V=30",)).taken


@pytest.mark.thorough
def test_vehicle_on_prescribed_path_rests_at_zero_rate():
    """Velocity and attitude only record the motion, so the trim must set them to zero."""
    plant = load_plant("navigation/aerial")
    point = find_point(plant, ()).require_trim()
    x = dict(zip(plant.model.states, point.x, strict=True))
    assert point.taken == {}
    assert [x[n] for n in ("velocity.forward", "velocity.starboard", "velocity.down")] == [0.0] * 3
    assert x["attitude.roll"] == pytest.approx(0.0, abs=1e-9)
    assert x["rate"] == pytest.approx(0.0, abs=1e-9)
    for words in ("speed=30", "velocity.forward=free", "attitude.yaw'=0.1"):
        with pytest.raises(InputError, match="only records the motion") as said:
            find_point(plant, (words,))
        assert '"rate"' in str(said.value)


@pytest.mark.thorough
def test_swarm_has_a_trim_at_rest():
    point = find_point(load_plant("swarm/formation"), ()).require_trim()
    assert point.taken == {}
    assert not point.x[:15].any(), "all fifteen velocities"


@pytest.mark.thorough
def test_f16_is_trimmed_in_level_flight():
    """The point equals the trim of the gain file. The table lists the assumed values."""
    from trimtab.scenarios.f16._gains import level_flight
    from trimtab.vehicles.f16_flat_earth import F16FlatEarth
    from trimtab.vehicles.imperial import FOOT

    found = data("trim", "f16/gcas")
    wanted = level_flight(F16FlatEarth(), 540 * FOOT, 1000 * FOOT)
    np.testing.assert_allclose(list(found["states"].values()), wanted.x, atol=1e-8)
    np.testing.assert_allclose(list(found["inputs"].values()), wanted.u, atol=1e-8)
    assert found["taken"] == {"speed": 540 * FOOT, "yaw": 0.0, "beta": 0.0, "roll": 0.0}
    assert found["undetermined"] == []
    text = " ".join(call("trim", "f16/gcas", "--at", "speed=150").output.split())
    assert "assumed, because the vehicle has no equilibrium at rest: yaw 0 deg, beta 0 deg, roll 0 deg" in text
    assert "--at yaw=free" in text
    turn = data("trim", "f16/gcas", "--at", "yaw'=6 deg/s")
    assert set(turn["taken"]) == {"speed", "yaw", "beta"}
    coordinated = np.arctan(540 * FOOT * np.radians(6) / 9.80665)
    assert turn["states"]["roll"] == pytest.approx(coordinated, abs=0.05)


def test_multiple_pole_takes_one_row_of_the_table(capsys):
    A, I, none = np.diag([0.0, 0.0, 0.0, -2.0]), np.eye(4), np.zeros(4)
    print_modes(LinearModel(A, I, I, 0 * I, none, none, none, none, tuple("abcd"), tuple("efgh"), tuple("abcd")))
    rows = [
        line.split()[:3]
        for line in capsys.readouterr().out.splitlines()
        if any(c.isdigit() for c in line.split("pole")[0])
    ]
    assert [row[:3] for row in rows] == [["3", "×", "+0"], ["-2", "2", "1.0000"]], rows
