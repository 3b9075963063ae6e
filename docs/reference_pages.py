"""Directives that make the reference from what the package says of itself: its commands, names and records.

``{trimtab-commands}`` goes through the click commands, ``{trimtab-names}`` through the names of the front door, and
``{trimtab-records} folder`` through the public records of a folder, ``{trimtab-answers}`` through the schema of what is
printed after --json, ``{trimtab-messages}`` through what its sources refuse with. All of it is read when the pages are
built, so no page lags behind. Docstrings are plain text, not reStructuredText: indented lines stay as they are.
"""

import dataclasses
import importlib
import inspect
import json
import pkgutil
import re
import sys
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import click
import sphinx.application
from docutils import nodes
from sphinx import addnodes
from sphinx.util.docutils import SphinxDirective

import trimtab
from trimtab.cli import main
from trimtab.commands.output import ANSWERS
from trimtab.core.quantity import Option, Part, Quantity, declarations, is_record
from trimtab.core.time import to_seconds

sys.path.insert(0, str(Path(__file__).parent))
import messages

CODE = re.compile(r"(`{1,2}[^`]+`{1,2}|(?<!\\w)'[^' ][^']*'|(?<!\\S)--[a-z][a-z-]*)")
SECTION = re.compile(r"(Args|Returns|Raises):$")


def inline(text: str) -> nodes.paragraph:
    """A paragraph; what stands between backticks or single quotes, and options, are code."""
    paragraph = nodes.paragraph()
    for k, piece in enumerate(CODE.split(" ".join(text.split()))):
        paragraph += nodes.literal(text=piece.strip("`")) if k % 2 else nodes.Text(piece)
    return paragraph


def literal(text: str) -> nodes.literal_block:
    """Text as it stands, not coloured."""
    return nodes.literal_block(text, text, language="text")


def definitions(entries: Iterable[tuple[str, str]]) -> nodes.definition_list:
    """Terms and what they mean."""
    listed = nodes.definition_list()
    for term, meaning in entries:
        item = nodes.definition_list_item()
        item += nodes.term("", "", nodes.literal(text=term))
        item += nodes.definition("", inline(meaning))
        listed += item
    return listed


def render_entries(lines: list[str]) -> Iterator[nodes.Node]:
    """The indented lines below Args, Returns or Raises."""
    body = inspect.cleandoc("\n" + "\n".join(lines))
    entries = [e.partition(":") for e in re.split(r"\n(?! )", body)]
    if all(re.fullmatch(r"\w+", name) and colon for name, colon, _ in entries):
        yield definitions((name, meaning) for name, _, meaning in entries)
    else:
        yield inline(body)


def render_docstring(text: str) -> Iterator[nodes.Node]:
    """Paragraphs of a docstring; those with indented lines are kept as they stand."""
    for block in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = block.split("\n")
        found = SECTION.match(lines[0])
        if found and len(lines) > 1:
            yield nodes.paragraph("", "", nodes.strong(text=found[1]))
            yield from render_entries(lines[1:])
        elif any(line.startswith(" ") for line in lines):
            yield literal(block)
        else:
            yield inline(block)


def section(title: str, name: str, *content: nodes.Node) -> nodes.section:
    """A section with an address of its own."""
    made = nodes.section(ids=[nodes.make_id(name)], names=[nodes.fully_normalize_name(name)])
    made += nodes.title(title, title)
    made += list(content)
    return made


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> nodes.table:
    """A table whose first column is code."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=1) for _ in head]

    def line(cells: tuple[str, ...], first: Any) -> nodes.row:
        row = nodes.row()
        for k, cell in enumerate(cells):
            row += nodes.entry("", nodes.paragraph("", "", first(text=cell)) if k == 0 and cell else inline(cell))
        return row

    group += nodes.thead("", line(head, lambda text: nodes.Text(text)))
    group += nodes.tbody("", *(line(row, nodes.literal) for row in rows))
    return nodes.table("", group)


def render_help(text: str) -> Iterator[nodes.Node]:
    """The help of a command; a paragraph that click doesn't wrap is kept as it stands."""
    for block in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        yield literal(block.removeprefix("\b\n")) if block.startswith("\b") else inline(block)


def render_command(command: click.Command, path: str) -> nodes.section:
    """A command, its usage, its options, and the commands below it."""
    context = click.Context(command, info_name=path, help_option_names=["-h", "--help"])
    made = section(path, path, *render_help(command.help or ""))
    made += literal(" ".join([path, *command.collect_usage_pieces(context)]))
    records = [p.get_help_record(context) for p in command.get_params(context)]
    options = [record for record in records if record is not None]
    if options:
        made += definitions(options)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            made += render_command(below, f"{path} {name}")
    return made


def describe(value: Any) -> str:
    """A default, short enough for a table."""
    if value is dataclasses.MISSING:
        return ""
    text = type(value).__name__ if is_record(value) else f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 24 else "…"


def render_fields(cls: Any) -> Iterator[nodes.Node]:
    """The fields of a record: default, unit, range and meaning."""
    rows, declared = [], declarations(cls)
    for field in dataclasses.fields(cls):
        what = declared[field.name]
        default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        unit = bound = ""
        if isinstance(what, Quantity):
            unit = "" if what.unit == "1" else what.unit
            bounds = (("> ", what.above), ("≥ ", what.low), ("≤ ", what.high))
            bound = ", ".join(f"{sign}{value:g}" for sign, value in bounds if value is not None)
        elif isinstance(what, Option) and what.kind == "period" and isinstance(default, int):
            default, unit = float(to_seconds(default)), "s"
        elif isinstance(what, Option):
            bound = " | ".join(str(c) for c in what.choices)
        elif isinstance(what, Part) and default is None:
            default = "none"
        rows.append((field.name, describe(default), unit, bound, what.doc))
    if rows:
        yield table(("field", "default", "unit", "range", "meaning"), rows)


def public_records(folder: str) -> Iterator[tuple[str, list[type]]]:
    """Modules of a folder of the package, each with the records that it defines."""
    package = importlib.import_module(f"trimtab.{folder}")
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if found.ispkg or found.name.rpartition(".")[2].startswith("_"):
            continue
        here = vars(importlib.import_module(found.name)).values()
        classes = [
            c for c in here if isinstance(c, type) and c.__module__ == found.name and not c.__name__.startswith("_")
        ]
        kept = [
            c
            for c in classes
            if dataclasses.is_dataclass(c) and all("declared" in f.metadata for f in dataclasses.fields(c))
        ]
        if kept:
            yield found.name, kept


class Commands(SphinxDirective):
    """Every command of the command line."""

    def run(self) -> list[nodes.Node]:
        """A section for each verb."""
        context = click.Context(main, info_name="trimtab")
        return [
            render_command(main.get_command(context, name), f"trimtab {name}") for name in main.list_commands(context)
        ]


def type_words(schema: dict[str, Any]) -> str:
    """What a field is, in few words."""
    if "$ref" in schema:
        return schema["$ref"].rpartition("/")[2]
    if "anyOf" in schema:
        return " or ".join(type_words(one) for one in schema["anyOf"])
    if "const" in schema or "enum" in schema:
        return " or ".join(repr(one) for one in schema.get("enum", [schema.get("const")]))
    kinds = schema.get("type", "anything")
    text = " or ".join([kinds] if isinstance(kinds, str) else kinds)
    inside = schema.get("items") or schema.get("additionalProperties")
    return f"{text} of {type_words(inside)}" if isinstance(inside, dict) and inside else text


def render_answer(schema: dict[str, Any]) -> Iterator[nodes.Node]:
    """What an answer is, and its fields."""
    yield inline(schema.get("description", ""))
    rows = []
    for name, what in schema.get("properties", {}).items():
        doc = what.get("description", "")
        rows.append((name, type_words(what), "" if name in schema["required"] else "where there is one", doc))
    if rows:
        yield table(("field", "type", "present", "meaning"), rows)


class Answers(SphinxDirective):
    """What every verb prints after --json."""

    def run(self) -> list[nodes.Node]:
        """A section for each verb, with a table for each answer that it may give, and one for what they share."""
        schema = json.loads(ANSWERS.read_text("utf-8"))
        verbs = [one["$ref"].rpartition("/")[2] for one in schema["oneOf"]]
        made: list[nodes.Node] = []
        for name in (*verbs, *(name for name in schema["$defs"] if name not in verbs)):
            what = schema["$defs"][name]
            part = section(name, f"answer {name}")
            for one in what["anyOf"] if name in verbs and "anyOf" in what else [what]:
                part += list(render_answer(one))
            made.append(part)
        return made


class Names(SphinxDirective):
    """Every name of the front door."""

    def run(self) -> list[nodes.Node]:
        """A section for each name, which the search and other projects find as trimtab.NAME."""
        made: list[nodes.Node] = []
        for name in trimtab.HOMES:
            thing, path = getattr(trimtab, name), f"trimtab.{name}"
            kind, doc = "class" if inspect.isclass(thing) else "function", inspect.getdoc(thing) or ""
            part = section(path, path, literal(f"{name}{signature(thing)}"), *render_docstring(doc))
            part += inline(f"Defined in `trimtab.{trimtab.HOMES[name]}`.")
            if inspect.isclass(thing):
                if dataclasses.is_dataclass(thing) and all("declared" in f.metadata for f in dataclasses.fields(thing)):
                    part += list(render_fields(thing))
                public = [(n, m) for n, m in vars(thing).items() if inspect.isroutine(m) and not n.startswith("_")]
                part += definitions(
                    (f"{n}{signature(m)}", (inspect.getdoc(m) or "").split("\n\n")[0]) for n, m in public
                )
            self.env.domains["py"].note_object(path, kind, part["ids"][0])
            made.append(part)
        return made


def signature(thing: Any) -> str:
    """Names of its arguments, with defaults; types stand in the docstrings."""
    try:
        found = inspect.signature(thing)
    except (TypeError, ValueError):
        return "(…)"
    bare = [p.replace(annotation=inspect.Parameter.empty) for p in found.parameters.values() if p.name != "self"]
    bare = [p if p.default is p.empty else p.replace(default=Shown(p.default)) for p in bare]
    return str(found.replace(parameters=bare, return_annotation=inspect.Signature.empty))


class Shown:
    """A default that is written short."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __repr__(self) -> str:
        text = repr(self.value)
        return text if len(text) <= 24 and not text.startswith(("<", "mappingproxy")) else "…"


class Records(SphinxDirective):
    """Every public record of a folder: parts, their states and what they give."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """A section for each record, in the order of the files."""
        made: list[nodes.Node] = []
        for module, classes in public_records(self.arguments[0]):
            for cls in classes:
                path = f"{module}.{cls.__name__}"
                summary = (inspect.getdoc(cls) or "").split("\n\n")[0]
                part = section(cls.__name__, path, inline(f"`{module}`"), inline(summary), *render_fields(cls))
                self.env.domains["py"].note_object(path, "class", part["ids"][0])
                made.append(part)
        return made


def page_link(page: str, text: str = "") -> addnodes.pending_xref:
    """A link to a page by its name, under the page's title or a text of its own."""
    what = {"refdomain": "std", "reftype": "doc", "refexplicit": bool(text), "refwarn": True}
    return addnodes.pending_xref("", nodes.inline(text=text), reftarget=f"/{page}", **what)


def named_modules(text: str) -> set[str]:
    """Modules that a page names, below ``trimtab``, with the packages that they are in."""
    every: set[str] = set()
    for found in re.findall(r"\btrimtab\.([\w.]+)", text):
        parts = found.split(".")
        every |= {".".join(parts[: k + 1]) for k in range(len(parts))}
    return every


def explaining_page(module: str, pages: dict[str, set[str]]) -> str:
    """The page of a module: of its name in its folder, or the first that names it, of its folder if there is one.

    pages: each page, with the modules that it names.
    """
    *folders, name = module.split(".")
    own = [f"{folder}/{name.replace('_', '-')}" for folder in reversed(folders)]
    naming = [page for page, modules in pages.items() if module in modules]
    naming.sort(key=lambda page: page.partition("/")[0] not in folders)
    return next((page for page in (*own, *naming) if page in pages), "")


def verb_of(module: str) -> str:
    """The verb of the command line that a module is of, if it is of one."""
    folder, _, name = module.partition(".")
    named = {name.replace("_", "-"), name.partition("_")[0]} if folder == "commands" else set()
    return next((verb for verb in main.list_commands(click.Context(main)) if verb in named), "")


class Messages(SphinxDirective):
    """Every message that the package's sources refuse with."""

    def run(self) -> list[nodes.Node]:
        """A section for each folder; in it, for each module, where it is explained and a table."""
        env = self.env
        texts = {p: Path(env.doc2path(p)).read_text("utf-8") for p in sorted(env.found_docs) if p != env.docname}
        cures = re.findall(r"^\| `(.+?)` \|", texts["troubleshooting"], re.MULTILINE)
        pages = {page: named_modules(text) for page, text in texts.items()}
        made: list[nodes.Node] = []
        for folder, found in groupby(messages.read_messages(), lambda m: m.module.partition(".")[0]):
            part = section(folder.replace("__init__", "trimtab"), f"messages {folder}")
            for module, said in groupby(found, lambda m: m.module):
                part += self.heading(module, explaining_page(module, pages))
                rows = [(m.text, m.fix, any(cure in m.text for cure in cures)) for m in said]
                part += self.table(rows)
            made.append(part)
        return made

    def heading(self, module: str, page: str) -> nodes.paragraph:
        """Which module, the command that it is of, and the page that explains it."""
        name = f"trimtab.{module}".removesuffix(".__init__")
        said = nodes.paragraph("", "", nodes.strong("", "", nodes.literal(text=name)))
        verb = verb_of(module)
        if verb:
            address = f"commands.html#{nodes.make_id(f'trimtab {verb}')}"
            said += [nodes.Text(" — "), nodes.reference("", f"trimtab {verb}", internal=True, refuri=address)]
        if page:
            said += [nodes.Text(" — "), page_link(page)]
        return said

    def table(self, rows: list[tuple[str, str, bool]]) -> nodes.table:
        """What is said and what to do, with a link where the page of troubleshooting has more."""
        made = table(("message", "fix"), ((text, fix) for text, fix, _ in rows))
        entries = [row[1] for row in made.findall(nodes.row)][1:]
        for entry, (_, _, cure) in zip(entries, rows, strict=True):
            if cure:
                entry += nodes.paragraph("", "", page_link("troubleshooting", "troubleshooting"))
        return made


def setup(app: sphinx.application.Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("trimtab-answers", Answers)
    app.add_directive("trimtab-commands", Commands)
    app.add_directive("trimtab-messages", Messages)
    app.add_directive("trimtab-names", Names)
    app.add_directive("trimtab-records", Records)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
