"""A changed text is no longer JAX's function: 1 000 of 1 000 mutants are refused by the reader or differ in a number.

What counts as a mutation, and what does not because the program would be the same, stands in `mutations.py`. A mutant
is rejected when the reader refuses it (a name not declared, memory not written, an index outside, a loop without end)
or when a result differs from JAX by more than 1e-13 (1e-6 for float32) of the largest number of its array, or of 1.
"""

import itertools
from collections import Counter
from typing import Any

import jax
import numpy as np
import pytest

from compiler.generated_texts import GeneratedText, generate_text
from compiler.mutated_programs import SAMPLES, Sample
from compiler.mutations import Mutator
from compiler.reader.c_grammar import Refusal
from compiler.reader.c_machine import Program

ARGUMENTS = 256


def differs(wanted: list[Any], got: list[Any]) -> bool:
    """Whether any number of any result is another one."""
    for w, g in zip(map(np.asarray, wanted), got, strict=True):
        if w.dtype.kind != "f":
            if not np.array_equal(w, g):
                return True
            continue
        finite = np.abs(w[np.isfinite(w)])
        allowed = (1e-13 if w.dtype == np.float64 else 1e-6) * np.max(finite, initial=1.0)
        with np.errstate(all="ignore"):
            same = (w == g) | (np.isnan(w) & np.isnan(g)) | (np.abs(w - g) <= allowed)
        if not same.all():
            return True
    return False


def try_mutant(text: GeneratedText, tokens: Any, sets: list[Any], wanted: list[Any]) -> str:
    """refused, differs or survives."""
    try:
        program = Program(tokens)
        for arguments, results in zip(sets, wanted, strict=True):
            if differs(results, text.evaluate(program, arguments)):
                return "differs"
    except Refusal:
        return "refused"
    return "survives"


def prepare_sample(sample: Sample) -> tuple[GeneratedText, list[Any], list[Any]]:
    """Text, arguments and what JAX gives for them; the text itself must agree."""
    rng = np.random.default_rng(20)
    sets = [sample.make(rng) for _ in range(ARGUMENTS)]
    jitted = jax.jit(sample.function)
    wanted = [jax.tree.leaves(jitted(*s)) for s in sets]
    text = generate_text(sample.function, sets[0])
    assert try_mutant(text, text.tokens, sets, wanted) == "survives", f"{sample.name} is not what JAX computes"
    return text, sets, wanted


def reject(count: int, seed: int) -> None:
    """So many mutants, taken in turn from all functions."""
    prepared = [prepare_sample(s) for s in SAMPLES]
    mutators = [Mutator(text.tokens) for text, _, _ in prepared]
    streams = [m.mutations(seed) for m in mutators]
    places, excluded = sum(len(m.places) for m in mutators), sum(m.excluded for m in mutators)
    print(f"{places} places may be changed, {excluded} are excluded")
    turns = itertools.zip_longest(*streams)
    mutants = ((k, m) for row in turns for k, m in enumerate(row) if m is not None)
    results, survivors = Counter(), []
    for k, mutation in itertools.islice(mutants, count):
        text, sets, wanted = prepared[k]
        result = try_mutant(text, mutation.tokens, sets, wanted)
        results[result] += 1
        if result == "survives":
            line = " ".join(t.text for t in text.tokens if t.line == mutation.line)
            survivors.append(f"{SAMPLES[k].name}: {mutation.kind} {mutation.what} in {line}")
    print(
        f"{results['refused']} refused, {results['differs']} with other numbers, {results['survives']} not told apart"
    )
    assert not survivors, "\n".join(survivors)
    assert results.total() == count


@pytest.mark.thorough
def test_each_of_100_mutants_is_rejected() -> None:
    reject(100, seed=1)


@pytest.mark.thorough
def test_each_of_1000_mutants_is_rejected() -> None:
    reject(1000, seed=2)
