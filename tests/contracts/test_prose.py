"""Plain English: phrases that puzzled readers, and docstrings that begin like a riddle, become fewer and never more."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from contracts.sources import read_nodes, read_sources

ROOT = Path(__file__).parents[2]
PHRASES = {
    "believe": r"believ(?:e|es|ed|able|ing)",
    "heard": r"(?:is|was|are|were|be|been) heard",
    "told": r"(?:is|was|are|were|be|been) (?:told|said)",
    "under way": r"under way",
    "hang together": r"(?:hang|hangs|hung) together",
    "somebody": r"somebody|who asks",
    "anew": r"anew",
    "so many": r"so (?:many|long) (?!as|that)",
    "is no": r"(?:is|are) no (?!longer|more|less|such)[a-z]+",
    "there is none": r"there (?:is|are) none",
    "fares": r"fare[sd]|what (?:it|they) (?:is|are) worth",
}
"""Phrases with several meanings. `accept`, `receive`, `report`, `again`, `must be …, got …` have one."""
FIRST_WORDS = re.compile(r"\s*(?:What|Whether|Which|How|Who|That|Of|So many)\b")
"""A docstring begins with a noun (of a thing) or with a verb (of a function) instead."""
LIMITS = {
    "src": {
        "believe": 0,
        "heard": 0,
        "told": 0,
        "under way": 0,
        "hang together": 0,
        "somebody": 0,
        "anew": 0,
        "so many": 0,
        "is no": 13,
        "there is none": 1,
        "fares": 0,
        "first words": 0,
    },
    "pages": {
        "believe": 0,
        "heard": 0,
        "told": 0,
        "under way": 0,
        "hang together": 0,
        "somebody": 0,
        "anew": 1,
        "so many": 0,
        "is no": 2,
        "there is none": 0,
        "fares": 0,
    },
}
"""Number of occurrences. A change may lower a number; the goal is 0."""


def read_words(text: str, tree: ast.Module) -> tuple[list[str], list[str]]:
    """Return the strings and comments of a Python file, and its docstrings alone, those of constants included."""
    words, docstrings = re.findall(r"(?:^|\s)#\s.*", text), []
    for node in read_nodes(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            words.append(node.value)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            docstrings.append(node.value.value)
    return words, docstrings


def count_phrases(words: list[str]) -> Counter[str]:
    """Return how often each phrase occurs."""
    text = "\n".join(words)
    return Counter({name: len(re.findall(rf"\b(?:{p})\b", text, re.IGNORECASE)) for name, p in PHRASES.items()})


@cache
def count_in(where: str) -> Counter[str]:
    """Return the counts of the package's sources ("src") or of what is written about it ("pages")."""
    if where == "pages":
        pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CHANGELOG.md"]
        pages = [page for page in pages if "_build" not in page.parts]
        return count_phrases([re.sub(r"```.*?```", "", p.read_text(encoding="utf-8"), flags=re.DOTALL) for p in pages])
    files = [read_words(*source) for source in read_sources().values()]
    found = count_phrases([word for words, _ in files for word in words])
    found["first words"] = sum(bool(FIRST_WORDS.match(d)) for _, docstrings in files for d in docstrings)
    return found


@pytest.mark.parametrize(("where", "name"), [(where, name) for where, limits in LIMITS.items() for name in limits])
def test_unclear_phrases_become_fewer(where: str, name: str) -> None:
    found, limit = count_in(where)[name], LIMITS[where][name]
    assert found <= limit, f"{name}: {found} in {where}, at most {limit}. Say it plainly: {PHRASES.get(name, name)}"
    assert found == limit, f"{name}: only {found} in {where}. Lower the limit of {limit}"


def test_counts_unclear_phrases_and_first_words() -> None:
    text = '"""What flies."""\nA = 1  # nobody is told\n"""Of the law."""\ndef f():\n    """Return it."""\n'
    words, docstrings = read_words(text, ast.parse(text))
    assert count_phrases([*words, "-1 is no number", "it is no longer valid"]) == Counter(told=1, **{"is no": 1})
    assert [bool(FIRST_WORDS.match(d)) for d in docstrings] == [True, True, False]
