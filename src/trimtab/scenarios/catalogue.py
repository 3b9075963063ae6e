"""The catalogue: every file below this folder is a scenario, named after its path.

``hovercraft/zero-velocity`` is ``hovercraft/zero_velocity.py``. A scenario outside the package is named by its module
or file and the function: ``my_boat:scenario``, ``my_boat.py:scenario``.
"""

import ast
import importlib
import importlib.util
import inspect
import sys
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from trimtab.core.errors import InputError, closest

FOLDER = Path(__file__).parent


def scenario_names() -> dict[str, str]:
    """Name of each scenario -> first line of its docstring; read from the files, nothing is imported."""
    names = {}
    for file in sorted(FOLDER.glob("*/*.py")):
        if not file.name.startswith("_"):
            doc = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
            names[f"{file.parent.name}/{file.stem}".replace("_", "-")] = doc.partition("\n")[0]
    return names


def load_scenario(name: str, settings: Mapping[str, str] | None = None) -> tuple[Any, dict[str, str]]:
    """The scenario of a name, and the settings that are not arguments of its function.

    Args:
        name: in the catalogue, or ``module:function``, or ``file.py:function``.
        settings: text by path; those without a dot that name an argument of the function are passed to it.

    Raises: InputError for an unknown name or choice, or an argument that nothing gives.
    """
    build = _find_function(name)
    offered = _argument_choices(build)
    arguments, rest = {}, {}
    for path, text in (settings or {}).items():
        choices = offered.get(path)
        if choices and text not in choices:
            problem = f"{text!r} is not a choice of scenario {name!r}"
            raise InputError(f"--set {path}", problem, choices=choices, fix=f"--set {path}={choices[0]}")
        (arguments if path in offered else rest)[path] = text
    for parameter in inspect.signature(build).parameters.values():
        named = parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        if named and parameter.default is parameter.empty and parameter.name not in arguments:
            problem = f"its argument {parameter.name!r} has no default, and no setting gives it"
            fix = f"--set {parameter.name}=…; to export a function that is no scenario:  example = (…,)  in its file"
            raise InputError(f"scenario {name!r}", problem, fix=fix)
    return build(**arguments), rest


def scenario_choices(name: str) -> dict[str, tuple[str, ...]]:
    """The choices that a scenario's function offers, e.g. {"initial": ("moving", "rest")}."""
    return _argument_choices(_find_function(name))


def choice_lines(name: str) -> dict[str, dict[str, str]]:
    """One line for each choice of those arguments that have them: ``Annotated[Literal[…], {"choice": "line"}]``."""
    hints = typing.get_type_hints(_find_function(name), include_extras=True)
    noted = {n: hint.__metadata__[0] for n, hint in hints.items() if typing.get_origin(hint) is typing.Annotated}
    return {argument: dict(lines) for argument, lines in noted.items() if isinstance(lines, Mapping)}


def _argument_choices(build: Callable[..., Any]) -> dict[str, tuple[str, ...]]:
    hints = typing.get_type_hints(build)
    return {n: typing.get_args(hints.get(n)) for n in inspect.signature(build).parameters}


def _find_function(name: str) -> Callable[..., Any]:
    if ":" in name:
        return load_function(name)
    known = scenario_names()
    if name not in known:
        near = closest(name, known, 1)
        fix = f"trimtab run {near[0]}" if near else "trimtab list  shows them all; your own is  file.py:function"
        raise InputError(f"scenario {name!r}", "there is no such scenario", choices=known, fix=fix)
    module = f"trimtab.scenarios.{name.replace('-', '_').replace('/', '.')}"
    return importlib.import_module(module).scenario


def load_function(name: str) -> Callable[..., Any]:
    """A function outside the package: ``module:function``, or ``file.py:function``."""
    where, _, attribute = name.rpartition(":")
    module = _load_file(name, Path(where)) if where.endswith(".py") else _load_module(name, where)
    build = getattr(module, attribute or "scenario", None)
    if not callable(build):
        functions = [n for n, f in vars(module).items() if inspect.isfunction(f) and f.__module__ == module.__name__]
        fix = f"define  def {attribute or 'scenario'}() -> Scenario:  in {where}"
        raise InputError(f"scenario {name!r}", f"{where} has no function {attribute!r}", choices=functions, fix=fix)
    return build


def _load_file(name: str, path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(f"scenario {name!r}", f"there is no file {str(path)!r}", fix="give the path of a .py file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def _load_module(name: str, where: str) -> Any:
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        return importlib.import_module(where)
    except ModuleNotFoundError as error:
        if error.name != where.split(".")[0]:
            raise
        fix = f"run from the folder that holds {where}.py, or give the file: {where}.py:scenario"
        raise InputError(f"scenario {name!r}", f"there is no module {where!r}", fix=fix) from None
