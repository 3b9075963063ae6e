"""Mistakes in a user's own law or vehicle are reported with file, line and a fix."""

import math
import re
import sys
from math import sin

import jax
import jax.numpy as jnp
import numpy
import numpy as np
import pytest
from loop.falling import Ball, HeightState

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Estimator
from trimtab.core.record import part, quantity, record, replace, to_arrays
from trimtab.core.signals import Estimate, Frame, Motion, Sample, new_sample, no_motion
from trimtab.estimators.linear_model import FilteredEstimate
from trimtab.loop.own_code import describe_fault
from trimtab.loop.structure import (
    check_members,
    check_numbers,
    check_output,
    check_record,
    check_state,
    check_vehicle,
    first_state,
    refuse_missing_numbers,
    zeros_of,
    zeros_of_step,
)


@record
class Point:
    """A point. Source: none."""

    north: float = quantity("m", "North.", default=0.0)


def estimate(**changes):
    plain = {"t": np.int64(0), "age": 0.0, "fresh": True, "valid": True, "state": Point(1.0)}
    return Estimate(**plain | changes)


def branch(x):
    if x.north > 1:
        return 1.0
    return x.north


SLIPS = {
    "if": (branch, "`if` depends on a traced value", "jnp.where"),
    "and": (lambda x: (x.north > 1) and (x.north < 2), "`and` is applied to a traced value", "&"),
    "math": (lambda x: math.sin(x.north), "`math.sin` is applied to a traced value", "jnp.sin"),
    "numpy": (lambda x: np.cos(x.north), "`np.cos` is applied to a traced value", "jnp.cos"),
    "float": (lambda x: float(x.north), "`float()` is applied to a traced value", "leave float() out"),
    "range": (
        lambda x: [0 for _ in range(jnp.asarray(x.north, int))],
        "`range()` is applied to a traced value",
        "fixed number",
    ),
    "misspelt": (lambda x: x.nort, "'Point' object has no attribute 'nort'", "write 'north' instead"),
    "shape": (lambda x: jnp.stack([x.north, jnp.zeros(2)]), "Cannot stack arrays", "correct that line"),
    "another name": (lambda x: nothing, "NameError: name 'nothing' is not defined", "define or import"),  # noqa: F821
}


@pytest.mark.parametrize("slip", SLIPS)
def test_mistake_is_reported_with_its_line_and_fix(slip):
    function, problem, fix = SLIPS[slip]
    with pytest.raises(InputError) as refused:
        zeros_of("law", "the state", function, Point(1.0))
    line = function.__code__.co_firstlineno + (function is branch)
    assert f"test_own_code.py:{line}: {problem}" in refused.value.problem
    assert fix in refused.value.fix


def test_rejects_a_step_that_returns_no_pair():
    with pytest.raises(
        InputError, match=r"test_own_code.py:\d+: its step\(\) must return \(state, output\), got a Point as declared"
    ) as refused:
        zeros_of_step("law", "the state", lambda x: x, Point(1.0))
    assert "(state, output)" in refused.value.fix


class Wanted:
    """An interface."""

    reads: tuple[str, ...]

    def step(self, t, state): ...


def test_missing_member_error_says_what_to_write():
    with pytest.raises(InputError, match=r"Point has no step\(\)[\s\S]*def step\(self, t, state\): …  in Point"):
        check_members("law", Point(1.0), Wanted)
    with pytest.raises(InputError, match=r"Point has no 'reads'"):
        check_members("law", Point(1.0), Wanted, ("step",))
    check_members("law", Point(1.0), Wanted, ("step", "reads"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def scenario(:\n", "own.py:1:14: invalid syntax"),
        ("\nimport nothing_of_that_name\n", "own.py:2: No module named 'nothing_of_that_name'"),
        ("def scenario():\n    return nothing\n", "own.py:2: NameError: name 'nothing' is not defined"),
        ("def scenario():\n    return 1 / 0\n", "own.py:2: ZeroDivisionError"),
        ("def scenario():\n    raise NotImplementedError\n", "own.py:2: NotImplementedError"),
        ("def scenario():\n    exit()\n", "own.py:2: the file ends the program"),
        ("import sys\nsys.exit(3)\n", "own.py:2: the file ends the program"),
        ("from .other import x\n", "own.py:1: attempted relative import"),
        ("from trimtab import Autopilt\n", "own.py:1: cannot import name 'Autopilt'"),
        ("a = 1\n\0", "source code string cannot contain null bytes"),
        ("def scenario(mass: 'Nothing'): ...\n", "own.py:1: an annotation of the function is invalid"),
    ],
)
def test_broken_scenario_file_is_rejected_with_its_line(tmp_path, text, said):
    from trimtab.scenarios.build import build

    (tmp_path / "own.py").write_text(text)
    with pytest.raises(InputError) as refused:
        build(f"{tmp_path / 'own.py'}:scenario")
    assert said in refused.value.problem
    assert refused.value.fix


OTHERS = {
    "numpy by its name": (lambda x: numpy.sin(x.north), "`numpy.sin` is applied to a traced value", "use jnp.sin"),
    "a function by its name": (lambda x: sin(x.north), "Python's `sin` is applied to a traced value", "use jnp.sin"),
    "item": (lambda x: x.north.item(), "`.item()` is applied to a traced value", "leave .item() out"),
    "unknown argument": (lambda x: Point(nort=x.north), "unexpected keyword argument", "write north=… instead"),
    "change": (lambda x: setattr(x, "north", 1.0), "records are immutable", "return changing values as the state"),
    "format": (lambda x: f"{x.north:.2f}", "unsupported format string", "jax.debug.print"),
    "import": (lambda x: seconds(x.north), "name 'seconds' is not defined", "from trimtab import seconds"),  # noqa: F821
    "below": (lambda x: x.north, "'Pair' object has no attribute 'north'", "write 'first.north' instead"),
}


@record
class Pair:
    """Two points. Source: none."""

    first: Point = part("First point.")
    second: float = quantity("m", "Distance.", default=0.0)


@pytest.mark.parametrize("slip", OTHERS)
def test_wrong_call_error_says_what_to_write(slip):
    function, problem, fix = OTHERS[slip]
    given = Pair(Point(1.0)) if slip == "below" else Point(1.0)
    with pytest.raises(InputError) as refused:
        zeros_of("law", "the state", function, given)
    assert f"test_own_code.py:{function.__code__.co_firstlineno}: " in refused.value.problem
    assert problem in refused.value.problem
    assert fix in refused.value.fix


class Rounded:
    """Methods with wrong arguments."""

    def step(self, state): ...

    def init(self): ...


def test_rejects_methods_with_wrong_arguments():
    with pytest.raises(
        InputError, match=r"test_own_code.py:\d+: step\(state\) must have the arguments \(t, state, input\)"
    ) as refused:
        zeros_of_step("law", "the state", Rounded().step, 0, (), Point(1.0))
    assert refused.value.fix == "def step(self, t, state, input): …"
    with pytest.raises(InputError, match=r"init\(\) must have the arguments \(key\)"):
        first_state("law", Rounded().init, None)
    with pytest.raises(InputError, match="ZeroDivisionError: division by zero"):
        first_state("law", lambda key: 1 / 0, None)


def test_rejects_a_float_where_the_initial_state_is_integer():
    def step():
        return None

    check_state("law", step, 1.5, 0.0)
    check_state("law", step, 1, 0)
    check_state("law", step, True, False)
    with pytest.raises(
        InputError, match="has a float in place of an integer in the state that init\\(\\) returns"
    ) as refused:
        check_state("law", step, 1.5, 0)
    assert refused.value.fix == "write 0.0 instead of 0 in init()"


def test_rejects_a_class_and_a_non_record():
    check_record("law", Point())
    with pytest.raises(InputError, match="Point is a class, not a part"):
        check_record("law", Point)
    with pytest.raises(InputError, match=r"test_own_code.py:\d+: Rounded is not a record"):
        check_record("law", Rounded())
    for value in (None, 0.01, np.zeros(2)):
        with pytest.raises(InputError, match="law: must be a record, got "):
            check_record("law", value)


def test_missing_allocation_suggests_direct_allocation():
    with pytest.raises(InputError, match="must be a record, got None") as refused:
        check_record("autopilot.allocation", None)
    assert refused.value.fix == "write DirectAllocation()"
    fault = describe_fault(TypeError("Autopilot.__init__() missing 1 required positional argument: 'allocation'"))
    assert fault.fix == "call Autopilot with allocation=DirectAllocation()"
    fault = describe_fault(TypeError("Boat.__init__() missing 1 required positional argument: 'law'"))
    assert fault.fix == "call Boat with law=…"


@record
class CountedState:
    """Height, and an integer. Source: this test."""

    height: float = quantity("m", "Height.", default=1.0)
    mode: int = quantity("1", "Mode.", kind="count", default=0)


class Counted:
    """Vehicle whose state contains an integer. slope: derivative of the integer."""

    slope: float = 0

    def dynamics(self, t, x, u):
        return CountedState(-x.height, self.slope)

    def motion(self, t, x, u):
        return no_motion()


def test_integer_of_the_state_with_real_derivative_is_refused():
    state = to_arrays(CountedState())
    check_vehicle(Counted(), state, None)
    with pytest.raises(
        InputError, match=r'CountedState.mode has kind="count", but its derivative is a real'
    ) as refused:
        check_vehicle(type("Growing", (Counted,), {"slope": 0.5})(), state, None)
    assert "return the integer 0" in refused.value.fix


MESSAGES = {
    "no sample": (Sample, Point(1.0), "its output is a Point as declared", "new_sample(t, VALUE)"),
    "flag": (Estimate, estimate(valid=1.0), "valid of the Estimate must be True or False", "valid=True"),
    "age": (Estimate, estimate(age=3), "age of the Estimate must be a float in seconds", "to_seconds"),
    "shape": (Estimate, estimate(age=np.zeros(2)), "age of the Estimate has shape (2,)", "shape ()"),
}


@pytest.mark.parametrize("slip", MESSAGES)
def test_rejects_an_output_that_is_not_a_valid_message(slip):
    kind, output, problem, fix = MESSAGES[slip]
    with pytest.raises(InputError) as refused:
        check_output("part", Rounded.step, output, kind)
    assert re.match(r"test_own_code.py:\d+: ", refused.value.problem)
    assert problem in refused.value.problem
    assert fix in refused.value.fix


def test_accepts_a_message_with_further_fields():
    """The estimate of a filter contains a covariance of any size."""
    other = FilteredEstimate(**vars(estimate()), P=np.zeros(16), nis=0.0, used=np.int64(0))
    check_output("part", Rounded.step, other, Estimate)
    with pytest.raises(InputError, match="valid of the FilteredEstimate must be True or False"):
        check_output("part", Rounded.step, replace(other, valid=1.0), Estimate)


def test_accepts_a_valid_message():
    check_output("part", Rounded.step, estimate(), Estimate)
    check_output("part", Rounded.step, new_sample(np.int64(0), Point(1.0)), Sample)


def test_rejects_motion_of_wrong_shape():
    check_numbers("motion", Rounded.step, no_motion(), Motion)
    with pytest.raises(InputError, match=r"p_WB of the Motion has shape \(2,\), but the shape must be \(3,\)"):
        check_numbers("motion", Rounded.step, replace(no_motion(), p_WB=np.zeros(2)), Motion)


@pytest.mark.parametrize(
    ("name", "method", "said"),
    [
        ("events", lambda self, t, x: (), "events() returns nothing"),
        ("events", lambda self, t, x: x.height, "no attribute 'height'"),
        ("events", lambda self, x: x.z, "must have the arguments (t, x)"),
        ("jump", lambda self, t, x, crossed: HeightState(0.0, crossed), "has w of shape (1,)"),
        ("jump", lambda self, t, x, crossed: x.w, "is a number, but must be a HeightState"),
        ("after_step", lambda self, t, x: 1.0 if x.z > 0 else x, "`if` depends on a traced value"),
    ],
)
def test_rejects_faulty_events_jump_and_after_step(name, method, said):
    method.__name__ = name
    own = record(type("Own", (Ball,), {name: method, "__doc__": "A ball. Source: this test.", "__annotations__": {}}))
    with pytest.raises(InputError, match=f"test_own_code.py:.*{re.escape(said)}"):
        check_vehicle(own(), HeightState(), None)


@record
class TwoEvents(Ball):
    """A ball with two events in an array. Source: this test."""

    def events(self, t, x):
        return jnp.stack([x.z + 1.0, x.z])

    def jump(self, t, x, crossed):
        return HeightState(0.0, jnp.where(crossed[1], -x.w, x.w) + 0 * jnp.dot(crossed, np.ones(2)))


def test_jump_is_checked_with_one_flag_for_each_event():
    check_vehicle(TwoEvents(), HeightState(), None)


def test_missing_sensor_in_frame_is_reported_with_the_sensors():
    frame = Frame(t=0, samples={"odometry": 1.0, "fix": 2.0})
    with pytest.raises(InputError, match=r"test_own_code.py:\d+: the frame has no sensor 'fx'") as refused:
        zeros_of("autopilot.estimator", "world.sensors", lambda frame: frame.samples["fx"], frame)
    assert set(refused.value.choices) == {"odometry", "fix"}
    assert refused.value.fix == "write samples['fix']"
    with pytest.raises(InputError) as refused:
        zeros_of("autopilot.estimator", "world.sensors", lambda frame: frame.samples["odomtry"], frame)
    assert refused.value.fix == "write samples['odometry']"
    with pytest.raises(InputError) as refused:
        zeros_of("autopilot.estimator", "world.sensors", lambda frame: frame.samples["zzz"], frame)
    assert refused.value.fix == "write samples['fix']"
    with pytest.raises(InputError, match="KeyError: 'fix'"):  # of another dictionary
        zeros_of("autopilot.estimator", "world.sensors", lambda frame: {}["fix"], frame)
    with pytest.raises(InputError, match="KeyError: 'fx'"):
        zeros_of("autopilot.law", "the estimate", lambda x: {}["fx"], Point(1.0))


def test_rejects_a_law_output_with_none():
    refuse_missing_numbers("law", Rounded.step, Point(1.0))
    with pytest.raises(InputError, match="north of the Point is None, but must be a number"):
        refuse_missing_numbers("law", Rounded.step, Point(None))


def test_error_of_a_record_names_the_faulty_line():
    def step(x):
        return replace(x, nort=1.0)

    with pytest.raises(InputError, match=r"test_own_code.py:\d+: Point.nort: the record has no such field"):
        zeros_of("law", "the state", step, Point(1.0))


def test_field_of_a_number_is_reported_in_words():
    with pytest.raises(InputError, match=r"provides Point: test_own_code.py:\d+: a number has no field 'east'"):
        zeros_of("law", "the state", lambda x: x.north.east, Point(1.0))


def test_missing_tuple_of_names_is_shown_as_a_tuple():
    with pytest.raises(InputError, match=r'listens = \("NAME", …\)  in Point'):
        check_members("estimator", Point(1.0), Estimator, ("init", "step"))


def test_error_names_the_line_in_the_scenario_file(tmp_path):
    from trimtab.scenarios.build import build

    text = "from trimtab import build\n\ndef scenario():\n    return build('hovercraft/spn')\n"
    (tmp_path / "spun.py").write_text(text)
    with pytest.raises(InputError, match=r"^spun.py:4: scenario 'hovercraft/spn'") as refused:
        build(f"{tmp_path / 'spun.py'}:scenario")
    assert refused.value.fix.startswith('"hovercraft/spin"')
    assert "trimtab " not in refused.value.fix


def test_error_without_user_code_has_no_line():
    assert describe_fault(ValueError("odd")).place == ""
    assert jax.errors.ConcretizationTypeError in describe_fault.__globals__["CONVERSIONS"]


def test_module_form_reports_the_faulty_line(tmp_path, monkeypatch):
    from trimtab.scenarios.build import build

    (tmp_path / "own_module_with_fault.py").write_text("x = 1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"own_module_with_fault.py:1: ZeroDivisionError"):
        build("own_module_with_fault:scenario")


def test_own_file_imports_a_file_in_its_folder(tmp_path, monkeypatch):
    from trimtab.scenarios.catalogue import load_function

    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "own_numbers_beside.py").write_text("MASS = 3\n")
    (tmp_path / "own.py").write_text("from own_numbers_beside import MASS\n\ndef scenario():\n    return MASS\n")
    assert load_function(f"{tmp_path / 'own.py'}:scenario")() == 3


def test_argument_of_a_scenario_function_is_a_number(tmp_path):
    from trimtab.scenarios.catalogue import load_scenario

    (tmp_path / "own.py").write_text(
        "def scenario(mass: float = 1.0, count=2, fast=False, name='a') -> 'Nothing':\n"
        "    return 2 * mass, 2 * count, fast, name\n"
    )
    name = f"{tmp_path / 'own.py'}:scenario"
    given = {"mass": "0.3", "count": "4", "fast": "true", "name": "b"}
    assert load_scenario(name, given)[0] == (0.6, 8, True, "b")
    for wrong, wanted in (("mass", "a number without unit"), ("count", "an integer"), ("fast", "true or false")):
        with pytest.raises(InputError, match=f"must be {wanted}, got 'heavy'"):
            load_scenario(name, {wrong: "heavy"})
