"""A call with wrong arguments is answered with the nearest right name."""

import pytest

from trimtab import Campaign, build, metrics, simulate, write_log
from trimtab.core.errors import InputError
from trimtab.core.explain_call import explain_call


@explain_call({"mass": "load(build(mass=…))"})
def load(path: str, *, duration: str = "1 s", rate: float = 1.0) -> str:
    """Return both."""
    return f"{path} {duration} {rate}"


WRONG = {
    "an unknown name": (lambda: load("a", durration="2 s"), "unknown argument 'durration'", "write duration=…"),
    "another package's name": (lambda: load(filename="a"), "unknown argument 'filename'", "write path=…"),
    "another function's argument": (lambda: load("a", mass=3), "unknown argument 'mass'", "load(build(mass=…))"),
    "a time without its name": (
        lambda: load("a", 10),
        "the argument 10 must be passed by name",
        'write duration="10 s"',
    ),
    "a text without its name": (
        lambda: load("a", "b"),
        "the argument 'b' must be passed by name",
        "with one of the choices as NAME",
    ),
    "a missing argument": (lambda: load(), "missing a required argument: 'path'", "load(path=…)"),
    "settings of a simulation": (
        lambda: simulate("hovercraft/spin", settings={"world.vehicle.mass": 3}),
        "unknown argument 'settings'",
        'simulate(build("SCENARIO", settings=…))',
    ),
    "a parameter of a scenario": (
        lambda: build("hovercraft/spin", mass=3),
        "unknown argument 'mass'",
        'build("SCENARIO", settings={"PATH": VALUE})',
    ),
    "an alias of a module's name": (lambda: write_log(), "missing a required argument: 'log'", "write_log(log=…"),
    "a class": (lambda: Campaign("hovercraft/spin", run=10), "unknown argument 'run'", "write runs=…"),
    "metrics of a log alone": (lambda: metrics(None), "missing a required argument: 'targets'", "metrics(log=…"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_raise_an_error_with_a_fix(case):
    call, problem, fix = WRONG[case]
    with pytest.raises(InputError) as refused:
        call()
    assert problem in refused.value.problem
    assert fix in refused.value.fix


def test_valid_call_passes_and_keeps_name_and_docstring():
    assert load("a", rate=2.0) == "a 1 s 2.0"
    assert load.__name__ == "load"
    assert load.__doc__ == "Return both."


def test_errors_inside_the_function_pass_unchanged():
    @explain_call()
    def fail(x):
        return x + "a"

    with pytest.raises(TypeError, match="unsupported operand"):
        fail(1)
