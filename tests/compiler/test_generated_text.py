"""An independent reader of the generated C gets JAX's numbers, and the compiled text's to the bit."""

from typing import Any

import jax
import numpy as np
import pytest
from jax import numpy as jnp

from compiler.generated_texts import generate_text
from compiler.reader.c_machine import Program
from contracts import compiled, primitive_groups
from trimtab.compiler import pieces

QUICK = ("branches", "whiles")


def same_bits(a: Any, b: Any) -> bool:
    """Whether two arrays are equal, signs of zeros included; NaN is NaN."""
    if a.dtype.kind != "f":
        return bool(np.array_equal(a, b))
    return bool(np.all(((a == b) & (np.signbit(a) == np.signbit(b))) | (np.isnan(a) & np.isnan(b))))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cases",
    [pytest.param(g, marks=[] if g.__name__ in QUICK else pytest.mark.thorough) for g in primitive_groups.ALL],
    ids=lambda g: g.__name__,
)
def test_interpreted_text_matches_compiled_text_and_jax(cases: Any) -> None:
    made = cases()
    function, sets = compiled.together(made)
    text = generate_text(function, sets[0])
    program = Program(text.tokens)
    read = [text.evaluate(program, s) for s in sets]
    built, wanted = compiled.compiled(made, 0), compiled.reference(function, sets)
    owners = [c for c in made for _ in compiled.jax.tree.leaves(compiled.jax.eval_shape(c.function, *c.sets[0]))]
    for row, c_row, jax_row in zip(read, built, wanted, strict=True):
        for case, r, c, w in zip(owners, row, c_row, jax_row, strict=True):
            assert same_bits(r, c), case.name
            assert compiled.disagreement(case, w, r) is None, case.name


def test_interpreter_reads_text_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    bounds = {"FUNCTION_STATEMENTS_MAX": 60, "EXPORTED_STATEMENTS_MAX": 60, "PIECE": 30, "CALL_STATEMENTS_MIN": 5}
    for name, number in bounds.items():
        monkeypatch.setattr(pieces, name, number)

    def steps(x: Any, table: Any) -> Any:
        total = jnp.sin(x) @ table[:5]
        for k in range(6):
            x = jnp.tanh(x * total + k) + table[5 - k : 10 - k]
        return x, total, table.at[3].add(total)

    rng = np.random.default_rng(0)
    arguments = rng.normal(size=5), rng.normal(size=60)
    text = generate_text(steps, arguments)
    assert any(t.text == "go_piece3" for t in text.tokens)
    wanted = jax.tree.leaves(jax.jit(steps)(*arguments))
    for read, number in zip(text.evaluate(Program(text.tokens), arguments), wanted, strict=True):
        np.testing.assert_allclose(read, number, rtol=0, atol=1e-13)
