"""Studies recompute publications. Each row of a study compares a value printed in a publication with a computed value.

A study is a package of Python files: a folder of `studies/` in a clone of trimtab, or a folder of your own. Each file
with a function ``rows`` is a group of the study. The first line of the file's docstring is the group's title,
``SECTION`` is the group's place in the publication ("6.2.1", or in words, "eq. 9"), and ``rows()`` yields the rows. An
optional function ``figures(folder)`` draws pictures and yields their files.
"""

import ast
import dataclasses
import importlib
import math
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.suggestions import closest

Relation = Literal["within", "at most", "band", "inside", "overlaps", "direction", "same", "none"]
Basis = Literal["printed", "text", "axis", "reference", "own", "input"]
Verdict = Literal["holds", "differs", "not reproduced"]

INFINITY = math.inf
BASES: dict[str, str] = {
    "printed": "a number that the publication prints",
    "text": "a statement in the text of the publication",
    "axis": "read off the axis or a curve of one of the publication's plots",
    "reference": "computed from the publication's numbers, by a program in tests/oracles without code of this package",
    "own": "an earlier result of this package: a regression test, not evidence about the publication",
    "input": "an input of the computation; the row shows that this input was used correctly",
}
"""Possible sources of a row's `printed` value -> description. The first three are the publication itself."""
PUBLISHED: tuple[Basis, ...] = ("printed", "text", "axis")


@dataclasses.dataclass(frozen=True)
class Row:
    """Value or statement of a publication, compared with the computed value. Build it with a function of this module.

    id: identifier ``place/what``, unique in the study.
    what: description of the value in a few words.
    printed: value in the publication: a number, a range (low, high) or words.
    computed: computed value: a number, a range, words, or True or False. None if it cannot be computed here.
    citation: place in the publication.
    relation: kind of comparison, e.g. equality or upper limit.
    accepted: accepted range (low, high) of `computed`; infinite on an open side.
    unit: unit of printed, computed and accepted.
    basis: source of `printed`, one of BASES.
    must_hold: True if the study fails when this row does not hold.
    note: remark. If the row need not hold, the note must state the reason.
    """

    id: str
    what: str
    printed: Any
    computed: Any
    citation: str
    relation: Relation
    accepted: tuple[float, float] = (-INFINITY, INFINITY)
    unit: str = "1"
    basis: Basis = "printed"
    must_hold: bool = True
    note: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError if a row lacks id, description or citation, or if a row that need not hold lacks a note."""
        if not (self.id and self.what and self.citation):
            raise ValueError(f"row {self.id!r} needs an id, a description and a citation")
        if not self.must_hold and not self.note:
            raise ValueError(f"row {self.id!r} has must_hold=False, so its note must state the reason")

    @property
    def holds(self) -> bool:
        """Return True if the computed value is accepted. NaN is never accepted."""
        low, high = self.accepted
        if self.computed is None:
            return False
        if self.relation == "same":
            return bool(self.computed == self.printed)
        if self.relation == "inside":
            return bool(low <= self.computed[0] and self.computed[1] <= high)
        if self.relation == "overlaps":
            return bool(low <= self.computed[1] and self.computed[0] <= high)
        if self.relation == "direction":
            return bool(low < self.computed < high)
        return bool(low <= self.computed <= high)

    @property
    def verdict(self) -> Verdict:
        """Return "holds", or for a row that does not hold: "differs" if it must hold, otherwise "not reproduced"."""
        return "holds" if self.holds else "differs" if self.must_hold else "not reproduced"

    @property
    def confirms(self) -> bool:
        """Return True if the row confirms the publication: the row holds, and `printed` is from the publication."""
        return self.holds and self.basis in PUBLISHED

    @property
    def fails(self) -> bool:
        """Return True if this row makes the study fail, i.e. it must hold but does not."""
        return self.must_hold and not self.holds

    @property
    def tolerance(self) -> str:
        """Return the accepted range in words."""
        low, high = self.accepted
        if self.relation == "none":
            return ""
        if self.relation == "same":
            return "exact"
        if self.relation == "within":
            return f"± {high - self.printed:.3g}"
        if self.relation == "direction" and INFINITY in (-low, high):
            return f"> {low:g}" if high == INFINITY else f"< {high:g}"
        if self.relation == "at most":
            return f"≤ {high:g}"
        word = {"inside": "in ", "overlaps": "meets "}.get(self.relation, "")
        return f"{word}{low:g} … {high:g}"

    def as_json(self) -> dict[str, Any]:
        """Return the row as plain values; non-finite numbers become null."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return _replace_infinite(fields | {"tolerance": self.tolerance, "verdict": self.verdict})


def within(
    id: str,
    what: str,
    printed: float,
    computed: Any,
    citation: str,
    *,
    tolerance: float = 0.0,
    relative: float = 0.0,
    **about: Any,
) -> Row:
    """Return a row that holds if `computed` equals `printed` within `tolerance` plus `relative` times |printed|."""
    off = tolerance + relative * abs(printed)
    accepted = printed - off, printed + off
    return Row(id, what, printed, float(computed), citation, "within", accepted, **about)


def band(
    id: str, what: str, printed: Any, computed: Any, citation: str, *, low: float, high: float, **about: Any
) -> Row:
    """Return a row that holds if `computed` lies in low..high, for a value that the publication states as "about"."""
    return Row(id, what, printed, float(computed), citation, "band", (low, high), **about)


def at_most(id: str, what: str, printed: Any, computed: Any, citation: str, *, high: float, **about: Any) -> Row:
    """Return a row that holds if `computed` is at most `high`."""
    return Row(id, what, printed, float(computed), citation, "at most", (-INFINITY, high), **about)


def inside(id: str, what: str, axis: tuple[float, float], computed: Any, citation: str, **about: Any) -> Row:
    """Return a row that holds if `computed`, (minimum, maximum) of a run, lies within the axis of a printed plot."""
    pair = float(computed[0]), float(computed[1])
    return Row(id, what, axis, pair, citation, "inside", axis, **{"basis": "axis", **about})


def overlaps(id: str, what: str, interval: tuple[float, float], computed: Any, citation: str, **about: Any) -> Row:
    """Return a row that holds if two intervals overlap.

    computed: lowest and highest value that a maximum (or minimum) has over many runs. interval: range read off the
    axis of a printed plot.
    """
    pair = float(computed[0]), float(computed[1])
    return Row(id, what, interval, pair, citation, "overlaps", interval, **{"basis": "axis", **about})


def direction(
    id: str,
    what: str,
    printed: str,
    computed: Any,
    citation: str,
    *,
    above: float = -INFINITY,
    below: float = INFINITY,
    **about: Any,
) -> Row:
    """Return a row for a statement in the text. The row holds if `computed` is between `above` and `below`.

    printed: words or number of the publication; "stated" if the study puts the statement into its own words.
    """
    return Row(id, what, printed, float(computed), citation, "direction", (above, below), **{"basis": "text", **about})


def same(id: str, what: str, printed: Any, computed: Any, citation: str, **about: Any) -> Row:
    """Return a row that holds if `computed` equals `printed` exactly, as for counts, shapes and verdicts."""
    return Row(id, what, printed, computed, citation, "same", **about)


def missing_row(id: str, what: str, printed: Any, citation: str, *, note: str, **about: Any) -> Row:
    """Return a row for a value that cannot be computed here. The note states the reason."""
    return Row(id, what, printed, None, citation, "none", must_hold=False, note=note, **about)


def format_value(value: Any) -> str:
    """Format a value for a table: a number with four digits, a pair as a range, None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple) and all(isinstance(v, int) for v in value):
        return " x ".join(map(str, value))
    if isinstance(value, tuple):
        return " … ".join(format_value(v) for v in value)
    return str(value)


def _replace_infinite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _replace_infinite(v) for k, v in value.items()}
    if isinstance(value, tuple):
        return [_replace_infinite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


HEADINGS = ("figure", "printed", "computed", "accepted", "unit", "verdict", "where", "")


def rows_table(rows: Iterable[Row]) -> str:
    """Return a Markdown table of rows. A star marks each value that is not from the publication itself (see BASES)."""
    lines = [_table_line(HEADINGS), _table_line("---" for _ in HEADINGS)]
    for row in rows:
        printed = format_value(row.printed) + ("" if row.basis in ("printed", "text") else " \\*")
        unit = "" if row.unit == "1" else row.unit
        verdict = "holds" if row.holds else f"**{row.verdict}**"
        cells = (row.what, printed, format_value(row.computed), row.tolerance, unit, verdict, row.citation, row.note)
        lines.append(_table_line(cell.replace("|", "\\|") for cell in cells))
    return "\n".join(lines)


def _table_line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


CLONE = Path(__file__).parents[2] / "studies"
"""Folder of the studies in a clone of trimtab. An installed package does not contain this folder."""
WHERE = "the studies are in trimtab's source repository: run the command in a clone, or name a study's folder"


class StudyGroup(NamedTuple):
    """Group of rows of a study.

    file: Python file that computes the rows. name: name on the command line. title: first line of the file's docstring.
    section: place in the publication. has_figures: True if the group can draw pictures.
    """

    file: Path
    name: str
    title: str
    section: str
    has_figures: bool

    @property
    def place(self) -> str:
        """Return the group's place in the publication, in words."""
        return f"section {self.section}" if self.section[:1].isdigit() else self.section

    def rows(self) -> Iterator[Row]:
        """Yield the group's rows. Each row is computed on demand."""
        yield from import_study(self.file).rows()

    def figures(self, folder: Path) -> Iterator[Path]:
        """Draw the group's pictures into a folder; yield the files."""
        if self.has_figures:
            yield from import_study(self.file).figures(folder)


def find_studies() -> dict[str, Path]:
    """Return name -> folder of each study in this clone of trimtab and in `studies` below the working directory."""
    for folder in (CLONE, Path.cwd() / "studies"):
        studies = {file.parent.name: file.parent for file in sorted(folder.glob("*/__init__.py"))}
        if studies:
            return studies
    return {}


def find_study(study: str) -> Path:
    """Return the folder of a study. study: name or folder of the study."""
    folder, studies = Path(study), find_studies()
    if study in studies:
        return studies[study]
    if (folder / "__init__.py").is_file():
        return folder.resolve()
    if folder.is_dir():
        raise InputError(f"study {study!r}", "the folder has no __init__.py", fix=f"touch {folder / '__init__.py'}")
    if not studies:
        raise InputError(f"study {study!r}", f"not found: {WHERE}", fix="trimtab reproduce path/to/a/study")
    near = closest(study, studies, 1) or list(studies)
    raise InputError(f"study {study!r}", "no such study", choices=studies, fix=f"trimtab reproduce {near[0]}")


def import_study(file: Path) -> Any:
    """Import a study's package or one of its modules. Add the folder of the outermost package to sys.path."""
    parts, root = [file.stem], file.parent
    while (root / "__init__.py").is_file():
        parts.insert(0, root.name)
        root = root.parent
    if str(root) not in sys.path:
        sys.path.append(str(root))
    return importlib.import_module(".".join(parts).removesuffix(".__init__"))


def read_study_title(folder: Path) -> str:
    """Return the first line of a study's docstring, without importing it."""
    return _read_title(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))


def list_groups(study: str, only: Iterable[str] = ()) -> list[StudyGroup]:
    """Return the groups of a study in the order of the publication. only: names of groups; if empty, all groups."""
    files = sorted(find_study(study).glob("*.py"))
    groups = sorted((g for g in map(_read_group, files) if g is not None), key=_sort_key)
    names, chosen = [g.name for g in groups], list(only)
    for name in chosen:
        if name not in names:
            near = closest(name, names, 1) or names
            problem = f"study {study!r} has no group {name!r}"
            raise InputError(argument_name("only"), problem, choices=names, fix=argument("only", [near[0]]))
    return [g for g in groups if not chosen or g.name in chosen]


def _read_group(file: Path) -> StudyGroup | None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
    if "rows" not in functions:
        return None
    section = next((s for n in tree.body if (s := _read_section(n))), "")
    return StudyGroup(file, file.stem.replace("_", "-"), _read_title(tree), section, "figures" in functions)


def _read_section(node: ast.stmt) -> str:
    if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)):
        return ""
    names = [t.id for t in node.targets if isinstance(t, ast.Name)]
    return str(node.value.value) if names == ["SECTION"] else ""


def _sort_key(group: StudyGroup) -> tuple[list[float], str]:
    """Return a sort key from the numbers of a group's section or equation. A group without numbers is sorted last."""
    return [float(n) for n in re.findall(r"\d+", group.section)] or [math.inf], group.name


def _read_title(tree: ast.Module) -> str:
    return (ast.get_docstring(tree) or "").partition("\n")[0].removesuffix(".")
