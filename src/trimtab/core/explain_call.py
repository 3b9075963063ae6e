"""Errors for calls with wrong arguments: an InputError names the nearest valid argument, instead of a TypeError."""

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import ParamSpec, TypeVar

import trimtab
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest

P = ParamSpec("P")
R = TypeVar("R")

OTHER_NAMES = {
    "T": "duration",
    "dt": "log_period",
    "end": "duration",
    "file": "path",
    "filename": "path",
    "outdir": "folder",
    "out": "folder",
    "t_end": "duration",
    "tf": "duration",
    "time": "duration",
}
"""Names of arguments in other packages -> name of the same argument in this package."""


def explain_call(elsewhere: Mapping[str, str] | None = None) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that makes a call with wrong arguments raise InputError with a fix.

    elsewhere: name of an argument that only another function has -> call of that function, for the fix.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                signature.bind(*args, **kwargs)
            except TypeError as error:
                raise _refuse_call(function, signature, (args, kwargs), elsewhere or {}, str(error)) from None
            return function(*args, **kwargs)

        return call

    return decorate


def _refuse_call(
    function: Callable[..., object],
    signature: inspect.Signature,
    given: tuple[tuple[object, ...], Mapping[str, object]],
    elsewhere: Mapping[str, str],
    problem: str,
) -> InputError:
    args, kwargs = given
    part = f"{_public_name(function)}()"
    parameters = {n: p for n, p in signature.parameters.items() if n != "self"}
    unknown = next((n for n in kwargs if n not in parameters), "")
    if unknown:
        near = [n for n in (OTHER_NAMES.get(unknown), *closest(unknown, parameters, 1)) if n in parameters]
        call = elsewhere.get(unknown) or elsewhere.get("settings", "remove this argument")
        fix = call if unknown in elsewhere or not near else f"write {near[0]}=…"
        return InputError(part, f"unknown argument {unknown!r}", choices=parameters, fix=fix)
    keywords = [n for n, p in parameters.items() if p.kind is p.KEYWORD_ONLY]
    places = len(signature.parameters) - len(keywords)
    if len(args) > places and keywords:
        value = f"{args[places]!r:.40}"
        is_time = "duration" in keywords and isinstance(args[places], int | float)
        fix = f'write duration="{value} s"' if is_time else f"write NAME={value}, with one of the choices as NAME"
        return InputError(part, f"the argument {value} must be passed by name", choices=keywords, fix=fix)
    needed = [n for n, p in parameters.items() if p.default is p.empty]
    fix = f"{part[:-2]}({', '.join(f'{n}=…' for n in needed)})"
    return InputError(part, problem, choices=parameters, fix=fix)


def _public_name(function: Callable[..., object]) -> str:
    """Return the public name of a function; for an ``__init__``, the public name of its class."""
    own = function.__qualname__.removesuffix(".__init__")
    return next((name for name, home in trimtab.HOMES.items() if home.endswith(f":{own}")), own)
