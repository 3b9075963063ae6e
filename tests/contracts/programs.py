"""Random programs over what the generator covers, as Python text that prints, runs and shrinks.

Floats are of two kinds. Exact ones are multiples of a power of two whose sums and products lose nothing: they may
decide branches, become integers, and must agree to the bit. The others went through elementary functions or loops: they
stay in [-1, 1], decide nothing, and agree to TOLERANCE; `growth` bounds how often a rounding error is magnified.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jax import numpy as jnp

from contracts.compiled import LANES, Case
from contracts.expressions import EXPRESSIONS
from contracts.flows import FLOWS
from contracts.variables import DTYPES, Var

TOLERANCE = 1e-9
MOST_GROWTH = 1e4
BITS = 50


class Program(NamedTuple):
    """Statements (name, text), inner bodies included as text; what goes in; what comes out."""

    seed: int
    inputs: list[Var]
    statements: list[tuple[str, str]]
    outputs: list[Var]

    def text(self) -> str:
        """The program in Python."""
        lines = [f"def program({', '.join(v.name for v in self.inputs)}):"]
        lines += [f"    {name} = {text}" for name, text in self.statements]
        return "\n".join([*lines, f"    return ({''.join(v.name + ', ' for v in self.outputs)})"])

    def case(self) -> Case:
        """The program with inputs for each lane, edge values among them."""
        space: dict[str, Any] = {"jnp": jnp, "lax": lax, "jax": jax, "np": np}
        exec(self.text(), space)
        sets = []
        for lane in range(LANES):
            rng = np.random.default_rng([self.seed, lane])
            sets.append(tuple(_given(rng, v, odd=self.seed % 8 == 0) for v in self.inputs))
        return Case(f"seed {self.seed}", space["program"], sets)


def _given(rng: np.random.Generator, v: Var, odd: bool) -> Any:
    if v.kind == "f":
        x = rng.integers(-128, 129, v.shape) / 4
        if odd:
            x = np.where(rng.random(v.shape) < 0.1, rng.choice([np.nan, np.inf, -np.inf, -0.0], v.shape), x)
        return np.asarray(x)
    if v.kind == "b":
        return np.asarray(rng.random(v.shape) < 0.5)
    limits = np.iinfo(DTYPES[v.kind])
    small = rng.integers(0 if v.kind == "u32" else -9, 10, v.shape)
    large = rng.integers(limits.min, limits.max, v.shape, dtype=DTYPES[v.kind], endpoint=True)
    return np.asarray(np.where(rng.random(v.shape) < 0.3, large, small), DTYPES[v.kind])


class Writer:
    """Writes one program. env: the variables that a statement may read, those of the bodies around included."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 77])
        self.count = 0
        self.n = int(self.rng.choice([1, 4, 7, 60]))
        self.m = int(self.rng.choice([2, 3, 9]))
        self.shapes = [(), (), (self.n,), (self.n,), (self.m,), (self.n, self.m)]
        kinds = ["f", "f", "f", "f", "i32", "i32", "i64", "i64", "u32", "b", "b"]
        shapes = [
            (),
            (self.n,),
            (self.m,),
            (self.n, self.m),
            (),
            (self.n,),
            (),
            (self.n, self.m),
            (self.n,),
            (),
            (self.n,),
        ]
        self.inputs = [Var(f"a{i}", k, s, size=5, fine=2) for i, (k, s) in enumerate(zip(kinds, shapes, strict=True))]
        self.seed = seed

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def one(self, choices: Any) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def fresh(self) -> str:
        self.count += 1
        return f"v{self.count}"

    def pick(self, env: list[Var], kind: str, shape: Any = None, exact: bool | None = None) -> Var:
        """A variable of this kind (and shape, or a scalar), late ones more often; made from an input where none is."""
        fits = [v for v in env if v.kind == kind and (shape is None or v.shape in (shape, ()))]
        fits = [v for v in fits if exact is None or v.exact == exact]
        if not fits:
            return Var(f"jnp.asarray(1, '{DTYPES[kind]}')", kind, (), size=1, fine=1)
        weights = np.arange(1, len(fits) + 1.0)
        return fits[int(self.rng.choice(len(fits), p=weights / weights.sum()))]

    def whole(self, v: Var, shape: tuple[int, ...]) -> str:
        """A variable in full shape."""
        return v.name if v.shape == shape else f"jnp.broadcast_to({v.name}, {shape})"

    def program(self) -> Program:
        """Statements until there are enough; the last variables and some others come out."""
        env, statements = list(self.inputs), []
        for _ in range(int(self.rng.integers(6, 16))):
            self.statement(env, statements, 0)
        made = env[len(self.inputs) :]
        few = {v.name: v for v in [*made[-5:], self.one(made), self.one(made)]}
        return Program(self.seed, self.inputs, statements, list(few.values()))

    def statement(self, env: list[Var], statements: list[tuple[str, str]], depth: int) -> None:
        """One more variable, or several that a branch or a loop gives."""
        if depth < 3 and self.chance(0.3 if depth == 0 else 0.22):
            self.one(FLOWS)(self, env, statements, depth)
            return
        text, var = self.one(EXPRESSIONS)(self, env)
        var = var._replace(name=self.fresh())
        if var.kind == "f":
            if var.exact and (var.size + var.fine > BITS or not np.isfinite(var.growth)):
                var = var._replace(exact=False)
            if not var.exact:
                text = f"jnp.clip({text}, -1.0, 1.0)"
                if var.growth > MOST_GROWTH:
                    return
        statements.append((var.name, text))
        env.append(var)


def random_program(seed: int) -> Program:
    """The program of a seed."""
    return Writer(seed).program()
