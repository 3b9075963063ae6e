"""Names: class names are unique in the package, and a function's name is not a participle."""

import ast
from collections import defaultdict
from functools import cache

from contracts.sources import read_sources, read_statements

IRREGULAR = """
begun bent broken brought built bought caught chosen done drawn driven fallen fed felt found flown forgotten given gone
grown heard held hidden kept known laid lent lost made meant paid rung said seen sent shaken shown spent spoken spoilt
stood struck sunk taken taught told thought thrown understood undone unseen untold withdrawn won worn written
"""
NOT_PAST = frozenset(("need", "seed", "feed", "embed", "exceed", "speed", "bleed", "proceed", "succeed"))
"""Words in -ed that are no past tense."""
FUNCTION_WORDS = ("and", "at", "by", "for", "from", "in", "of", "on", "or", "to", "with")
"""What may follow a participle, where a noun would make it an adjective: `detuned_frequencies` is a noun."""


def is_participle(name):
    """Whether a function's name is, or begins as, a participle without a noun."""
    first, *rest = name.strip("_").split("_")
    past = first in IRREGULAR.split() or (first.endswith("ed") and first not in NOT_PAST)
    return past and (not rest or rest[0] in FUNCTION_WORDS)


@cache
def definitions():
    """Module, and definition of each class and function in it, nested ones too."""
    kinds = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    trees = {name: source.tree for name, source in read_sources().items()}
    return [(name, node) for name, tree in trees.items() for node in read_statements(tree) if isinstance(node, kinds)]


def test_class_names_are_unique():
    places = defaultdict(list)
    for module, node in definitions():
        if isinstance(node, ast.ClassDef):
            places[node.name].append(module)
    assert {name: modules for name, modules in places.items() if len(modules) > 1} == {}


def test_no_participle_names_a_function():
    functions = [(module, node.name) for module, node in definitions() if not isinstance(node, ast.ClassDef)]
    assert [f"{module}: {name}" for module, name in functions if is_participle(name)] == []


def test_participle_rule_classifies_example_names():
    assert [
        name for name in ("told", "_drawn", "made_of", "flown", "sampled", "kept_in") if not is_participle(name)
    ] == []
    assert [
        n for n in ("seed", "draw", "published_poles", "find_peaks", "_detuned_by", "speed_of") if is_participle(n)
    ] == ["_detuned_by"]
