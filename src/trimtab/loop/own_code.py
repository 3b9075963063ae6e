"""Errors in a user's own vehicle, law or scenario file: one sentence, with file and line."""

import linecache
import re
import traceback
from pathlib import Path
from typing import Any, NamedTuple

import jax

import trimtab
from trimtab.core.errors import InputError
from trimtab.core.record import declarations, is_record
from trimtab.core.suggestions import closest

PACKAGE = str(Path(trimtab.__file__).parent)
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
    (r"\bmath\.(\w+)", "`math.{0}` of " + TRACED, "use jnp.{0}, after  import jax.numpy as jnp"),
    (r"\bnp\.(\w+)", "`np.{0}` of " + TRACED, "use jnp.{0}, after  import jax.numpy as jnp"),
    (r"\b(float|int|bool)\(", "`{0}()` of " + TRACED, "leave {0}() out, or x.astype(…)"),
    (r"\b(range)\(", "`{0}()` of " + TRACED, "use a fixed number of steps, or jax.lax.fori_loop"),
    (r"\b(and|or|not)\b", "`{0}` on " + TRACED, "use &, | and ~, with brackets around each comparison"),
    (r"\b(min|max)\(", "`{0}()` of " + TRACED, "use jnp.{0}imum(a, b)"),
)
"""Pattern of the faulty line, description of the problem, and replacement to write."""


class CodeFault(NamedTuple):
    """place: "boat.py:31: ", or "" if the error is not in a user's file.  fix: "" if none is known."""

    place: str
    problem: str
    fix: str = ""
    choices: tuple[str, ...] = ()


def describe_fault(error: BaseException) -> CodeFault:
    """Return place, problem and fix of an exception, for the author of the line that raised it."""
    if isinstance(error, SyntaxError):
        line = f"{Path(error.filename or '').name}:{error.lineno}:{error.offset}: "
        return CodeFault(line, f"{error.msg}: {(error.text or '').strip()!r}", "correct that line")
    frame = _frame_at_fault(error)
    place = f"{Path(frame.filename).name}:{frame.lineno}: " if frame else ""
    if isinstance(error, CONVERSIONS):
        problem, fix = _describe_conversion(linecache.getline(frame.filename, frame.lineno or 0) if frame else "")
        return CodeFault(place, problem, fix)
    if isinstance(error, AttributeError) and error.name and is_record(error.obj):
        fields = tuple(declarations(error.obj))
        near = closest(error.name, fields, 1)
        fix = f"write {near[0]!r} instead" if near else ""
        return CodeFault(place, f"{type(error.obj).__name__!r} object has no attribute {error.name!r}", fix, fields)
    if isinstance(error, ImportError):
        return CodeFault(place, str(error), "correct the name, or install its package")
    kind = (
        "" if isinstance(error, AttributeError | TypeError | ValueError | IndexError) else f"{type(error).__name__}: "
    )
    return CodeFault(place, f"{kind}{str(error).partition(chr(10))[0]}")


def refuse_own_code(part: str, error: Exception) -> InputError:
    """Return the InputError for a user's code that doesn't run."""
    fault = describe_fault(error)
    fix = fault.fix or "correct that line"
    return InputError(part, f"{fault.place}{fault.problem}", choices=fault.choices, fix=fix)


def _frame_at_fault(error: BaseException) -> Any:
    """Return the newest stack frame in a user's file, or in the package if there is none."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]
    frames = [f for f in frames if "site-packages" not in f.filename and "importlib" not in f.filename]
    outside = [f for f in frames if not f.filename.startswith(PACKAGE) or "/scenarios/" in f.filename]
    own = [f for f in (outside or frames) if f.filename != __file__ and not f.filename.endswith("loop/structure.py")]
    return own[-1] if own else None


def _describe_conversion(line: str) -> tuple[str, str]:
    code = re.sub(r"#.*", "", line)
    for pattern, problem, fix in REPLACEMENTS:
        match = re.search(pattern, code)
        if match:
            word = match[1] if match.groups() else ""
            return problem.format(word), fix.format(word)
    fix = "write jnp.where(condition, a, b) for a if b is one, jnp.sin for math.sin, x.astype(…) for float(x)"
    return f"a Python branch or function on {TRACED}", fix
