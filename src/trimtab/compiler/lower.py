"""Lowering of a jaxpr to a program. Calls are inlined. A large array is changed in place if it is not read later.

A primitive without a rule raises InputError with its name, the Python line that made it, and an alternative.
"""

import math
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from trimtab import __version__
from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import Array, apply_updates, constant, is_small, store_in_memory, type_name
from trimtab.compiler.ir import TYPES, Builder
from trimtab.compiler.ranges import LONGEST_TABLE
from trimtab.core.errors import InputError

Rule = Callable[["Site"], list[Array]]

ALTERNATIVES = {
    "eig": "jnp.linalg.eigh for symmetric matrices, or compute the decomposition before the flight",
    "schur": "jnp.linalg.eigh for symmetric matrices, or compute the decomposition before the flight",
    "fft": "a sum of products with cosines and sines that are computed beforehand: jnp.cos(k n) @ x",
    "rng_bit_generator": "jax.random.key(seed) without impl, which uses the generator threefry",
    "reduce_window": "jax.lax.reduce_window with jax.lax.max and -jnp.inf, or jax.lax.add and 0.0, as Python numbers",
    "reduce": "jax.lax.fori_loop over the elements, or jnp.sum, prod, max, min, any and all",
    "reduce_precision": "x.astype(jnp.float32).astype(jnp.float64), which rounds to float32",
    "select_and_scatter_add": "x.reshape(-1, width).max(axis=1) for adjacent windows, whose gradient compiles to C",
    "select_and_gather_add": "x.reshape(-1, width).max(axis=1) for adjacent windows, whose derivative compiles to C",
    "approx_top_k": "jax.lax.top_k(x, k), which is exact",
    "pure_callback": "plain jax.numpy, because flight code cannot call Python",
    "io_callback": "a result of the function or a logged signal instead, because flight code cannot call Python",
    "debug_print": "a result of the function or a logged signal instead, because flight code cannot print",
    "debug_callback": "a result of the function or a logged signal instead, because flight code cannot print",
}


CONTROL = ("cond", "scan", "while")
"""Primitives that contain programs. Their rules move operands to memory if needed."""

UPDATING = ("dynamic_update_slice", "scatter")
"""Primitives that write elements of their first operand."""

CALLBACKS = ("pure_callback", "io_callback", "debug_callback", "debug_print")
"""Primitives that call Python code, which must not run while a program is lowered."""


class CompilerFaultError(InputError):
    """Error: trimtab's compiler failed on a program that it should have compiled or rejected."""


@contextmanager
def report_fault(what: str, where: Callable[[], str] | None = None) -> Iterator[None]:
    """Raise CompilerFaultError in place of an unexpected exception, with the information that a user should report.

    Args:
        what: text for the message: the thing being compiled.
        where: returns the user's line from which the failing program comes.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as reason:
        line = f" at {where()}" if where else ""
        versions = f"trimtab {__version__}, JAX {jax.__version__}, Python {platform.python_version()}"
        problem = f"trimtab failed on {what}{line} with {type(reason).__name__}: {reason} ({versions})"
        fix = "report this fault of trimtab with this message, the function, and the shapes and types of its example"
        raise CompilerFaultError("compiler", problem, fix=fix) from reason


class Site:
    """Equation of a jaxpr with its operands: the input of a rule."""

    def __init__(self, lowering: "Lowering", equation: Any, operands: list[Array], dying: list[bool]) -> None:
        self.lowering, self.equation, self.operands, self.dying = lowering, equation, operands, dying
        self.b: Builder = lowering.b
        self.params: dict[str, Any] = equation.params
        aval = equation.outvars[0].aval if equation.outvars else None
        self.shape: tuple[int, ...] = jaxprs.physical_shape(aval) if aval is not None else ()
        self.dtype: str = lowering.type_name(jaxprs.physical_type(aval)) if aval is not None else ""

    def inline(self, jaxpr: Any, operands: list[Array], dying: list[bool] | None = None) -> list[Array]:
        """Return the results of another program on these operands. dying: operands that may be changed in place."""
        return self.lowering.lower_program(jaxpr, operands, dying or [False] * len(operands))


class Lowering:
    """Lowering of jaxprs into a builder. rules: primitive name -> rule. real: "f64", or "f32" to replace float64."""

    def __init__(self, b: Builder, rules: dict[str, Rule], real: str = "f64") -> None:
        self.b, self.rules, self.real = b, rules, real
        self.around: list[Any] = []

    def source_line(self) -> str:
        """Return file:line of the innermost user Python that made the equation being lowered."""
        for equation in reversed(self.around):
            found = jaxprs.source_line(equation)
            if found is not None:
                return found
        return "a line inside JAX"

    def type_name(self, dtype: Any) -> str:
        """Return the compiler's short name of a JAX type, e.g. f64."""
        try:
            name = type_name(dtype)
        except (KeyError, TypeError):
            where = f", from {self.source_line()}," if self.around else ""
            kind = str(dtype)
            fix = "use float64, float32, integers or bool"
            if kind.startswith("complex"):
                fix = "compute with the real and the imaginary part as two arrays of float64"
            raise InputError("export", f"numbers of type {dtype}{where} cannot be written as C", fix=fix) from None
        return self.real if name == "f64" else name

    def check_sizes(self, variables: Any) -> None:
        """Raise InputError if an array has too many elements for a 32-bit index."""
        for shape in (jaxprs.physical_shape(v.aval) for v in variables):
            if math.prod(shape) >= 2**31:
                where = f", from {self.source_line()}," if self.around else ""
                problem = f"an array of shape {shape}{where} has {math.prod(shape)} elements"
                raise InputError("export", problem, fix="use arrays of fewer than 2**31 elements: an index has 32 bits")

    def new_array(self, aval: Any) -> Array:
        """Return a new buffer for an array of this abstract value."""
        dtype, shape = self.type_name(jaxprs.physical_type(aval)), jaxprs.physical_shape(aval)
        return Array(shape, dtype, buffer=self.b.local_buffer(dtype, math.prod(shape)))

    def lower_program(self, jaxpr: Any, operands: list[Array], dying: list[bool]) -> list[Array]:
        """Return the results of a closed jaxpr. dying: operands that are not read afterwards."""
        results = self._lower_equations(jaxpr, operands, dying)
        for k, (array, may_change) in enumerate(results):
            shared = any(array.buffer is other.buffer for i, (other, _) in enumerate(results) if i != k)
            if array.updates:
                results[k] = apply_updates(self.b, array, may_change and not shared), False
        return [array for array, _ in results]

    def _lower_equations(self, jaxpr: Any, operands: list[Array], dying: list[bool]) -> list[tuple[Array, bool]]:
        """Return the results, some with pending updates. A result is paired with True if its buffer may be changed."""
        inner = jaxpr.jaxpr
        env: dict[Any, Array] = {}
        doomed: dict[Any, bool] = {}
        for var, data in zip(inner.constvars, jaxpr.consts, strict=True):
            words = jax.random.key_data(data) if jaxprs.is_key(var.aval) else data
            env[var], doomed[var] = constant(self.b, words, self.type_name(words.dtype)), False
        for var, operand, dies in zip(inner.invars, operands, dying, strict=True):
            env[var], doomed[var] = operand, dies
        last = _last_uses(inner)
        for k, equation in enumerate(inner.eqns):
            self.around.append(equation)
            self.check_sizes(equation.outvars)
            given = [self._operand_array(a, env) for a in equation.invars]
            dies = [self._is_last_use(a, k, env, doomed, last) for a in equation.invars]
            for i, array in enumerate(given):
                if array.updates and not _takes_updates(equation, i):
                    alone = dies[i] and is_alone(given, i)
                    env[equation.invars[i]] = given[i] = apply_updates(self.b, array, alone)
            env.update(zip(equation.outvars, self._lower_equation(equation, given, dies), strict=True))
            self.around.pop()
        end = len(inner.eqns)
        return [(self._operand_array(a, env), self._is_last_use(a, end, env, doomed, last)) for a in inner.outvars]

    def _operand_array(self, atom: Any, env: dict[Any, Array]) -> Array:
        number = jaxprs.literal_value(atom)
        return env[atom] if number is None else constant(self.b, number, self.type_name(atom.aval.dtype))

    def _is_last_use(
        self, atom: Any, k: int, env: dict[Any, Array], doomed: dict[Any, bool], last: dict[Any, int]
    ) -> bool:
        """Return True if the buffer of an operand is not read after equation k, under any name."""
        if jaxprs.literal_value(atom) is not None:
            return False
        buffer = env[atom].buffer
        if buffer is None or buffer.is_read_only:
            return False
        names = [v for v, array in env.items() if array.buffer is buffer]
        return all(last.get(v, -1) <= k and doomed.get(v, True) for v in names)

    def _lower_equation(self, equation: Any, operands: list[Array], dying: list[bool]) -> list[Array]:
        with report_fault(f"primitive {equation.primitive.name!r}", self.source_line):
            return self._lower_checked(equation, operands, dying)

    def _lower_checked(self, equation: Any, operands: list[Array], dying: list[bool]) -> list[Array]:
        inner = jaxprs.program_of_call(equation)
        if inner is not None:
            return [array for array, _ in self._lower_equations(inner, operands, dying)]
        name = equation.primitive.name
        rule = self.rules.get(name)
        if rule is None and jaxprs.implementation(equation) is not None:
            return self._lower_foreign(equation, operands, dying)
        if rule is None:
            raise self.refusal(name)
        known = self._known_results(equation, operands)
        if known is not None:
            return known
        site = Site(self, equation, operands, dying)
        if name not in CONTROL:
            self._store_operands(equation, operands)
        return rule(site)

    def _known_results(self, equation: Any, operands: list[Array]) -> list[Array] | None:
        """Return the results if they are large integer or truth tables, computed from known tables. Else return None.

        Such tables are mostly indices. Floats are computed at run time, because elementary functions in C differ from
        JAX's in the last bit. Small results are left out, too: their scalars are folded one by one.
        """
        name = equation.primitive.name
        if not operands or not equation.outvars or name in CONTROL or name in CALLBACKS:
            return None
        shapes = [v.aval.shape for v in equation.outvars]
        if all(map(is_small, shapes)) or max(map(math.prod, shapes)) > LONGEST_TABLE:
            return None
        types = [getattr(v.aval, "dtype", None) for v in [*equation.outvars, *equation.invars]]
        if not all(isinstance(t, np.dtype) and t.kind in "biu" for t in types):  # a random key's type is JAX's
            return None
        tables = [_known_data(a) for a in operands]
        if any(t is None for t in tables):
            return None
        given = [np.reshape(t, a.shape).astype(TYPES[a.dtype]) for t, a in zip(tables, operands, strict=True)]
        with jax.ensure_compile_time_eval():  # also if `compile` is called while JAX traces
            found = equation.primitive.bind(*given, **equation.params)
        each = found if equation.primitive.multiple_results else [found]
        return [constant(self.b, np.asarray(x)) for x in each]

    def refusal(self, name: str) -> InputError:
        """Return the InputError for a primitive that cannot be written as C."""
        fix = ALTERNATIVES.get(name, "the function with primitives that trimtab.compiler.coverage lists")
        return InputError(
            "export", f"primitive {name!r}, from {self.source_line()}, cannot be written as C", fix=f"write {fix}"
        )

    def _lower_foreign(self, equation: Any, operands: list[Array], dying: list[bool]) -> list[Array]:
        """Return the results of a primitive of another package, from the JAX function that implements it."""
        compute, params = jaxprs.implementation(equation), equation.params
        shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars]
        return self.lower_program(jax.make_jaxpr(lambda *x: compute(*x, **params))(*shapes), operands, dying)

    def _store_operands(self, equation: Any, operands: list[Array]) -> None:
        """Put small operands in memory before the loop that the rule writes. Unused copies are removed later."""
        if all(is_small(v.aval.shape) for v in [*equation.outvars, *equation.invars]):
            return
        for array in operands:
            if array.size > 1:
                store_in_memory(self.b, array)


def _known_data(array: Array) -> Any:
    """Return the numbers of an array of constants, row-major, or None if an element is computed at run time."""
    if array.updates or array.offset is not None:
        return None
    if array.items is not None:
        values = array.items.ravel()
        return [v.const for v in values] if all(v.op == "const" for v in values) else None
    return array.buffer.data if array.buffer is not None and array.buffer.kind == "const" else None


def is_alone(operands: list[Array], which: int) -> bool:
    """Return True if no other operand of an equation is in the same buffer."""
    return not any(a.buffer is operands[which].buffer for i, a in enumerate(operands) if i != which)


def _takes_updates(equation: Any, operand: int) -> bool:
    """Return True if the rule of an equation handles pending updates of this operand itself."""
    name = equation.primitive.name
    return jaxprs.program_of_call(equation) is not None or name == "select_n" or (name in UPDATING and operand == 0)


def _last_uses(jaxpr: Any) -> dict[Any, int]:
    """Return for each variable the number of the last equation that reads it. Results are read after all equations."""
    last: dict[Any, int] = {}
    for k, equation in enumerate(jaxpr.eqns):
        for atom in equation.invars:
            if jaxprs.literal_value(atom) is None:
                last[atom] = k
    for atom in jaxpr.outvars:
        if jaxprs.literal_value(atom) is None:
            last[atom] = len(jaxpr.eqns)
    return last
