"""The texts that the package's sources refuse with, read out of the code: what the page of messages shows.

A text is followed through what it is put together of: names that the function or its module gave a value, both sides of
a choice, functions of the module that return a text. What is known only when it runs is a hole, ``…``.
"""

import ast
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator
from itertools import chain, islice, product
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).parents[1] / "src" / "trimtab"
HOLE = "…"
WORD = re.compile(r"[^\W\d_]{2,}")
DEFINITION = re.compile(r"\bproblem\b|class .*\bInputError\b")
"""Text of every file that defines what others refuse with."""
MOST = 8
"""Texts that one place may give: more are the same words in another order."""
DEEPEST = 6
"""Names and functions that are followed one out of the other."""
Function = ast.FunctionDef | ast.AsyncFunctionDef
BLOCKS = ("body", "handlers", "orelse", "finalbody", "cases")
"""Fields of a statement that hold other statements."""
Places = tuple[ast.AST, ...]
"""The module, and the functions one in the other, in which an expression stands."""
Followed = tuple[str, ...]
"""Names through which an expression was reached."""


class Message(NamedTuple):
    """What is said, and where: the module below ``trimtab``, such as ``links.tcp``."""

    module: str
    text: str
    fix: str


class Module:
    """A source file with what its names may stand for."""

    def __init__(self, path: Path, text: str) -> None:
        self.name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        self.tree = ast.parse(text)
        self.statements = _statements(self.tree)
        self.functions = {n.name: n for n in self.statements if isinstance(n, Function)}
        self._lines = text.splitlines()
        self._values: dict[int, dict[str, list[ast.expr]]] = {}

    def values(self, place: ast.AST) -> dict[str, list[ast.expr]]:
        """What each name of a function, or of the module, is given."""
        if id(place) not in self._values:
            self._values[id(place)] = _assigned(ast.iter_child_nodes(place))
        return self._values[id(place)]

    def texts(self, node: ast.expr | None, places: Places, followed: Followed = ()) -> list[str]:
        """What a text may be, with its holes."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return [node.value]
        if isinstance(node, ast.JoinedStr):
            return self._join(node.values, places, followed)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return self._join([node.left, node.right], places, followed)
        if isinstance(node, ast.IfExp):
            return self._choose([node.body, node.orelse], places, followed)
        if isinstance(node, ast.BoolOp):
            return self._choose(node.values, places, followed)
        if isinstance(node, ast.FormattedValue):
            node = node.value
            return self.texts(node, places, followed) if isinstance(node, ast.Name | ast.IfExp) else [HOLE]
        if isinstance(node, ast.Name) and node.id not in followed and len(followed) < DEEPEST:
            found = next((v[node.id] for p in reversed(places) if node.id in (v := self.values(p))), [])
            return self._choose(found, places, (*followed, node.id)) or [HOLE]
        if isinstance(node, ast.Call) and len(followed) < DEEPEST:
            return self._call_texts(node, followed)
        return [HOLE]

    def _call_texts(self, call: ast.Call, followed: Followed) -> list[str]:
        called = call.func.id if isinstance(call.func, ast.Name) else ""
        if called in ("argument", "argument_name"):
            (name, *_) = self.texts(call.args[0], (self.tree,), (*followed, called))
            return [name if called == "argument_name" else f"{name}={HOLE}"]
        if called not in self.functions or called in followed:
            return [HOLE]
        function = self.functions[called]
        returned = sorted((n for n in _statements(function) if isinstance(n, ast.Return)), key=lambda n: n.lineno)
        return self._choose(
            [n.value for n in returned if n.value is not None], (self.tree, function), (*followed, called)
        ) or [HOLE]

    def _join(self, pieces: Iterable[ast.expr], places: Places, followed: Followed) -> list[str]:
        every = product(*(self.texts(piece, places, followed) for piece in pieces))
        return ["".join(texts) for texts in islice(every, MOST)]

    def _choose(self, nodes: Iterable[ast.expr], places: Places, followed: Followed) -> list[str]:
        every = chain.from_iterable(self.texts(node, places, followed) for node in nodes)
        return list(dict.fromkeys(islice(every, MOST)))

    def calls(self, pattern: re.Pattern[str]) -> Iterator[tuple[ast.Call, Places]]:
        """Calls in statements whose text has the pattern, with the functions around them, from the module inwards."""
        found = [number for number, line in enumerate(self._lines, 1) if pattern.search(line)]
        waiting: list[tuple[ast.AST, Places]] = [(self.tree, (self.tree,))]
        while waiting:
            node, places = waiting.pop()
            if isinstance(node, ast.stmt):
                first = min((d.lineno for d in getattr(node, "decorator_list", ())), default=node.lineno)
                if bisect_left(found, first) == bisect_right(found, node.end_lineno or first):
                    continue
            if isinstance(node, ast.Call):
                yield node, places
            inside = (*places, node) if isinstance(node, Function) else places
            waiting.extend((child, inside) for child in reversed(list(ast.iter_child_nodes(node))))


def _statements(tree: ast.AST) -> list[ast.AST]:
    """The tree and all statements in it, nested ones too, outer ones first."""
    found = [tree]
    for node in found:
        for name in BLOCKS:
            found += getattr(node, name, ())
    return found


def _assigned(nodes: Iterable[ast.AST]) -> dict[str, list[ast.expr]]:
    """Names and what they are given below these nodes, but not in functions of their own."""
    found: dict[str, list[ast.expr]] = {}

    def give(target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name):
            found.setdefault(target.id, []).append(value)
        elif isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
            for each, part in zip(target.elts, value.elts, strict=True):
                give(each, part)
        elif isinstance(target, ast.Tuple) and isinstance(value, ast.IfExp):
            give(target, value.body)
            give(target, value.orelse)

    waiting = list(nodes)[::-1]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Assign):
            for target in node.targets:
                give(target, node.value)
        elif isinstance(node, ast.AnnAssign | ast.NamedExpr) and node.value is not None:
            give(node.target, node.value)
        if not isinstance(node, Function | ast.ClassDef | ast.Lambda):
            waiting.extend(reversed(list(ast.iter_child_nodes(node))))
    return found


def _refusers(modules: list[Module]) -> dict[str, list[str]]:
    """What takes a problem to refuse with, by its name: the names of its arguments, without self."""
    found: dict[str, list[str]] = {}
    classes = [n for m in modules for n in m.statements if isinstance(n, ast.ClassDef)]
    functions = [(f.name, f) for m in modules for f in m.functions.values()]
    made = [(c.name, f) for c in classes for f in c.body if isinstance(f, Function) and f.name == "__init__"]
    for name, function in functions + made:
        names = [a.arg for a in function.args.args if a.arg != "self"]
        if "problem" in names:
            found[name] = names
    del found["__init__"]
    heirs = [c.name for c in classes for base in c.bases if isinstance(base, ast.Name) and base.id == "InputError"]
    return found | dict.fromkeys(heirs, found["InputError"])


def _messages_of(module: Module, refusers: dict[str, list[str]], pattern: re.Pattern[str]) -> Iterator[Message]:
    for call, places in module.calls(pattern):
        name = call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")
        bare = name.endswith("Error") and not name.startswith("_") and len(call.args) == 1
        if name not in refusers and not bare:
            continue
        given = dict(zip(refusers.get(name, ["problem"]), call.args, strict=False))
        given |= {k.arg: k.value for k in call.keywords if k.arg}
        said = {
            what: module.texts(given[what], places) if what in given else [""] for what in ("part", "problem", "fix")
        }
        for k, problem in enumerate(said["problem"]):
            if len(WORD.findall(problem)) > 1:
                part, fix = said["part"][0], said["fix"][min(k, len(said["fix"]) - 1)]
                text = f"{part}: {problem}" if WORD.search(part) else problem
                yield Message(module.name, _shorten(text), _shorten("" if fix == HOLE else fix))


def _shorten(text: str) -> str:
    """In one line, and holes that stand side by side are one."""
    return re.sub(rf"{HOLE}(?:\s*{HOLE})+", HOLE, " ".join(text.split()))


def read_messages() -> list[Message]:
    """Every message that the package can refuse with, in the order of the files, each text of a module once."""
    texts = {p: p.read_text("utf-8") for p in sorted(PACKAGE.rglob("*.py")) if "templates" not in p.parts}
    definers = {path: Module(path, text) for path, text in texts.items() if DEFINITION.search(text)}
    refusers = _refusers([*definers.values()])
    pattern = re.compile(rf"\b(?:{'|'.join(map(re.escape, refusers))}|[A-Za-z]\w*Error)\(")
    modules = [definers.get(path) or Module(path, text) for path, text in texts.items() if pattern.search(text)]
    every = chain.from_iterable(_messages_of(module, refusers, pattern) for module in modules)
    return list({(m.module, m.text): m for m in every}.values())
