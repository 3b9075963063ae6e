"""`trimtab new`: write a working template of a vehicle, law, sensor or other part, with a test and a docs page.

The files are copies of the tested templates in `trimtab.templates`. The given name replaces the template's name.
"""

import ast
import importlib.util
import keyword
import re
import shlex
import sys
import unicodedata
from collections.abc import Mapping
from importlib.machinery import PathFinder
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from trimtab.commands.options import JSON, OUT
from trimtab.commands.output import check_folder, print_json, write_text
from trimtab.commands.written_files import OVERWRITE
from trimtab.core.errors import InputError, install_command
from trimtab.core.suggestions import closest

TEMPLATES = Path(__file__).parents[1] / "templates"
KINDS = ("vehicle", "law", "sensor", "estimator", "link", "actuator", "scenario")
OTHERS = {
    "boat": "vehicle",
    "channel": "link",
    "controller": "law",
    "craft": "vehicle",
    "filter": "estimator",
    "model": "vehicle",
    "motor": "actuator",
    "observer": "estimator",
    "plant": "vehicle",
    "radio": "link",
    "servo": "actuator",
}
"""Synonym for a kind of part -> name of the kind."""
UNCERTAIN = {
    "vehicle": "world.vehicle.speed",
    "law": "world.vehicle.current.north",
    "sensor": "world.sensors.navigation.rate_bias",
    "estimator": "world.vehicle.current.north",
    "link": "world.vehicle.mass",
    "actuator": "world.actuators.stages.force.0.friction",
    "scenario": "world.vehicle.mass",
}
"""Kind of part -> parameter in the template that is uncertain, as an example for a campaign."""
LONGEST = 24
"""Maximum length of a part's name, so that source lines that contain the name stay within 120 characters."""


def complete_kinds(context: click.Context, parameter: click.Parameter, start: str) -> list[CompletionItem]:
    """Return shell completions for kinds of parts."""
    return [CompletionItem(kind) for kind in KINDS if kind.startswith(start)]


@click.command()
@click.argument("kind", shell_complete=complete_kinds)
@click.argument("name")
@OUT("DIR", "Write the three files to this folder.  [default: here]")
@JSON
@click.pass_context
def command(context: click.Context, kind: str, name: str, out: Path | None, as_json: bool) -> None:
    """Write a template of a new part, with a test and a docs page.

    KIND is vehicle, law, sensor, estimator, link, actuator or scenario. NAME.py contains the part and a
    complete scenario in which the part is used. For a scenario the file is NAME.toml.

    \b
    trimtab new vehicle my_bike
    trimtab new law my_law --out laws
    trimtab new scenario my_flight
    """
    check_kind(kind, name)
    check_name(kind, name)
    folder = out or Path()
    check_unused(kind, name, folder)
    check_folder("--out", folder)
    files = read_files(kind, name)
    _check_places(kind, name, folder, files, bool(context.meta.get(OVERWRITE)))
    written = [str(write_text(folder / file, text)) for file, text in files.items()]
    commands = next_commands(kind, folder / name)
    if as_json:
        print_json({"kind": kind, "name": name, "files": written, "next": list(commands)})
        return
    for file in written:
        click.echo(f"wrote {file}")
    width = max(map(len, commands))
    for line, purpose in commands.items():
        click.echo(f"  {line:{width}}  {purpose}")


def check_kind(kind: str, name: str) -> None:
    """Raise InputError for an unknown kind of part, and suggest the likely kind."""
    if kind not in KINDS:
        near = OTHERS.get(kind.lower()) or next(iter(closest(kind.lower(), KINDS, 1)), KINDS[0])
        raise InputError(f"trimtab new {kind}", "no such kind", choices=KINDS, fix=f"trimtab new {near} {name}")


def check_name(kind: str, name: str) -> None:
    """Raise InputError for a name that is a path, not a Python name, reserved, or already used in the template."""
    typed, path = f"trimtab new {kind}", Path(name)
    if len(path.parts) > 1 or name.endswith(("/", ".py", ".toml", ".md")):
        folder = "" if path.parent == Path() else f" --out {shlex.quote(str(path.parent))}"
        problem = f"{name!r} is a path, but NAME must be a name; give the folder with --out"
        raise InputError("NAME", problem, fix=f"{typed} {nearest_name(path.stem)}{folder}")
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or len(name) > LONGEST:
        problem = f"{name!r} is not a valid name: it must consist of ASCII letters, digits and _, at most {LONGEST}"
        raise InputError("NAME", problem, fix=f"{typed} {nearest_name(name)}")
    if keyword.iskeyword(name) or keyword.issoftkeyword(name):
        raise InputError("NAME", f"{name!r} is a reserved word of Python", fix=f"{typed} {nearest_name(f'my_{name}')}")
    if name.startswith("test_") or name == "conftest":
        problem = f"pytest would treat {name}.py as a test file"
        raise InputError("NAME", problem, fix=f"{typed} {nearest_name('my_' + name.removeprefix('test_'))}")
    words = read_words(kind)
    for own in (word for word in words if word.startswith(f"My{kind.capitalize()}")):
        given = own.replace(f"My{kind.capitalize()}", class_name(name))
        if given != own and given in words:
            problem = f"the template already contains a class {given}, which would be the name of the new class"
            raise InputError("NAME", problem, fix=f"{typed} {nearest_name(f'my_{name}')}")


def check_unused(kind: str, name: str, folder: Path) -> None:
    """Raise InputError if a module of this name exists, because the new file would hide the module."""
    own = {Path().resolve(), folder.resolve()}
    places = [place for place in sys.path if Path(place).resolve() not in own]
    found = None if name in sys.stdlib_module_names else PathFinder.find_spec(name, places)
    if name in sys.stdlib_module_names or (found is not None and found.loader is not None):
        problem = f"a Python module {name!r} exists, and {name}.py would hide it"
        raise InputError("NAME", problem, fix=f"trimtab new {kind} {nearest_name(f'my_{name}')}")


def nearest_name(text: str) -> str:
    """Return the nearest valid name: lower-case letters without accents, digits and _."""
    plain = unicodedata.normalize("NFKD", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text).casefold())
    letters = "".join(c for c in plain if not unicodedata.combining(c))
    words = re.sub(r"[\W_]+", "_", letters, flags=re.ASCII).strip("_")
    whole = words if words[:1].isalpha() and not keyword.iskeyword(words) else f"my_{words or 'part'}"
    return whole[:LONGEST].rstrip("_")


def class_name(name: str) -> str:
    """Return the class name of a part, e.g. MyBike for my_bike."""
    return "".join(word[:1].upper() + word[1:] for word in name.split("_"))


def read_words(kind: str) -> set[str]:
    """Return the Python identifiers used in the template of a kind of part."""
    if kind == "scenario":
        return set()
    nodes = list(ast.walk(ast.parse((TEMPLATES / main_file(kind)).read_text(encoding="utf-8"))))
    classes = {node.name for node in nodes if isinstance(node, ast.ClassDef)}
    return classes | {node.name for node in nodes if isinstance(node, ast.alias)}


def main_file(kind: str) -> str:
    """Return the file name of the main template of a kind of part."""
    return f"my_{kind}.{'toml' if kind == 'scenario' else 'py'}"


def read_files(kind: str, name: str) -> dict[str, str]:
    """Return file name -> text of the files of a new part. The part's name replaces the template's name."""
    own = {
        f"my_{kind}": name,
        f"My{kind.capitalize()}": class_name(name),
        f"My {kind}": name.replace("_", " ").strip().capitalize(),
    }
    texts = {}
    for file in (main_file(kind), f"test_my_{kind}.py", f"my_{kind}.md"):
        text = (TEMPLATES / file).read_text(encoding="utf-8")
        texts[file.replace(f"my_{kind}", name)] = re.sub("|".join(own), lambda found: own[found[0]], text)
    return texts


def _check_places(kind: str, name: str, folder: Path, files: Mapping[str, str], overwrite: bool) -> None:
    """Raise InputError if one of the new files exists already, unless overwriting is allowed."""
    for file in files:
        place = folder / file
        if place.is_dir() or (place.exists() and not overwrite):
            problem = f"{str(place)!r} is {'a folder' if place.is_dir() else 'an existing file'}"
            other = f"another name, e.g.  trimtab new {kind} {name[: LONGEST - 2]}_2"
            raise InputError("NAME", problem, fix=other if place.is_dir() else f"{other}, or --overwrite to replace it")


def next_commands(kind: str, place: Path) -> dict[str, str]:
    """Return command to type next -> purpose of the command."""
    flown = f"{place}.toml" if kind == "scenario" else f"{place}.py:scenario"
    test = place.with_name(f"test_{place.name}.py")
    missing = "" if importlib.util.find_spec("pytest") else f"; first  {install_command(package='pytest')}"
    return {
        f"trimtab run {flown} --plot {place}.png": "simulate and plot it",
        f"pytest {test}": f"run its test{missing}",
        f"trimtab list {flown}": "list every setting with its path",
        f"trimtab campaign {flown} --spread '{UNCERTAIN[kind]}=uniform(80%, 120%)'": "success rate over many runs",
        f"trimtab export {flown} --out {place}-c": "export the autopilot as C",
        f"trimtab export --verify {place}-c": "compile the C code and compare with a simulated run",
    }
