"""Which studies there are: every folder below this one; a study's groups are its files with a function ``rows``.

A group's file says in its docstring's first line what it holds, in ``SECTION`` where that stands in the publication
("6.2.1", or in words, "eq. 9"), and gives its rows in ``rows()``. If it also has ``figures(folder)``, that draws
pictures and gives their files.
"""

import ast
import importlib
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from studies.row import Row
from trimtab.core.errors import InputError, closest

FOLDER = Path(__file__).parent


class StudyGroup(NamedTuple):
    """A group of a study's figures.

    study, name: as on the command line.  title: its first line.  section: of the publication.  draws: has pictures.
    """

    study: str
    name: str
    title: str
    section: str
    draws: bool

    @property
    def place(self) -> str:
        """Where it stands in the publication, in words."""
        return f"section {self.section}" if self.section[:1].isdigit() else self.section

    def rows(self) -> Iterator[Row]:
        """Its rows, each computed when it is asked for."""
        yield from self._import_module().rows()

    def figures(self, folder: Path) -> Iterator[Path]:
        """Draw its pictures into a folder."""
        if self.draws:
            yield from self._import_module().figures(folder)

    def _import_module(self) -> Any:
        return importlib.import_module(f"studies.{self.study}.{self.name.replace('-', '_')}")


def list_studies() -> dict[str, str]:
    """Name of each study -> first line of its docstring; nothing is imported."""
    found = {}
    for file in sorted(FOLDER.glob("*/__init__.py")):
        found[file.parent.name] = _read_title(ast.parse(file.read_text(encoding="utf-8")))
    return found


def list_groups(study: str, only: Iterable[str] = ()) -> list[StudyGroup]:
    """The groups of a study in the order of the publication, all or those named; nothing is imported."""
    known = list_studies()
    if study not in known:
        near = closest(study, known, 1) or list(known)
        fix = f"trimtab reproduce {near[0]}"
        raise InputError(f"study {study!r}", "there is no such study", choices=known, fix=fix)
    files = sorted((FOLDER / study).glob("*.py"))
    found = sorted((g for g in (_read_group(study, f) for f in files) if g is not None), key=_sort_key)
    names, wanted = [g.name for g in found], list(only)
    for name in wanted:
        if name not in names:
            near = closest(name, names, 1) or names
            problem = f"study {study!r} has no group {name!r}"
            raise InputError("--only", problem, choices=names, fix=f"--only {near[0]}")
    return [g for g in found if not wanted or g.name in wanted]


def _read_group(study: str, file: Path) -> StudyGroup | None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
    if "rows" not in functions:
        return None
    section = next((s for n in tree.body if (s := _read_section(n))), "")
    return StudyGroup(study, file.stem.replace("_", "-"), _read_title(tree), section, "figures" in functions)


def _read_section(node: ast.stmt) -> str:
    if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)):
        return ""
    names = [t.id for t in node.targets if isinstance(t, ast.Name)]
    return str(node.value.value) if names == ["SECTION"] else ""


def _sort_key(group: StudyGroup) -> tuple[list[float], str]:
    """By the numbers of the section or equation; what has none comes last."""
    return [float(n) for n in re.findall(r"\d+", group.section)] or [math.inf], group.name


def _read_title(tree: ast.Module) -> str:
    return (ast.get_docstring(tree) or "").partition("\n")[0].removesuffix(".")
