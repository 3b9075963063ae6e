"""The one place that reads what a jaxpr says: names and parameters of primitives as this version of JAX writes them."""

import os
from typing import Any, NamedTuple

import jax
import numpy as np
from jax._src import source_info_util
from jax.extend.core import ClosedJaxpr, Literal

jax.config.update("jax_enable_x64", True)

CALLS = {
    "jit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "remat2": "jaxpr",
}


class Scan(NamedTuple):
    """A scan: constants, carried values and slices, in this order, go into the body."""

    body: ClosedJaxpr
    constants: int
    carries: int
    length: int
    reverse: bool


class While(NamedTuple):
    """A while loop: constants of the test, constants of the body, carried values."""

    test: ClosedJaxpr
    test_constants: int
    body: ClosedJaxpr
    body_constants: int


def close_jaxpr(jaxpr: Any, consts: Any = ()) -> ClosedJaxpr:
    """A jaxpr with its constants."""
    return jaxpr if hasattr(jaxpr, "consts") else ClosedJaxpr(jaxpr, consts)


def called_program(equation: Any) -> ClosedJaxpr | None:
    """The program that an equation merely calls, or None."""
    key = CALLS.get(equation.primitive.name)
    return None if key is None else close_jaxpr(equation.params[key])


def scan_parameters(equation: Any) -> Scan:
    """Parameters of a scan."""
    p = equation.params
    return Scan(close_jaxpr(p["jaxpr"]), p["num_consts"], p["num_carry"], int(p["length"]), bool(p["reverse"]))


def while_parameters(equation: Any) -> While:
    """Parameters of a while loop."""
    p = equation.params
    return While(close_jaxpr(p["cond_jaxpr"]), p["cond_nconsts"], close_jaxpr(p["body_jaxpr"]), p["body_nconsts"])


def cond_branches(equation: Any) -> list[ClosedJaxpr]:
    """The branches of a cond; its first operand is the index of the one that is taken."""
    return [close_jaxpr(j) for j in equation.params["branches"]]


def literal_value(atom: Any) -> Any:
    """The number of a literal, or None for a variable."""
    return np.asarray(atom.val) if isinstance(atom, Literal) else None


def source_line(equation: Any) -> str | None:
    """file:line of the Python that made an equation, or None where all of it is JAX's own."""
    try:
        frame: Any = source_info_util.user_frame(equation.source_info.traceback)
    except (AttributeError, TypeError):
        frame = source_info_util.user_frame(equation.source_info)
    if frame is None:
        return None
    return f"{os.path.basename(frame.file_name)}:{frame.start_line}, in {frame.function_name}"


INDEXED_PRIMITIVES = ("dynamic_slice", "dynamic_update_slice", "gather")
INDEXED_PRIMITIVES += ("scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max")


def indexed_inputs(jaxpr: Any, skip: int = 0) -> set[int]:
    """Positions, counted after `skip`, of the inputs that are read or written at computed indices."""
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
    """The programs inside an equation, each with the operands that it is given, one for each of its inputs."""
    call = called_program(equation)
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
