"""Reads generated text with the independent reader and gives its numbers as numpy arrays."""

import math
import platform
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from compiler.reader.c_grammar import Token, tokenize
from compiler.reader.c_machine import TYPES, Program
from trimtab.compiler.function import lower_function

CPU = Path("/proc/cpuinfo")
FMA = platform.machine() == "aarch64" or (CPU.exists() and " fma " in CPU.read_text())
MACROS = {"__GNUC__": "12"} | ({"__FMA__": "1"} if FMA else {})


class GeneratedText(NamedTuple):
    """The tokens of a text, the workspace it needs, and the arrays that its function `go` gives."""

    tokens: list[Token]
    workspace: int
    like: list[Any]

    def evaluate(self, program: Program, arguments: Any) -> list[np.ndarray]:
        """The results of `go` in a program read from these tokens, or from a mutant of them."""
        arrays = [np.ascontiguousarray(a) for a in jax.tree.leaves(arguments)]
        counts = [(TYPES[a.dtype.name], math.prod(a.shape)) for a in self.like]
        numbers = program.run("go", arrays, counts, self.workspace)
        return [np.array(n, a.dtype).reshape(a.shape) for n, a in zip(numbers, self.like, strict=True)]


def generate_text(function: Any, example: tuple[Any, ...]) -> GeneratedText:
    """The text that the generator writes for a function."""
    one = lower_function(function, example).program_text("go")
    like = jax.tree.leaves(jax.eval_shape(function, *example))
    return GeneratedText(tokenize(one.text, MACROS), one.workspace, like)
