"""Reader of jaxprs: the only module that depends on what differs between versions of JAX.

A version or a form of a program that this module does not know is an InputError with the version.
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
"""Versions of JAX that this module can read, as in pyproject.toml."""


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

# After the check: these have other names in other versions.
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
    """Scan: constants, carried values and slices, in this order, are the inputs of the body."""

    body: ClosedJaxpr
    constants: int
    carries: int
    length: int
    reverse: bool


class While(NamedTuple):
    """While loop: constants of the test, constants of the body, carried values."""

    test: ClosedJaxpr
    test_constants: int
    body: ClosedJaxpr
    body_constants: int


def _reader(read: Callable[[Any], T]) -> Callable[[Any], T]:
    """Make a function that reads the parameters of an equation raise InputError for a form that it does not know."""

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
    """Return a primitive's name; closed_call, which JAX from 0.11 on names eval_jaxpr, keeps its old name."""
    return "closed_call" if primitive is PRIMITIVES.closed_call_p else primitive.name


def close_jaxpr(jaxpr: Any, consts: Any = ()) -> ClosedJaxpr:
    """Return a jaxpr with its constants."""
    return jaxpr if hasattr(jaxpr, "consts") else ClosedJaxpr(jaxpr, consts)


@_reader
def program_of_call(equation: Any) -> ClosedJaxpr | None:
    """Return the program that an equation merely calls, or None."""
    key = CALLS.get(primitive_name(equation.primitive))
    return None if key is None else close_jaxpr(equation.params[key])


@_reader
def linear_solution(equation: Any) -> tuple[ClosedJaxpr, int, int]:
    """Return the solving program of a custom_linear_solve, and the range of operands that are its constants."""
    lengths, programs = equation.params["const_lengths"], equation.params["jaxprs"]
    first = lengths.matvec + lengths.vecmat
    return close_jaxpr(programs.solve), first, first + lengths.solve


@_reader
def right_side_count(equation: Any) -> int:
    """Return the number of arrays on the right side of a custom_linear_solve."""
    return len(equation.invars) - sum(equation.params["const_lengths"])


@_reader
def platform_position(equation: Any) -> int:
    """Return the branch of lax.platform_dependent for a CPU."""
    platforms = equation.params["platforms"]
    chosen = [i for i, names in enumerate(platforms) if names is not None and "cpu" in names]
    return chosen[0] if chosen else platforms.index(None)


SPECIAL_FUNCTIONS = ("igamma", "igammac", "igamma_grad_a", "regularized_incomplete_beta", "bessel_i0e")
"""Return the primitives that JAX compiles by a program of its own."""


def special_function(name: str) -> Any:
    """Return the program of JAX for a special function, on arrays of one shape."""
    program = getattr(SPECIAL, f"{name}_impl")
    return program if name == "bessel_i0e" else lambda *x: program(*x, dtype=x[0].dtype)


def draw_gamma(key: Any, shape: Any, *, log_space: bool) -> Any:
    """Return JAX's own program of random_gamma: Marsaglia and Tsang's method, one number after the other."""
    return RANDOM._gamma_impl(key, shape, log_space=log_space)


@_reader
def raises_of_equinox(equation: Any) -> bool:
    """Return True if a pure_callback comes from equinox.error_if, which only raises an error."""
    called = getattr(equation.params["callback"], "callback_func", None)
    return getattr(called, "__module__", None) == "equinox._errors"


def is_key(aval: Any) -> bool:
    """Return True if an array holds keys of jax.random."""
    return bool(jax.numpy.issubdtype(aval.dtype, jax.dtypes.prng_key))


def physical_shape(aval: Any) -> tuple[int, ...]:
    """Return the shape of an array in memory: a key has an axis of words."""
    return (*aval.shape, *aval.dtype._impl.key_shape) if is_key(aval) else aval.shape


def physical_type(aval: Any) -> Any:
    """Return the type of an array in memory."""
    return np.dtype(np.uint32) if is_key(aval) else aval.dtype


@_reader
def key_implementation(equation: Any) -> Any:
    """Return the generator of random numbers that an equation names, or of its keys."""
    return equation.params["impl"] if "impl" in equation.params else equation.invars[0].aval.dtype._impl


def _expand(*operands: Any, _prim: Any) -> Any:
    return jax.tree.leaves(_prim.expand(*jax.tree.unflatten(_prim.in_tree, operands)))


NEWER = {
    "call_hi_primitive": _expand,
    "log2": lambda x, accuracy=None: lax.log(x) / np.asarray(np.log(2.0), x.dtype),
}


def implementation(equation: Any) -> Any:
    """Return the JAX function for a primitive of another package, or None for JAX's own.

    Of JAX's own there are two from 0.11 on that were made of others before: log2, and searchsorted as a whole.
    """
    if equation.primitive.name in NEWER:
        return NEWER[equation.primitive.name]
    impl = equation.primitive.impl
    own = getattr(impl, "func", impl)
    return None if getattr(own, "__module__", "jax").split(".")[0] in ("jax", "jaxlib") else impl


@_reader
def scan_parameters(equation: Any) -> Scan:
    """Return the parameters of a scan. JAX from 0.11 on has constants, carries, slices as a tree, before as counts."""
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
    """Return the branches of a cond; its first operand is the index of the one that is taken."""
    return [close_jaxpr(j) for j in equation.params["branches"]]


def literal_value(atom: Any) -> Any:
    """Return the number of a literal, or None for a variable."""
    return np.asarray(atom.val) if isinstance(atom, Literal) else None


def source_line(equation: Any) -> str | None:
    """Return file:line of the Python that made an equation, or None if it is all JAX's own, or the compiler's."""
    frame: Any = SOURCES.user_frame(equation.source_info.traceback)
    if frame is None or frame.file_name.startswith(OWN_FOLDER):
        return None
    return f"{os.path.abspath(frame.file_name)}:{frame.start_line}, in {frame.function_name}"


INDEXED_PRIMITIVES = ("dynamic_slice", "dynamic_update_slice", "gather")
INDEXED_PRIMITIVES += ("scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max")


def indexed_inputs(jaxpr: Any, skip: int = 0) -> set[int]:
    """Return positions, counted after `skip`, of the inputs that are read or written at computed indices."""
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
    """Return the programs inside an equation, each with its operands, one for each of its inputs."""
    call = program_of_call(equation)
    if call is not None:
        return [(call.jaxpr, equation.invars)]
    name = equation.primitive.name
    if name == "cond":
        return [(j.jaxpr, equation.invars[1:]) for j in cond_branches(equation)]
    if name == "scan":
        # slices are one axis shorter inside: whether they are indexed there says nothing of the whole
        p = scan_parameters(equation)
        return [(p.body.jaxpr, equation.invars[: p.constants + p.carries])]
    if name == "while":
        w = while_parameters(equation)
        return [(w.body.jaxpr, equation.invars[w.test_constants :])]
    return []
