"""Error messages for faults in a user's own vehicle, law or scenario file: one sentence with file and line number."""

import dataclasses
import difflib
import inspect
import linecache
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

import trimtab
from trimtab.core.errors import InputError
from trimtab.core.record import declarations, is_record, leaves
from trimtab.core.signals import Frame
from trimtab.core.suggestions import closest

PACKAGE = str(Path(trimtab.__file__).parent)
STANDARD = sysconfig.get_path("stdlib")
TRACED = "a traced value (a number that is only known during the run)"
CONVERSIONS = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)
"""JAX errors raised when Python needs the value of a traced array."""
REPLACEMENTS = (
    (r"\b(if|elif)\b", "`{0}` depends on " + TRACED, "use jnp.where(condition, a, b)  for  a if condition else b"),
    (
        r"\bwhile\b",
        "`while` depends on " + TRACED,
        "use  for _ in range(N)  with jnp.where inside, or jax.lax.fori_loop",
    ),
    (r"\b(math|np|numpy)\.(\w+)", "`{0}.{1}` is applied to " + TRACED, "use jnp.{1}, after  import jax.numpy as jnp"),
    (r"\.(item|tolist)\(", "`.{0}()` is applied to " + TRACED, "leave .{0}() out: use the array itself"),
    (r"\b(float|int|bool)\(", "`{0}()` is applied to " + TRACED, "leave {0}() out, or x.astype(…)"),
    (r"\b(range)\(", "`{0}()` is applied to " + TRACED, "use a fixed number of steps, or jax.lax.fori_loop"),
    (r"\b(and|or|not)\b", "`{0}` is applied to " + TRACED, "use &, | and ~, with brackets around each comparison"),
    (r"\b(min|max)\(", "`{0}()` is applied to " + TRACED, "use jnp.{0}imum(a, b)"),
)
"""Typical faults in a source line: pattern of the line, description of the problem, and code to write instead."""
IMPORTS = {"jnp": "import jax.numpy as jnp", "np": "import numpy as np", "jax": "import jax", "math": "import math"}
"""Name that users often forget to import -> line that imports it."""
PARTS = {
    "vehicle": "MyVehicle()",
    "sensors": '{"NAME": MySensor()}',
    "actuators": "ActuatorBank(MyInput(), {})",
    "downlink": "Wire()",
    "uplink": "Wire()",
    "estimator": 'Passthrough("SENSOR")',
    "law": "MyLaw()",
    "allocation": "DirectAllocation()",
    "initial": "MyState()",
}
"""Name of a part that a World, an Autopilot or a Scenario must have -> example in a user's file."""


REMEDIES = {
    "__format__": "use jax.debug.print to print a number of a run",
    "item assignment": "write x = x.at[i].set(value)",
}
"""Part of the message of a TypeError -> fix to suggest to the user."""


class CodeFault(NamedTuple):
    """Fault in a user's code. place: file name and line number, e.g. "boat.py:31: ", or "" if the fault is elsewhere.

    problem: description of the fault.  fix: code to write, or "" if unknown.  choices: names that are valid in the
    faulty line.
    """

    place: str
    problem: str
    fix: str = ""
    choices: tuple[str, ...] = ()


def describe_fault(error: BaseException) -> CodeFault:
    """Return the description of an exception for the author of the source line that raised it."""
    if isinstance(error, SyntaxError):
        line = f"{Path(error.filename).name}:{error.lineno}:{error.offset}: " if error.filename and error.lineno else ""
        faulty = f": {error.text.strip()!r}" if error.text else ""
        return CodeFault(line, f"{error.msg}{faulty}", "correct that line" if line else "save the file as UTF-8 text")
    frame, number = _frame_at_fault(error)
    place = f"{Path(frame.f_code.co_filename).name}:{number}: " if frame else ""
    if isinstance(error, CONVERSIONS):
        return CodeFault(place, *_describe_conversion(frame, number))
    text = str(error).partition("\n")[0]
    if isinstance(error, dataclasses.FrozenInstanceError):
        return CodeFault(place, text, "return changing values as the state, from step()")
    if isinstance(error, AttributeError) and error.name and is_record(error.obj):
        return _describe_attribute(place, error)
    if isinstance(error, ImportError):
        if "relative import" in text:
            return CodeFault(place, text, "write  import NAME  or  from NAME import …  for a file in the same folder")
        if error.name and f"from {error.name!r}" in text:
            return CodeFault(place, text, "correct the imported name" + _similar_name(error))
        return CodeFault(place, text, "correct the name of the module, or install its package")
    if isinstance(error, KeyError):
        return _describe_key(place, error, frame)
    if isinstance(error, SystemExit):
        problem = "the file ends the program while trimtab reads it"
        return CodeFault(place, problem, 'move this call below  if __name__ == "__main__":')
    if isinstance(error, NameError) and error.name:
        return CodeFault(place, f"NameError: {text}", _find_name(error.name, frame))
    if isinstance(error, TypeError):
        return CodeFault(place, text, _describe_arguments(text, frame))
    if isinstance(error, AttributeError) and isinstance(error.obj, Tracer):
        problem = f"a number has no field {error.name!r}"
        return CodeFault(place, problem, "check which argument is a number, and which a record")
    is_plain = isinstance(error, AttributeError | ValueError | IndexError) and text
    return CodeFault(place, text if is_plain else f"{type(error).__name__}: {text}".removesuffix(": "))


def place_of(code: Any) -> str:
    """Return the file name and line number of a function or class in a user's file, e.g. "boat.py:31: ".

    Return "" for a function or class of an installed package.
    """
    with suppress(TypeError, OSError):
        file = inspect.getsourcefile(code) or ""
        if not file.startswith(PACKAGE) and "site-packages" not in file:
            return f"{Path(file).name}:{max(inspect.getsourcelines(code)[1], 1)}: "
    return ""


def check_arguments(part: str, function: Callable[..., Any], wanted: str, *inputs: Any) -> None:
    """Raise InputError for a method that cannot be called with the given inputs.

    wanted: names of the arguments that the method must have, e.g. "t, x, u".
    """
    try:
        signature = inspect.signature(function)
    except ValueError:  # a function without a signature
        return
    try:
        signature.bind(*inputs)
    except TypeError:
        own = f"{function.__name__}({', '.join(signature.parameters)})"
        problem = f"{place_of(function)}{own} must have the arguments ({wanted})"
        raise InputError(part, problem, fix=f"def {function.__name__}(self, {wanted}): …") from None


def refuse_within(error: InputError) -> InputError:
    """Return an InputError with file and line number of the user's code that raised it, if a user's code raised it."""
    frame, number = _frame_at_fault(error)
    is_placed = re.match(r"[\w.-]+\.py:\d+: ", error.problem) is not None
    if frame is None or is_placed or _is_own_package(frame.f_code.co_filename):
        return error
    part = f"{Path(frame.f_code.co_filename).name}:{number}: {error.part}"
    return InputError(part, error.problem, choices=error.choices, fix=error.fix)


def refuse_own_code(part: str, error: BaseException) -> InputError:
    """Return an InputError that describes an exception raised by a user's code. part: part that contains the code."""
    fault = describe_fault(error)
    fix = fault.fix or "correct that line"
    return InputError(part, f"{fault.place}{fault.problem}", choices=fault.choices, fix=fix)


def _describe_attribute(place: str, error: AttributeError) -> CodeFault:
    """Return the description of an access to an attribute that a record does not have.

    The suggested fix is a field with this name deeper in the record, or else a field with a similar name.
    """
    fields = tuple(declarations(error.obj))
    below = [path for path, _, _ in leaves(error.obj) if path.endswith(f".{error.name}")]
    near = closest(error.name or "", fields, 1)
    fix = f"write {(below or near)[0]!r} instead" if below or near else ""
    return CodeFault(place, f"{type(error.obj).__name__!r} object has no attribute {error.name!r}", fix, fields)


def _describe_key(place: str, error: KeyError, frame: FrameType | None) -> CodeFault:
    """Return the description of a missing key. For a function with a Frame, the choices are the frame's sensors."""
    key = error.args[0] if error.args else ""
    samples = next((v.samples for v in (frame.f_locals.values() if frame else ()) if isinstance(v, Frame)), {})
    if not samples or key in samples:
        return CodeFault(place, f"KeyError: {key!r}")
    near = closest(str(key), samples, 1) or list(samples)
    return CodeFault(place, f"the frame has no sensor {key!r}", f"write samples[{near[0]!r}]", tuple(samples))


def _similar_name(error: ImportError) -> str:
    """Return the end of the fix for a name that a module does not have: the most similar name in the module."""
    wanted = re.search(r"cannot import name '(\w+)'", str(error))
    module = sys.modules.get(error.name or "")
    near = closest(wanted[1], dir(module), 1) if wanted and module else []
    return f": write {near[0]!r}" if near else ""


def _find_name(name: str, frame: FrameType | None) -> str:
    """Return the fix for an undefined name: the line that imports the name, or the most similar defined name."""
    if name in trimtab.HOMES:
        return f"write  from trimtab import {name}  at the top of the file"
    if name in IMPORTS:
        return f"write  {IMPORTS[name]}  at the top of the file"
    near = difflib.get_close_matches(name, [*frame.f_locals, *frame.f_globals], 1, cutoff=0.75) if frame else []
    return f"write {near[0]!r} instead, or define {name!r}" if near else f"define or import {name!r}"


def _describe_arguments(text: str, frame: FrameType | None) -> str:
    """Return the fix for a TypeError with the message `text`, or "" if no fix is known."""
    match = re.match(r"(\w+)\.__init__\(\) (?:got an unexpected keyword argument|missing .* arguments?:) (.*)", text)
    if match is None:
        known = (words for part, words in REMEDIES.items() if part in text)
        return next(known, "")
    owner = {**frame.f_globals, **frame.f_locals}.get(match[1]) if frame else None
    names = re.findall(r"'(\w+)'", match[2])
    if "missing" in text or not dataclasses.is_dataclass(owner):
        examples = PARTS if match[1] in ("World", "Autopilot", "Scenario") else {}
        return f"call {match[1]} with " + ", ".join(f"{name}={examples.get(name, '…')}" for name in names)
    near = closest(names[0], declarations(owner), 1)
    return f"write {near[0]}=… instead" if near else f"leave {names[0]} out, or declare it in {match[1]}"


def _frame_at_fault(error: BaseException) -> tuple[FrameType | None, int]:
    """Return the innermost stack frame in a user's file, or else in this package, and the frame's line number.

    Return (None, 0) if no such frame exists.
    """
    frames = [(f, line) for f, line in traceback.walk_tb(error.__traceback__) if f.f_code.co_filename[0] != "<"]
    frames = [(f, n) for f, n in frames if not {"site-packages", "importlib"} & set(Path(f.f_code.co_filename).parts)]
    frames = [(f, n) for f, n in frames if not f.f_code.co_filename.startswith(STANDARD)]
    outside = [(f, n) for f, n in frames if not _is_own_package(f.f_code.co_filename)]
    names = (__file__, str(Path(__file__).with_name("structure.py")))
    own = [(f, n) for f, n in outside or frames if f.f_code.co_filename not in names]
    return own[-1] if own else (None, 0)


def _is_own_package(file: str) -> bool:
    return file.startswith(PACKAGE) and Path(file).parents[1].name != "scenarios"


def _describe_conversion(frame: FrameType | None, number: int) -> tuple[str, str]:
    code = re.sub(r"#.*", "", linecache.getline(frame.f_code.co_filename, number)) if frame else ""
    for pattern, problem, fix in REPLACEMENTS:
        match = re.search(pattern, code)
        if match:
            words = match.groups() or ("",)
            return problem.format(*words), fix.format(*words)
    for name in re.findall(r"\b(\w+)\(", code):
        called = {**frame.f_globals, **frame.f_locals}.get(name) if frame else None
        if isinstance(called, np.ufunc) or getattr(called, "__module__", "") in ("math", "numpy"):
            return f"Python's `{name}` is applied to {TRACED}", f"use jnp.{name}, after  import jax.numpy as jnp"
    fix = "write jnp.where(c, a, b) for  a if c else b,  jnp.sin for math.sin,  x.astype(…) for float(x)"
    return f"a Python `if`, loop or function is applied to {TRACED}", fix
