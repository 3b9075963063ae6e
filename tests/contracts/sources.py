"""The sources of the package, each read and parsed once for all contracts of a process."""

import ast
import gc
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

SOURCE = Path(__file__).parents[2] / "src" / "trimtab"
BLOCKS = ("body", "orelse", "handlers", "finalbody", "cases")
"""Fields of a statement that hold other statements."""


class Source(NamedTuple):
    """Text of a file and its tree."""

    text: str
    tree: ast.Module


@cache
def read_sources() -> dict[str, Source]:
    """Return each source by its path below the package.

    The trees live to the end, so they are exempt from garbage collection.
    """
    gc.disable()
    texts = {p.relative_to(SOURCE).as_posix(): p.read_text(encoding="utf-8") for p in sorted(SOURCE.rglob("*.py"))}
    read = {name: Source(text, ast.parse(text)) for name, text in texts.items()}
    gc.freeze()
    gc.enable()
    return read


@cache
def read_statements(tree: ast.AST) -> list[Any]:
    """Return the tree and all statements in it, nested ones too, without their expressions."""
    found = [tree]
    for node in found:
        for name in BLOCKS:
            found += getattr(node, name, ())
    return found


def read_nodes(tree: ast.AST) -> list[ast.AST]:
    """Return the tree and all nodes in it, apart from the contexts of names, which say load or store."""
    found = [tree]
    for node in found:
        for value in vars(node).values():
            if isinstance(value, list):
                found += [item for item in value if isinstance(item, ast.AST)]
            elif isinstance(value, ast.AST) and not isinstance(value, ast.expr_context):
                found.append(value)
    return found
