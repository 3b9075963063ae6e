"""Check that the parts of a loop fit each other, from the shapes of the data that they exchange. No part is run.

Error messages name the two parts that do not fit each other.
"""

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import FrozenInstanceError
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Quantity, Scalar, is_record, leaves
from trimtab.core.signals import Motion
from trimtab.loop.own_code import PARTS, check_arguments, describe_fault, place_of, refuse_own_code, refuse_within

ARGUMENTS = {
    "step": "t, state, input",
    "dynamics": "t, x, u",
    "motion": "t, x, u",
    "events": "t, x",
    "jump": "t, x, crossed",
    "after_step": "t, x",
}
"""Arguments that the methods of a user's part must have, by the method's name."""
MESSAGES = {"Sample": "new_sample(t, VALUE)", "Estimate": "Estimate(t=t, age=…, fresh=…, valid=…, state=…)"}
"""Class of a message -> code that makes a message."""


def zeros_of(part: str, reads: str, function: Callable[..., Any], *inputs: Any) -> Any:
    """Return the structure of a function's output, with every number zero. The function is traced, but not run.

    part: path of the part to which the function belongs.  reads: path of the part that provides its input.

    Raises: InputError, with both parts and the faulty line, if the function cannot process these inputs.
    """
    own = getattr(function, "__name__", "")
    if own in ARGUMENTS:
        check_arguments(part, function, ARGUMENTS[own], *inputs)
    try:
        shape = jax.eval_shape(_share_trace(function), *inputs)
    except InputError as error:
        raise refuse_within(error) from error
    except Exception as error:
        is_of_input = isinstance(error, AttributeError) and not isinstance(error, FrozenInstanceError)
        if place_of(function) and not is_of_input:
            raise refuse_own_code(part, error) from error
        fault = describe_fault(error)
        lacking = getattr(error, "obj", None)
        name = type(lacking if is_record(lacking) else inputs[-1]).__name__ if inputs else "nothing"
        problem = f"does not fit {reads}, which provides {name}: {fault.place}{fault.problem}"
        other = f"give {part} an input with the fields that it reads, or use another part that reads {name}"
        fix = fault.fix or (f"read one of these, or add the missing field to {name}" if place_of(function) else other)
        raise InputError(part, problem, choices=fault.choices, fix=fix) from error
    return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape)


def step_part(part: Any, t: Any, state: Any, given: Any) -> Any:
    """Return part.step(t, state, given).

    JAX traces the step only once for inputs of the same structure: `zeros_of` and the loop share the trace. The
    equations are the same as those of a plain call. If an input is a constant or no trace is active, this is a plain
    call.
    """
    is_traced = all(isinstance(v, Tracer) for v in jax.tree.leaves((part, t, state, given)))
    return (_trace_step if is_traced else type(part).step)(part, t, state, given)


@functools.partial(jax.jit, inline=True)
def _trace_step(part: Any, t: Any, state: Any, given: Any) -> Any:
    return part.step(t, state, given)


def _share_trace(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function itself. For the step() of a record, return the call whose trace the loop uses again."""
    owner = getattr(function, "__self__", None)
    if getattr(function, "__name__", "") != "step" or not is_record(owner):
        return function
    return lambda t, state, given: step_part(owner, *strengthen_types((t, state, given)))


def zeros_of_step(part: str, reads: str, step: Callable[..., Any], *inputs: Any) -> tuple[Any, Any]:
    """Return the structures of the state and the output that a step() returns, with every number zero.

    Raise InputError if the step does not return such a pair.
    """
    pair = zeros_of(part, reads, step, *inputs)
    if not isinstance(pair, tuple) or len(pair) != 2:  # pyright: ignore[reportUnknownArgumentType]
        problem = f"{place_of(step)}its step() must return (state, output), got {describe_tree(pair)}"
        raise InputError(part, problem, fix="return (state, output) from step()")
    state, output = pair  # pyright: ignore[reportUnknownVariableType]
    return state, output


def first_state(part: str, init: Callable[..., Any], key: Any) -> Any:
    """Return the initial state of a part. Raise InputError, with the faulty line, if the part's init() fails."""
    check_arguments(part, init, "key", key)
    try:
        return init(key)
    except InputError as error:
        raise refuse_within(error) from error
    except Exception as error:
        raise refuse_own_code(part, error) from error


def check_state(part: str, step: Callable[..., Any], after: Any, first: Any) -> None:
    """Raise InputError if the states that step() and init() return have different structures.

    A float in the state from step() in place of an integer in the state from init() is also an error.
    """
    what = f"{place_of(step)}the state that step() returns"
    check_alike(
        part,
        what,
        after,
        first,
        "return (state, output) from step(), with a state of the same structure as from init()",
    )
    for own, wanted in zip(jax.tree.leaves(after), jax.tree.leaves(first), strict=True):
        kinds = [jnp.issubdtype(jnp.result_type(v), jnp.inexact) for v in (own, wanted)]
        if kinds == [True, False]:
            problem = f"{what} has a float in place of an integer in the state that init() returns"
            raise InputError(part, problem, fix="write 0.0 instead of 0 in init()")


def check_members(part: str, value: Any, interface: Any, optional: Iterable[str] = ()) -> None:
    """Raise InputError, with the code to write, if a part lacks a method or a field of its interface.

    optional: names of members that the part may lack.
    """
    check_record(part, value)
    for name in (*vars(interface), *interface.__annotations__):
        if name.startswith("_") or name in optional or hasattr(value, name):
            continue
        member, kind = vars(interface).get(name), type(value).__name__
        place = place_of(type(value))
        if inspect.isfunction(member):
            arguments = ", ".join(inspect.signature(member).parameters)
            raise InputError(part, f"{place}{kind} has no {name}()", fix=f"def {name}({arguments}): …  in {kind}")
        returned = getattr(member, "fget", None) or interface
        declared = returned.__annotations__.get("return" if returned is not interface else name)
        example = '("NAME", …)' if "tuple" in str(declared) else "…"
        fix = f"{name} = {example}  in {kind}: {_first_line(member)}".strip(": ")
        raise InputError(part, f"{place}{kind} has no {name!r}", fix=fix)


def check_record(part: str, value: Any) -> None:
    """Raise InputError for a class instead of an instance, and for a user's class without the decorator ``@record``."""
    kind = value if isinstance(value, type) else type(value)
    if isinstance(value, type):
        raise InputError(part, f"{kind.__name__} is a class, not a part", fix=f"{kind.__name__}(), with brackets")
    if value is None or kind.__module__.partition(".")[0] in ("builtins", "numpy", "jax", "jaxlib"):
        example = PARTS.get(part.rpartition(".")[2]) if value is None else None
        fix = f"write {example}" if example else "use a record of trimtab or of your own file, with brackets"
        raise InputError(part, f"must be a record, got {value!r:.60}", fix=fix)
    if jax.tree_util.all_leaves([value]):
        problem = f"{place_of(kind)}{kind.__name__} is not a record"
        raise InputError(
            part, problem, fix=f"write  @record  above  class {kind.__name__}  (from trimtab import record)"
        )


def check_vehicle(vehicle: Any, x: Any, u: Any) -> Any:
    """Return the structure of the vehicle's motion, with every number zero.

    Raise InputError if dynamics() or motion() is missing or returns a wrong structure.
    """
    for name in ("dynamics", "motion"):
        if not callable(getattr(vehicle, name, None)):
            problem = f"{place_of(type(vehicle))}{type(vehicle).__name__} has no {name}(t, x, u)"
            raise InputError(
                "world.vehicle", problem, fix=f"def {name}(self, t, x, u): …  in the vehicle (docs, Add a vehicle)"
            )
    motion = zeros_of("world.vehicle.motion", "the vehicle's state", vehicle.motion, 0, x, u)
    if motion is None:
        problem = f"{place_of(vehicle.motion)}motion() returns nothing"
        raise InputError("world.vehicle.motion", problem, fix="return replace(no_motion(), t=t, …)")
    if isinstance(motion, Motion):
        check_numbers("world.vehicle.motion", vehicle.motion, motion, Motion)
    part = "world.vehicle.dynamics"
    rate = zeros_of(part, "world.actuators", vehicle.dynamics, 0.0, x, u)
    fix = f"return {type(x).__name__}(…) with the derivative of each field"
    check_alike(part, f"{place_of(vehicle.dynamics)}its return value", rate, x, fix)
    _refuse_rounded_state(part, vehicle, rate, x)
    _check_events(vehicle, x)
    return motion


def _refuse_rounded_state(part: str, vehicle: Any, rate: Any, x: Any) -> None:
    """Raise InputError if an integer or a flag of the state has a real derivative: its integral would be rounded."""
    slopes = {path: value for path, value, _ in leaves(rate)} if is_record(rate) else {}
    for path, _, declared in leaves(x) if is_record(x) else ():
        is_real = not isinstance(declared, Quantity) or jnp.issubdtype(declared.dtype(), jnp.floating)
        if is_real or not jnp.issubdtype(jnp.result_type(slopes.get(path, 0)), jnp.floating):
            continue
        kind, place = f'kind="{declared.kind}"', place_of(vehicle.dynamics)
        problem = f"{place}{type(x).__name__}.{path} has {kind}, but its derivative is a real number, which is rounded"
        fix = f"leave {kind} out; for a mode that only jump() changes, return the integer 0 as its derivative"
        raise InputError(part, problem, fix=fix)


def _check_events(vehicle: Any, x: Any) -> None:
    """Raise InputError if events(), jump() or after_step() of a vehicle returns a wrong structure."""
    own, reads = {n: optional_member(vehicle, n) for n in ("events", "jump", "after_step")}, "the vehicle's state"
    after = []
    if own["events"] is not None:
        part = "world.vehicle.events"
        values = jax.tree.leaves(zeros_of(part, reads, own["events"], 0.0, x))
        if not values:
            problem = f"{place_of(own['events'])}events() returns nothing"
            raise InputError(part, problem, fix="return a number that changes its sign at the event, e.g. x.height")
        if own["jump"] is not None:
            after.append(("jump", np.zeros(sum(map(np.size, values)), np.bool_)))
    if own["after_step"] is not None:
        after.append(("after_step",))
    for name, *crossed in after:
        part = f"world.vehicle.{name}"
        state = zeros_of(part, reads, own[name], 0.0, x, *crossed)
        what = f"{place_of(own[name])}its return value"
        check_alike(part, what, state, x, f"return replace(x, …), a {type(x).__name__}")


def check_output(part: str, step: Callable[..., Any], output: Any, kind: type) -> None:
    """Raise InputError unless the output of a step() is a record with all fields of the class `kind` and valid numbers.

    The record may have further fields, e.g. the covariance of a filter.
    """
    if not (is_record(output) and kind.__dataclass_fields__.keys() <= output.__dataclass_fields__.keys()):
        name = kind.__name__
        problem = f"{place_of(step)}step() must return (state, {name}), but its output is {describe_tree(output)}"
        raise InputError(part, problem, fix=f"return state, {MESSAGES[name]}")
    check_numbers(part, step, output, kind)


def check_numbers(part: str, function: Callable[..., Any], value: Any, kind: type) -> None:
    """Raise InputError if a number of a message has not the declared shape and type.

    Only numbers of the class `kind` are checked. Other numbers, e.g. of the bending modes in a Motion or of a filter's
    covariance, may have any shape.
    """
    for path, own, declared in leaves(value):
        if not isinstance(declared, Quantity) or path not in kind.__dataclass_fields__:
            continue
        what = f"{place_of(function)}{path} of the {type(value).__name__}"
        if np.shape(own) != declared.shape:
            problem = f"{what} has shape {np.shape(own)}, but the shape must be {declared.shape}"
            raise InputError(part, problem, fix=f"write {path}=… with an array of shape {declared.shape}")
        dtype = jnp.result_type(own)
        if declared.kind == "flag" and dtype != np.bool_:
            fix = f"write {path}=True, or a comparison such as x > 0"
            raise InputError(part, f"{what} must be True or False, but is a number", fix=fix)
        if declared.unit == "s" and not jnp.issubdtype(dtype, jnp.floating):
            fix = f"write {path}=to_seconds(…), from trimtab.core.time, or {path}=0.0"
            raise InputError(part, f"{what} must be a float in seconds, but is an integer", fix=fix)


def refuse_missing_numbers(part: str, step: Callable[..., Any], output: Any) -> None:
    """Raise InputError if a declared number of a law's output is None."""
    for path, value, declared in leaves(output):
        if isinstance(declared, Quantity) and value is None:
            problem = f"{place_of(step)}{path} of the {type(output).__name__} is None, but must be a number"
            raise InputError(part, problem, fix=f"return {path}=0.0, or remove the field")


def _first_line(member: Any) -> str:
    return (getattr(member, "__doc__", "") or "").partition("\n")[0]


def check_alike(part: str, what: str, value: Any, like: Any, fix: str) -> None:
    """Raise InputError unless a value has the same structure as `like`, with numbers of the same shapes."""
    if jax.tree.structure(value) != jax.tree.structure(like):
        raise InputError(part, f"{what} is {describe_tree(value)}, but must be {describe_tree(like)}", fix=fix)
    pairs = zip(jax.tree_util.tree_flatten_with_path(like)[0], jax.tree.leaves(value), strict=True)
    for (keys, wanted), own in pairs:
        name, shape = jax.tree_util.keystr(keys, simple=True, separator="."), np.shape(wanted)
        if np.shape(own) != shape and (len(np.shape(own)) > len(shape) or not _fits(np.shape(own), shape)):
            problem = f"{what} has {name or 'a number'} of shape {np.shape(own)}, but the shape must be {shape}"
            raise InputError(part, problem, fix=fix)


def _fits(shape: tuple[int, ...], whole: tuple[int, ...]) -> bool:
    return all(a in (1, b) for a, b in zip(reversed(shape), reversed(whole), strict=False))


def describe_tree(tree: Any) -> str:
    """Return a description of a value for messages: the class of a record, or the shape or the number of numbers."""
    if is_record(tree):
        return f"a {type(tree).__name__} as declared"
    if isinstance(tree, Mapping):
        names: Any = tree.keys()  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
        return f"a dictionary of {', '.join(map(str, names)) or 'nothing'}"
    count = len(jax.tree.leaves(tree))
    if isinstance(tree, tuple | list) and count:
        return f"a {type(tree).__name__} with {count} number{'s' * (count != 1)}"
    return (f"an array of shape {np.shape(tree)}" if np.ndim(tree) else "a number") if count else "nothing"


def zeros_like(tree: Any) -> Any:
    """Return a copy of a tree of arrays, with all numbers zero. The leaves may also be descriptions of arrays."""
    return jax.tree.map(lambda v: np.zeros(np.shape(v), jnp.result_type(v)), tree)


def step_if(due: Scalar, step: Callable[[], Any], hold: Callable[[], Any]) -> Any:
    """Return step() if `due` is true, else hold(). If `due` is the Python value True, step() is called directly."""
    if due is True:
        return step()
    return jax.lax.cond(due, lambda: strengthen_types(step()), lambda: strengthen_types(hold()))


def strengthen_types(tree: Any) -> Any:
    """Return the tree with every number as an array of fixed data type, as loops in JAX require."""

    def fix(leaf: Any) -> Any:
        return jax.lax.convert_element_type(leaf, np.dtype(jnp.result_type(leaf)))

    return jax.tree.map(fix, tree)


def cast_like(tree: Any, pattern: Any) -> Any:
    """Return the tree with every number converted to the data type of the corresponding number in `pattern`."""
    return jax.tree.map(lambda a, b: jnp.asarray(a, jnp.result_type(b)), tree, pattern)


def is_finite(tree: Any) -> Scalar:
    """Return True if every real number of a tree is finite."""
    floats = [v for v in map(jnp.asarray, jax.tree.leaves(tree)) if jnp.issubdtype(v.dtype, jnp.floating)]
    finite = jnp.asarray(True)
    for v in floats:
        finite = finite & jnp.all(jnp.isfinite(v))
    return finite
