"""Reader of jaxprs: the only module that depends on differences between versions of JAX.

An unsupported version of JAX, or a jaxpr of unknown form, raises InputError with the version.
"""

import functools
import os
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal

from trimtab.core.errors import InputError, install_command

T = TypeVar("T")

SUPPORTED = "jax>=0.10,!=0.10.2,<0.13"
"""Versions of JAX that this module supports, as in pyproject.toml."""


def version_error(problem: str) -> InputError:
    """Return the error about a version of JAX, with the command that installs a supported one."""
    command = install_command(package=f'"{SUPPORTED}"')
    return InputError(f"JAX {jax.__version__}", problem, fix=f"install a supported version: {command}")


def check_version(version: tuple[int, ...]) -> None:
    """Raise InputError for a version of JAX that is not supported."""
    if version == (0, 10, 2):
        raise version_error("this version computes wrong numbers on CPUs (jax-ml/jax#39103)")
    if not (0, 10) <= version < (0, 13):
        raise version_error(f"trimtab does not support this version; it must satisfy {SUPPORTED}")


check_version(jax.__version_info__)

# These modules are imported after the check, because they have other names in other versions of JAX.
PRIMITIVES: Any = import_module("jax.extend.core.primitives")
SPECIAL: Any = import_module("jax._src.lax.special")
SOURCES: Any = import_module("jax._src.source_info_util")
RANDOM: Any = import_module("jax._src.random")
if hasattr(RANDOM, "__path__"):  # a module up to JAX 0.10.1, then a package
    RANDOM = import_module("jax._src.random.core")

OWN_FOLDER = os.path.dirname(__file__)
CALLS = {
    "jit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "remat2": "jaxpr",
}


class Scan(NamedTuple):
    """Parameters of a scan. The inputs of its body are constants, carried values and slices, in this order."""

    body: ClosedJaxpr
    constants: int
    carries: int
    length: int
    reverse: bool


class While(NamedTuple):
    """Parameters of a while loop. Its operands are constants of the test, constants of the body, and carried values."""

    test: ClosedJaxpr
    test_constants: int
    body: ClosedJaxpr
    body_constants: int


def _reader(read: Callable[[Any], T]) -> Callable[[Any], T]:
    """Return a reader of an equation's parameters that raises InputError if the parameters have an unknown form."""

    @functools.wraps(read)
    def read_form(equation: Any) -> T:
        try:
            return read(equation)
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as reason:
            names = ", ".join(sorted(equation.params))
            form = f"the parameters {names} of {equation.primitive.name!r} have an unknown form"
            raise version_error(f"{form} ({type(reason).__name__}: {reason})") from reason

    return read_form


def primitive_name(primitive: Any) -> str:
    """Return a primitive's name. closed_call keeps this name, although JAX names it eval_jaxpr from 0.11 on."""
    return "closed_call" if primitive is PRIMITIVES.closed_call_p else primitive.name


def close_jaxpr(jaxpr: Any, consts: Any = ()) -> ClosedJaxpr:
    """Return a closed jaxpr: the jaxpr with its constants."""
    return jaxpr if hasattr(jaxpr, "consts") else ClosedJaxpr(jaxpr, consts)


@_reader
def program_of_call(equation: Any) -> ClosedJaxpr | None:
    """Return the program that an equation calls, or None if the equation is not a call."""
    key = CALLS.get(primitive_name(equation.primitive))
    return None if key is None else close_jaxpr(equation.params[key])


@_reader
def linear_solution(equation: Any) -> tuple[ClosedJaxpr, int, int]:
    """Return the solver of a custom_linear_solve, and the range (first, end) of its constants among the operands."""
    lengths, programs = equation.params["const_lengths"], equation.params["jaxprs"]
    first = lengths.matvec + lengths.vecmat
    return close_jaxpr(programs.solve), first, first + lengths.solve


@_reader
def right_side_count(equation: Any) -> int:
    """Return the number of arrays on the right side of a custom_linear_solve."""
    return len(equation.invars) - sum(equation.params["const_lengths"])


@_reader
def platform_position(equation: Any) -> int:
    """Return the position of the branch of lax.platform_dependent that a CPU takes."""
    platforms = equation.params["platforms"]
    chosen = [i for i, names in enumerate(platforms) if names is not None and "cpu" in names]
    return chosen[0] if chosen else platforms.index(None)


SPECIAL_FUNCTIONS = ("igamma", "igammac", "igamma_grad_a", "regularized_incomplete_beta", "bessel_i0e")
"""Primitives that JAX computes by a program written in JAX."""


def special_function(name: str) -> Any:
    """Return JAX's program for a special function. Its operands must have the same shape."""
    program = getattr(SPECIAL, f"{name}_impl")
    return program if name == "bessel_i0e" else lambda *x: program(*x, dtype=x[0].dtype)


def draw_gamma(key: Any, shape: Any, *, log_space: bool) -> Any:
    """Draw from the gamma distribution with JAX's own program: Marsaglia and Tsang's method, one number at a time."""
    return RANDOM._gamma_impl(key, shape, log_space=log_space)


@_reader
def raises_of_equinox(equation: Any) -> bool:
    """Return True if a pure_callback comes from equinox.error_if, which only raises an error."""
    called = getattr(equation.params["callback"], "callback_func", None)
    return getattr(called, "__module__", None) == "equinox._errors"


def is_key(aval: Any) -> bool:
    """Return True if an array contains random keys (jax.random.key)."""
    return bool(jax.numpy.issubdtype(aval.dtype, jax.dtypes.prng_key))


def wrap_words(words: Any, dtype: Any) -> Any:
    """Return random keys of the type `dtype` from their words, as `jax.random.key_data` gives them."""
    return jax.random.wrap_key_data(words, impl=dtype._impl)


def words_of(keys: Any) -> Any:
    """Return the words of random keys, as `jax.random.key_data` does, without starting a computation of JAX."""
    return keys._base_array if hasattr(keys, "_base_array") else jax.random.key_data(keys)


def physical_shape(aval: Any) -> tuple[int, ...]:
    """Return the shape of an array in memory. An array of random keys has an additional axis for the words of a key."""
    return (*aval.shape, *aval.dtype._impl.key_shape) if is_key(aval) else aval.shape


def physical_type(aval: Any) -> Any:
    """Return the type of an array's numbers in memory: uint32 for random keys."""
    return np.dtype(np.uint32) if is_key(aval) else aval.dtype


@_reader
def key_implementation(equation: Any) -> Any:
    """Return the random generator that an equation names, or the generator of its keys if it names none."""
    return equation.params["impl"] if "impl" in equation.params else equation.invars[0].aval.dtype._impl


def _expand(*operands: Any, _prim: Any) -> Any:
    return jax.tree.leaves(_prim.expand(*jax.tree.unflatten(_prim.in_tree, operands)))


NEWER = {
    "call_hi_primitive": _expand,
    "log2": lambda x, accuracy=None: lax.log(x) / np.asarray(np.log(2.0), x.dtype),
}


def implementation(equation: Any) -> Any:
    """Return the JAX function that computes a primitive of another package, or None for a primitive of JAX.

    Two primitives of JAX have a function here: log2, and call_hi_primitive (searchsorted). They are new in 0.11. Before
    0.11, JAX composed them of other primitives.
    """
    if equation.primitive.name in NEWER:
        return NEWER[equation.primitive.name]
    impl = equation.primitive.impl
    own = getattr(impl, "func", impl)
    return None if getattr(own, "__module__", "jax").split(".")[0] in ("jax", "jaxlib") else impl


@_reader
def scan_parameters(equation: Any) -> Scan:
    """Return the parameters of a scan. From 0.11 on, JAX groups the inputs in a tree. Earlier versions state the number
    of inputs in each group."""
    p = equation.params
    if "ft_in" in p:
        constants, carries, _ = (len(list(part)) for part in p["ft_in"].unpack())
    else:
        constants, carries = p["num_consts"], p["num_carry"]
    return Scan(close_jaxpr(p["jaxpr"]), constants, carries, int(p["length"]), bool(p["reverse"]))


@_reader
def while_parameters(equation: Any) -> While:
    """Return the parameters of a while loop."""
    p = equation.params
    return While(close_jaxpr(p["cond_jaxpr"]), p["cond_nconsts"], close_jaxpr(p["body_jaxpr"]), p["body_nconsts"])


@_reader
def cond_branches(equation: Any) -> list[ClosedJaxpr]:
    """Return the branches of a cond. The first operand of the cond is the index of the branch that is taken."""
    return [close_jaxpr(j) for j in equation.params["branches"]]


def literal_value(atom: Any) -> Any:
    """Return the value of a literal, or None for a variable."""
    return np.asarray(atom.val) if isinstance(atom, Literal) else None


def source_line(equation: Any) -> str | None:
    """Return file:line of the user's Python that made an equation, or None if only JAX or this compiler made it."""
    frame: Any = SOURCES.user_frame(equation.source_info.traceback)
    if frame is None or frame.file_name.startswith(OWN_FOLDER):
        return None
    return f"{os.path.abspath(frame.file_name)}:{frame.start_line}, in {frame.function_name}"


INDEXED_PRIMITIVES = ("dynamic_slice", "dynamic_update_slice", "gather")
INDEXED_PRIMITIVES += ("scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max")


def indexed_inputs(jaxpr: Any, skip: int = 0) -> set[int]:
    """Return the positions, counted from input `skip`, of the inputs that are read or written at computed indices."""
    found: set[Any] = set()
    for equation in jaxpr.eqns:
        if equation.primitive.name in INDEXED_PRIMITIVES:
            found |= {a for a in equation.invars[:1] if literal_value(a) is None}
            continue
        for inner, operands in _inner_programs(equation):
            hit = indexed_inputs(inner)
            found |= {a for i, a in enumerate(operands) if i in hit and literal_value(a) is None}
    return {i - skip for i, v in enumerate(jaxpr.invars) if v in found and i >= skip}


def _inner_programs(equation: Any) -> list[tuple[Any, Any]]:
    """Return the programs inside an equation, each with the operands that the equation passes to the program's
    inputs."""
    call = program_of_call(equation)
    if call is not None:
        return [(call.jaxpr, equation.invars)]
    name = equation.primitive.name
    if name == "cond":
        return [(j.jaxpr, equation.invars[1:]) for j in cond_branches(equation)]
    if name == "scan":
        # slices are left out: inside they have one axis less, so an index into a slice is not an index into the array
        p = scan_parameters(equation)
        return [(p.body.jaxpr, equation.invars[: p.constants + p.carries])]
    if name == "while":
        w = while_parameters(equation)
        return [(w.body.jaxpr, equation.invars[w.test_constants :])]
    return []
