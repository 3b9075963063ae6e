"""Catalogue of the scenarios. Every Python file in a subfolder of this folder is a scenario, named after its path.

For example, ``hovercraft/zero_velocity.py`` contains the scenario ``hovercraft/zero-velocity``. Files whose names begin
with ``_`` are not scenarios. A scenario outside the package is named by a module or file and a function
(``my_boat:scenario``, ``my_boat.py:scenario``), by a scenario file (``my_boat.toml``) or by an FMU (``x.fmu``).
"""

import ast
import functools
import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
import types
import typing
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from trimtab.core.errors import InputError, Spelling, argument, argument_name, command, spell_python, spell_with
from trimtab.core.suggestions import closest

TOML = ".toml"
BARE = "bare"
"""Name of the empty scenario, the base of a scenario file that names no base scenario."""
GAIN = "gain"
"""Name of the setting whose value is the name of a file with a feedback gain."""
FOLDER = Path(__file__).parent


def scenario_names() -> dict[str, str]:
    """Return the name of each scenario in the catalogue -> first line of its description. No scenario is imported.

    >>> from trimtab import scenario_names
    >>> scenario_names()["hovercraft/spin"]
    'Turn on the spot at 3 rad/s: brake first, then spin.'
    """
    docs = {n: ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) for n, file in scenario_files().items()}
    return {name: (doc or "").partition("\n")[0] for name, doc in docs.items()}


def scenario_files() -> dict[str, Path]:
    """Return the name of each scenario in the catalogue -> its Python file."""
    files = [file for file in sorted(FOLDER.glob("*/*.py")) if not file.name.startswith("_")]
    return {f"{file.parent.name}/{file.stem}".replace("_", "-"): file for file in files}


def check_name(name: str, verb: str = "run") -> None:
    """Raise InputError for a name that is not in the catalogue. The message suggests similar names.

    verb: subcommand of trimtab to use in the suggestion, e.g. "run".
    """
    known = scenario_files()
    if name in known:
        return
    if name.endswith(".py"):
        _refuse_bare_file(name, verb)
    family = [n for n in known if n.partition("/")[0] == name.partition("/")[0]]
    near = closest(name, family or known, 1) or family[:1]
    every = command(
        "trimtab list  shows all scenarios; your own:  file.py:function",
        'scenario_names()  returns all scenarios; your own:  "file.py:function"',
    )
    typed = command(f"trimtab {verb} {near[0]}", f'"{near[0]}"') if near else ""
    fix = f"{typed}      {every}".strip()
    raise InputError(f"scenario {name!r}", "unknown scenario", choices=family or known, fix=fix)


def _refuse_bare_file(name: str, verb: str) -> None:
    """Raise InputError for a Python file without a function name."""
    if Path(name).is_file():
        problem, fix = "the name of the function in this file is missing", f"trimtab {verb} {name}:scenario"
    else:
        problem, fix = "file not found", f"name an existing file, as in  trimtab {verb} my_boat.py:scenario"
    raise InputError(f"scenario {name!r}", problem, fix=fix)


def load_scenario(name: str, settings: Mapping[str, str] | None = None) -> tuple[Any, dict[str, str]]:
    """Return the named scenario, and the settings that are not arguments of its function.

    Args:
        name: a name in the catalogue, or ``module:function``, or ``file.py:function``, or ``file.toml``.
        settings: path of a field, or name of an argument of the scenario's function -> text.

    Raises: InputError for an unknown name or choice, or if an argument without default is not set.
    """
    build = _find_function(name)
    offered = _argument_choices(build)
    arguments, rest = {}, {}
    for path, text in (settings or {}).items():
        choices = offered.get(path)
        if choices and text not in choices:
            problem = f"{text!r} is not a choice of scenario {name!r}"
            raise InputError(
                argument_name("settings", path), problem, choices=choices, fix=argument("settings", choices[0], path)
            )
        (arguments if path in offered else rest)[path] = text
    for parameter in inspect.signature(build).parameters.values():
        named = parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        if named and parameter.default is parameter.empty and parameter.name not in arguments:
            problem = f"the argument {parameter.name!r} of the scenario's function has no default and is not set"
            fix = argument("settings", "…", parameter.name)
            fix += "; to export a function that is not a scenario, write  example = (…,)  in the function's file"
            raise InputError(f"scenario {name!r}", problem, fix=fix)
    if ":" not in name:
        return build(**arguments), rest
    arguments = {n: _convert_argument(build, n, text) for n, text in arguments.items()}
    try:
        with spell_with(_spell_python), redirect_stdout(sys.stderr):
            return build(**arguments), rest
    except (Exception, SystemExit) as error:  # raised by the code in the named file
        raise _own_code_error(name, error) from error


def _convert_argument(build: Callable[..., Any], name: str, text: str) -> Any:
    """Return the value of an argument of a user's function: a number or a flag if the function declares one.

    The type is the annotation of the argument, or else the type of its default. Other arguments stay texts.
    """
    default = inspect.signature(build).parameters[name].default
    kind = _plain_hint(_argument_hints(build).get(name, type(default)))
    if kind is bool and text.lower() in ("true", "false"):
        return text.lower() == "true"
    if kind not in (bool, int, float):
        return text
    try:
        if kind is not bool:
            return kind(text)
    except ValueError:
        pass
    wanted = {bool: "true or false", int: "an integer", float: "a number without unit"}[kind]
    example = {bool: "true", int: "2", float: "1.5"}[kind]
    problem = f"must be {wanted}, got {text!r}"
    raise InputError(argument_name("settings", name), problem, fix=argument("settings", example, name))


def scenario_choices(name: str) -> dict[str, tuple[str, ...]]:
    """Return the choices that a scenario's function offers, e.g. {"initial": ("moving", "rest")}."""
    return _argument_choices(_find_function(name))


def choice_lines(name: str) -> dict[str, dict[str, str]]:
    """Return, for each argument of a scenario, the choices and a one-line description of each choice.

    The descriptions are taken from the annotations of the scenario's function:
    ``Annotated[Literal[…], {"choice": "line"}]``.
    """
    hints = _argument_hints(_find_function(name))
    noted = {n: hint.__metadata__[0] for n, hint in hints.items() if typing.get_origin(hint) is typing.Annotated}
    return {argument: dict(lines) for argument, lines in noted.items() if isinstance(lines, Mapping)}


def _argument_choices(build: Callable[..., Any]) -> dict[str, tuple[str, ...]]:
    hints = {n: _plain_hint(hint) for n, hint in _argument_hints(build).items()}
    return {n: typing.get_args(hints.get(n)) for n in inspect.signature(build).parameters}


def _argument_hints(build: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a scenario's function, without the annotation of its return value.

    Raise InputError if an annotation names something that does not exist.
    """
    function = inspect.unwrap(build)
    own = {n: hint for n, hint in getattr(function, "__annotations__", {}).items() if n != "return"}
    annotated = types.SimpleNamespace(__annotations__=own)
    try:
        return typing.get_type_hints(annotated, getattr(function, "__globals__", {}), include_extras=True)
    except Exception as error:
        from trimtab.loop.own_code import place_of  # here because looking up a name needs no JAX

        problem = f"{place_of(function)}an annotation of the function is invalid: {error}"
        raise InputError(f"{function.__name__}()", problem, fix="correct the annotation, or import the name") from None


def _plain_hint(hint: Any) -> Any:
    return hint.__origin__ if typing.get_origin(hint) is typing.Annotated else hint


def _find_function(name: str) -> Callable[..., Any]:
    if name.endswith(TOML):
        return _file_function(name)
    if ":" in name:
        return load_function(name)
    if name.endswith(".fmu"):
        return importlib.import_module("trimtab.scenarios.fmu_file").fmu_scenario(name)
    if name == BARE:
        return importlib.import_module("trimtab.scenarios.bare").scenario
    check_name(name)
    module = f"trimtab.scenarios.{name.replace('-', '_').replace('/', '.')}"
    return importlib.import_module(module).scenario


def _file_function(name: str) -> Callable[..., Any]:
    """Return a function that builds the scenario of a scenario file, with the arguments of the file's base scenario."""
    from trimtab.scenarios.toml_file import read_scenario_file  # imported here because looking up a name needs no numpy

    base = _find_function(read_scenario_file(name).base)

    @functools.wraps(base)
    def scenario(**arguments: str) -> Any:
        return importlib.import_module("trimtab.scenarios.build").build(name, arguments)  # `build` imports this module

    return scenario


def load_function(name: str) -> Callable[..., Any]:
    """Return a function outside the package, named ``module:function`` or ``file.py:function``."""
    where, _, attribute = name.rpartition(":")
    module = _load_file(name, Path(where)) if where.endswith(".py") else _load_module(name, where)
    build = getattr(module, attribute or "scenario", None)
    if not callable(build):
        functions = [n for n, f in vars(module).items() if inspect.isfunction(f) and f.__module__ == module.__name__]
        near = closest(attribute, functions, 1)
        fix = f"{where}:{near[0]}" if near else f"define  def {attribute or 'scenario'}() -> Scenario:  in {where}"
        raise InputError(f"scenario {name!r}", f"{where} has no function {attribute!r}", choices=functions, fix=fix)
    return build


def _load_file(name: str, path: Path) -> Any:
    module_name = _choose_module_name(path)
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None or not path.is_file():
        problem = f"there is no file {str(path)!r}{'' if path.is_absolute() else f' in {Path.cwd()}'}"
        fix = f"use a path that exists; to create a vehicle: trimtab new vehicle {path.stem}"
        raise InputError(f"scenario {name!r}", problem, fix=fix)
    folder = str(path.resolve().parent)
    if folder not in sys.path:  # for files that the named file imports; last, so that no package is shadowed
        sys.path.append(folder)
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        with spell_with(_spell_python), redirect_stdout(sys.stderr):  # standard output is for the answer of --json
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        sys.modules.pop(module_name, None)
        raise _own_code_error(name, error) from error
    return module


def _choose_module_name(path: Path) -> str:
    """Return the module name for a user's file: the file name without .py, or a longer name if this name is taken.

    A file random.py, for example, needs a longer name, because Python has a module of this name.
    """
    stem, file = path.stem, path.resolve()
    loaded = sys.modules.get(stem)
    try:
        spec = importlib.util.find_spec(stem) if loaded is None else loaded.__spec__
    except (ImportError, ValueError):
        spec = None
    is_other = spec is not None and (spec.origin is None or Path(spec.origin).resolve() != file)
    return f"{stem}_{hashlib.sha256(os.fsencode(file)).hexdigest()[:8]}" if is_other else stem


def _own_code_error(name: str, error: BaseException) -> InputError:
    """Return an InputError with the line number at which a user's own file failed."""
    from trimtab.loop.own_code import refuse_own_code, refuse_within  # here because looking up a name needs no JAX

    return refuse_within(error) if isinstance(error, InputError) else refuse_own_code(f"scenario {name!r}", error)


def _spell_python(_: Spelling, name: str, value: Any, path: str | None) -> str:
    return spell_python(name, value, path)


def _load_module(name: str, where: str) -> Any:
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        with redirect_stdout(sys.stderr):
            return importlib.import_module(where)
    except (Exception, SystemExit) as error:
        if not isinstance(error, ModuleNotFoundError) or error.name != where.split(".")[0]:
            raise _own_code_error(f"{where}:scenario", error) from error
        fix = f"run trimtab in the folder that contains {where}.py, or name the file: {where}.py:scenario"
        raise InputError(f"scenario {name!r}", f"module {where!r} not found", fix=fix) from None
