"""Any function of JAX that a file holds, with an example of its arguments: `trimtab export` writes it as C."""

import inspect
from collections.abc import Callable
from typing import Any

from trimtab.core.errors import InputError
from trimtab.scenarios.catalogue import load_function


def find_function(name: str) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
    """The function ``file.py:function`` and its example arguments, or None where it is a scenario.

    The example is a tuple `example` of the file, or a dict of such tuples by function; else the parameters' defaults. A
    function of a file without either is one that gives a scenario.

    Raises:
        InputError: an `example` that is neither a tuple nor a dict of tuples.
    """
    if ":" not in name:
        return None
    function = load_function(name)
    example = getattr(function, "__globals__", {}).get("example")
    if isinstance(example, dict):
        example = example.get(function.__name__)
    if example is None:
        parameters = inspect.signature(function).parameters.values()
        defaults = tuple(p.default for p in parameters)
        if not defaults or any(d is inspect.Parameter.empty or isinstance(d, str) for d in defaults):
            return None
        hint = inspect.signature(function).return_annotation
        return None if "Scenario" in str(hint) else (function, defaults)
    if not isinstance(example, tuple):
        problem = f"`example` is a {type(example).__name__}, not a tuple of arguments"
        raise InputError(f"export {name!r}", problem, fix="example = (0.1, 6.2)")
    return function, example
