"""Slips in a user's own law or vehicle: one line of a template is changed, and the file is flown.

At first ten of 31 slips gave a traceback, nine wrong advice, and nine flew on. The answer must name the user's file and
line, the cause in words, and what to write.
"""

import re
import tempfile
from functools import partial
from pathlib import Path
from typing import NamedTuple

import trimtab
from findings.finding import Finding, Outcome
from trimtab import InputError, simulate

TEMPLATES = Path(trimtab.__file__).parent / "templates"
LAW, VEHICLE = "my_law.py", "my_vehicle.py"
RETURN = "        return state, MyLawOutput(demand, off)"
RATE = "        return MyVehicleState(x.lean_rate, fall, turn)"
FIRST = "        return ()\n"
STEP = "def step(self, t: Scalar, state: tuple[()], estimate: Estimate)"


class Slip(NamedTuple):
    """A wrong line. template: file that is changed.  old, new: text of the change.  says, fix: parts of the answer."""

    template: str
    old: str
    new: str
    says: str
    fix: str


def before(line: str, end: str = RETURN) -> str:
    """Return the last line of a method with another one before it."""
    return f"        {line}\n{end}"


SLIPS = {
    "step returns nothing": Slip(
        LAW, RETURN, RETURN.replace("return state, ", ""), ":38: its step() must", "(state, o"
    ),
    "state is not returned": Slip(
        LAW, RETURN, RETURN.replace("state, ", ""), ":38: its step() must", "(state, output)"
    ),
    "three values are returned": Slip(LAW, RETURN, RETURN + ", 3", ":38: its step() must", "(state, output)"),
    "state and output are swapped": Slip(
        LAW,
        RETURN,
        "        return MyLawOutput(demand, off), state",
        ":38: the state that step() returns",
        "as from init()",
    ),
    "demand alone is returned": Slip(LAW, RETURN, "        return state, demand", "no field 'demand'", "demand=…"),
    "if on a number of the run": Slip(
        LAW, RETURN, before("off = 1.0 if off > 1 else off"), ":43: `if` depends on", "jnp.where"
    ),
    "numpy function": Slip(LAW, RETURN, before("import numpy; off = numpy.sin(off)"), ":43: `numpy.sin`", "jnp.sin"),
    "function of math by its name": Slip(
        LAW, RETURN, before("from math import sin; off = sin(off)"), ":43: Python's `sin` is applied to", "use jnp.sin"
    ),
    "number is taken out": Slip(
        LAW, RETURN, before("off.item()"), ":43: `.item()` is applied to a traced", "leave .item() out"
    ),
    "number is printed": Slip(LAW, RETURN, before("print(f'{off:.2f}')"), ":43: unsupported format", "jax.debug.print"),
    "misspelt field of the output": Slip(
        LAW, "MyLawOutput(demand, off)", "MyLawOutput(demand, of_course=off)", ":43: MyLawOutput", "write off_course=…"
    ),
    "missing field of the output": Slip(
        LAW, "MyLawOutput(demand, off)", "MyLawOutput(demand)", ":43: MyLawOutput.__init__() missing", "off_course=…"
    ),
    "demand is a number": Slip(
        LAW,
        "demand = VesselControls(",
        "demand = jnp.clip(rudder, 0, 1); VesselControls(",
        "a record such as",
        "demand=",
    ),
    "whole number as first state": Slip(
        LAW, FIRST, "        return 0\n", "the state that step() returns has a float", "write 0.0 instead of 0"
    ),
    "state changes its shape": Slip(
        LAW,
        FIRST,
        "        return jnp.zeros(2)\n",
        ":38: the state that step() returns has a number",
        "same structure as from init()",
    ),
    "init without key": Slip(
        LAW, "def init(self, key: Any)", "def init(self)", ":34: init() must have the arguments (key)", "self, key"
    ),
    "init is missing": Slip(LAW, "def init(", "def start(", ":22: MyLaw has no init()", "def init(self, key)"),
    "step without time": Slip(
        LAW, STEP, "def step(self, state, estimate)", ":38: step(state, estimate)", "self, t, sta"
    ),
    "reads is missing": Slip(LAW, "    reads: ClassVar", "    red: ClassVar", ":22: MyLaw has no 'reads'", "reads = ("),
    "reads is a text": Slip(LAW, '("yaw_rate", "heading")', '("heading")', ":22: `reads` must be", '("heading",)'),
    "unknown signal": Slip(LAW, "estimate.state.yaw_rate", "estimate.state.yawrate", ":41: 'PlanarPose", "'yaw_rate'"),
    "signal of the estimate itself": Slip(
        LAW, "estimate.state.heading", "estimate.heading", ":40: 'Estimate' object has no", "'state.heading'"
    ),
    "misspelt gain": Slip(LAW, "self.k_heading *", "self.k_heding *", ":41: 'MyLaw' object has no", "'k_heading'"),
    "missing import": Slip(LAW, "import jax.numpy as jnp\n", "\n", "NameError: name 'jnp'", "import jax.numpy as jnp"),
    "syntax error": Slip(LAW, "-> tuple[()]:", "-> tuple[()]", ":34:42: expected ':'", "correct that line"),
    "exception in step": Slip(LAW, RETURN, before("raise RuntimeError('no')"), ":43: RuntimeError: no", "correct that"),
    "division by zero": Slip(LAW, RETURN, before("1 / 0"), ":43: ZeroDivisionError", "correct that line"),
    "gain is changed in step": Slip(LAW, RETURN, before("self.k_rate = 3.0"), ":43: cannot assign", "as the state"),
    "element of an array is set": Slip(
        LAW, RETURN, before("v = jnp.zeros(3); v[0] = off"), ":43: JAX arrays are immutable", "x.at[i].set(value)"
    ),
    "field without annotation": Slip(
        LAW, "most: Scalar = q", "most = q", ":22: record MyLaw", "name: float = quantity"
    ),
    "class without @record": Slip(
        LAW, "@record\nclass MyLaw:", "class MyLaw:", ":22: MyLaw is not a record", "@record"
    ),
    "class instead of a law": Slip(LAW, "law=MyLaw())", "law=MyLaw)", "MyLaw is a class", "MyLaw(), with brackets"),
    "misspelt part": Slip(
        LAW, "law=MyLaw())", "lw=MyLaw())", ":49: Autopilot.lw: the record has no", "replace(autopilot, law"
    ),
    "misspelt base": Slip(LAW, '"vessel/path"', '"vessel/pth"', ":48: scenario 'vessel/pth'", '"vessel/path"'),
    "dynamics returns nothing": Slip(
        VEHICLE, RATE, "        turn", ":41: its return value is noth", "MyVehicleState(…)"
    ),
    "dynamics returns an array": Slip(
        VEHICLE,
        RATE,
        "        return jnp.array([x.lean_rate, fall, turn])",
        ":41: its return value is an array of shape (3,)",
        "MyVehicle",
    ),
    "dynamics of another shape": Slip(
        VEHICLE, "State(x.lean_rate, f", "State(jnp.zeros(2), f", ":41: its return value has lean", "MyVehicleState(…)"
    ),
    "dynamics without time": Slip(
        VEHICLE,
        "self, t: Scalar, x: MyVehicleState, u: MyVehicleInput):",
        "self, x, u):",
        ":41: dynamics(x, u)",
        "t, x, u",
    ),
    "dynamics is missing": Slip(
        VEHICLE, "def dynamics", "def dynamic", ":33: MyVehicle has no dynamics", "def dynamics("
    ),
    "motion is missing": Slip(VEHICLE, "def motion", "def moton", ":33: MyVehicle has no motion", "def motion("),
    "motion returns nothing": Slip(
        VEHICLE, "return replace(no", "replace(no", ":47: motion() returns", "replace(no_motion("
    ),
    "misspelt input": Slip(
        VEHICLE, "u.steer", "u.stear", ":43: 'MyVehicleInput' object has no", "write 'steer' instead"
    ),
    "while on a number of the run": Slip(
        VEHICLE, RATE, before("while turn > 3: turn = turn - 3", RATE), ":45: `while` depends on a traced", "jnp.where"
    ),
    "sensor that the world lacks": Slip(
        VEHICLE, 'Passthrough("state")', 'Passthrough("stat")', "'stat'", 'sensors={"stat'
    ),
}
STATE_SLIPS = {"whole number as first state": "state + 0.5", "state changes its shape": "jnp.zeros(3)"}
"""Slips whose step returns another state."""


def fly(name: str, folder: Path) -> str:
    """Fly the file with this slip; return the answer, or "" if it flew."""
    slip = SLIPS[name]
    text = (TEMPLATES / slip.template).read_text("utf-8")
    if name in STATE_SLIPS:
        text = text.replace(RETURN, RETURN.replace("state,", f"{STATE_SLIPS[name]},"))
    assert slip.old in text, name
    file = folder / f"own_{re.sub(r'[^a-z0-9]', '_', name.lower())}.py"
    file.write_text(text.replace(slip.old, slip.new))
    try:
        simulate(f"{file}:scenario", duration="100 ms")
    except InputError as error:
        return str(error)
    return ""


def answer(name: str) -> Outcome:
    """Return the answer to a slip, and True if it has the expected words and no line of the package."""
    with tempfile.TemporaryDirectory() as folder:
        said = fly(name, Path(folder))
    slip = SLIPS[name]
    problem, _, fix = said.partition("\nFix: ")
    return Outcome(said or "flew", slip.says in problem and slip.fix in fix and "jax/" not in said)


def _finding(name: str) -> Finding:
    slip = SLIPS[name]
    case = f"{slip.template}: {slip.new.strip()}"
    return Finding(name, case, "a traceback, wrong advice, or a flight", partial(answer, name))


FINDINGS = [_finding(name) for name in SLIPS]
