"""The lists of mutations match the sources; `run.py` tries the mutations."""

import ast
from collections import Counter
from pathlib import Path

import pytest
from mutations.run import read_mutations

ROOT = Path(__file__).parents[2]
MUTATIONS = read_mutations()


def test_each_mutation_matches_one_place():
    texts = {m.file: (ROOT / m.file).read_text(encoding="utf-8") for m in MUTATIONS}
    assert not [m.name for m in MUTATIONS if texts[m.file].count(m.old) != 1]


@pytest.mark.thorough
@pytest.mark.parametrize("mutation", MUTATIONS, ids=[m.name for m in MUTATIONS])
def test_mutation_changes_one_place_and_keeps_python_valid(mutation):
    text = (ROOT / mutation.file).read_text(encoding="utf-8")
    assert text.count(mutation.old) == 1, f"in {mutation.file}: {mutation.old}"
    assert mutation.old != mutation.new
    if mutation.file.endswith(".py"):
        assert ast.dump(ast.parse(text.replace(mutation.old, mutation.new))) != ast.dump(ast.parse(text))
    assert all((ROOT / t).is_file() for t in mutation.tests)


def test_mutation_names_are_unique():
    assert not [name for name, n in Counter(m.name for m in MUTATIONS).items() if n > 1]
