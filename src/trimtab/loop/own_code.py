"""Error messages for faults in a user's vehicle, law or scenario file: one sentence, with file and line."""

import dataclasses
import difflib
import inspect
import linecache
import re
import sysconfig
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import jax
import numpy as np

import trimtab
from trimtab.core.errors import InputError
from trimtab.core.record import declarations, is_record, leaves
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
    (r"\b(if|elif)\b", "`{0}` on " + TRACED, "use jnp.where(condition, a, b)  for  a if condition else b"),
    (r"\bwhile\b", "`while` on " + TRACED, "use  for _ in range(N)  with jnp.where inside, or jax.lax.fori_loop"),
    (r"\b(math|np|numpy)\.(\w+)", "`{0}.{1}` of " + TRACED, "use jnp.{1}, after  import jax.numpy as jnp"),
    (r"\.(item|tolist)\(", "`.{0}()` of " + TRACED, "leave .{0}() out: use the array itself"),
    (r"\b(float|int|bool)\(", "`{0}()` of " + TRACED, "leave {0}() out, or x.astype(…)"),
    (r"\b(range)\(", "`{0}()` of " + TRACED, "use a fixed number of steps, or jax.lax.fori_loop"),
    (r"\b(and|or|not)\b", "`{0}` on " + TRACED, "use &, | and ~, with brackets around each comparison"),
    (r"\b(min|max)\(", "`{0}()` of " + TRACED, "use jnp.{0}imum(a, b)"),
)
"""Patterns of faulty lines. Each entry: pattern, description of the problem, and code to write instead."""
IMPORTS = {"jnp": "import jax.numpy as jnp", "np": "import numpy as np", "jax": "import jax", "math": "import math"}
"""Names that a user's file often uses without an import, with the line that imports each."""


REMEDIES = {
    "__format__": "use jax.debug.print to print a number of a run",
    "item assignment": "write x = x.at[i].set(value)",
}
"""Text in the message of a TypeError -> the fix to suggest."""


class CodeFault(NamedTuple):
    """Fault in a user's code. place: file and line, e.g. "boat.py:31: ", or "" if the error is not in a user's file.

    problem: description of the fault.  fix: code to write, or "" if unknown.  choices: names that are valid there.
    """

    place: str
    problem: str
    fix: str = ""
    choices: tuple[str, ...] = ()


def describe_fault(error: BaseException) -> CodeFault:
    """Return place, problem and fix of an exception, for the author of the line that raised it."""
    if isinstance(error, SyntaxError):
        line = f"{Path(error.filename or '').name}:{error.lineno}:{error.offset}: "
        return CodeFault(line, f"{error.msg}: {(error.text or '').strip()!r}", "correct that line")
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
        return CodeFault(place, text, "correct the name of the module, or install its package")
    if isinstance(error, NameError) and error.name:
        return CodeFault(place, f"NameError: {text}", _find_name(error.name, frame))
    if isinstance(error, TypeError):
        return CodeFault(place, text, _describe_arguments(text, frame))
    is_plain = isinstance(error, AttributeError | ValueError | IndexError)
    return CodeFault(place, text if is_plain else f"{type(error).__name__}: {text}")


def place_of(code: Any) -> str:
    """Return "boat.py:31: " for a function or class in a user's file, else ""."""
    with suppress(TypeError, OSError):
        file = inspect.getsourcefile(code) or ""
        if not file.startswith(PACKAGE) and "site-packages" not in file:
            return f"{Path(file).name}:{max(inspect.getsourcelines(code)[1], 1)}: "
    return ""


def check_arguments(part: str, function: Callable[..., Any], wanted: str, *inputs: Any) -> None:
    """Raise InputError for a method that cannot be called with these inputs. wanted: its arguments, e.g. "t, x, u"."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # a function without a signature
        return
    try:
        signature.bind(*inputs)
    except TypeError:
        own = f"{function.__name__}({', '.join(signature.parameters)})"
        problem = f"{place_of(function)}{own} must take ({wanted})"
        raise InputError(part, problem, fix=f"def {function.__name__}(self, {wanted}): …") from None


def refuse_within(error: InputError) -> InputError:
    """Return the InputError with the file and line of the user's code that caused it."""
    frame, number = _frame_at_fault(error)
    is_placed = re.match(r"[\w.-]+\.py:\d+: ", error.problem) is not None
    if frame is None or is_placed or _is_own_package(frame.f_code.co_filename):
        return error
    part = f"{Path(frame.f_code.co_filename).name}:{number}: {error.part}"
    return InputError(part, error.problem, choices=error.choices, fix=error.fix)


def refuse_own_code(part: str, error: Exception) -> InputError:
    """Return the InputError for a user's code that doesn't run."""
    fault = describe_fault(error)
    fix = fault.fix or "correct that line"
    return InputError(part, f"{fault.place}{fault.problem}", choices=fault.choices, fix=fix)


def _describe_attribute(place: str, error: AttributeError) -> CodeFault:
    """Return the fault for an attribute that a record lacks.

    The fix names a field of this name deeper in the record, or else a field with a similar name.
    """
    fields = tuple(declarations(error.obj))
    below = [path for path, _, _ in leaves(error.obj) if path.endswith(f".{error.name}")]
    near = closest(error.name or "", fields, 1)
    fix = f"write {(below or near)[0]!r} instead" if below or near else ""
    return CodeFault(place, f"{type(error.obj).__name__!r} object has no attribute {error.name!r}", fix, fields)


def _find_name(name: str, frame: FrameType | None) -> str:
    """Return the fix for an unknown name: the line that imports the name, or the most similar known name."""
    if name in trimtab.HOMES:
        return f"write  from trimtab import {name}  at the top of the file"
    if name in IMPORTS:
        return f"write  {IMPORTS[name]}  at the top of the file"
    near = difflib.get_close_matches(name, [*frame.f_locals, *frame.f_globals], 1, cutoff=0.75) if frame else []
    return f"write {near[0]!r} instead, or define {name!r}" if near else f"define or import {name!r}"


def _describe_arguments(text: str, frame: FrameType | None) -> str:
    """Return the fix for a TypeError: wrong arguments of a record's constructor, or a case of REMEDIES; else ""."""
    match = re.match(r"(\w+)\.__init__\(\) (?:got an unexpected keyword argument|missing .* arguments?:) (.*)", text)
    if match is None:
        known = (words for part, words in REMEDIES.items() if part in text)
        return next(known, "")
    owner = {**frame.f_globals, **frame.f_locals}.get(match[1]) if frame else None
    names = re.findall(r"'(\w+)'", match[2])
    if "missing" in text or not dataclasses.is_dataclass(owner):
        return f"give {match[1]} " + ", ".join(f"{name}=…" for name in names)
    near = closest(names[0], declarations(owner), 1)
    return f"write {near[0]}=… instead" if near else f"leave {names[0]} out, or declare it in {match[1]}"


def _frame_at_fault(error: BaseException) -> tuple[FrameType | None, int]:
    """Return the innermost stack frame in a user's file, or else in the package, and its line number.

    Return (None, 0) if there is no such frame.
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
            return f"Python's `{name}` on {TRACED}", f"use jnp.{name}, after  import jax.numpy as jnp"
    fix = "write jnp.where(c, a, b) for  a if c else b,  jnp.sin for math.sin,  x.astype(…) for float(x)"
    return f"a Python `if`, loop or function is applied to {TRACED}", fix
