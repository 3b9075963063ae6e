"""Model of a compiled block for an FMU: the variables, and the text of model.h, by which `fmi/fmu.h` accesses the
variables.

Variables are named as in settings and logs: parameters `autopilot.law.k1`, signals `command.value.FX`.
"""

import math
import re
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.block import BlockDefinition, BlockText
from trimtab.compiler.structs import Member
from trimtab.core.errors import InputError
from trimtab.core.time import timetable
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import autopilot_block, loop_block, world_block

TYPES = ("f64", "f32", "i32", "i64", "u32", "bool")
UNSTAMPED = -(2**63)
"""Time stamp of a sample or command whose time the importing tool has not set. Such a sample or command counts as
current."""
SPLIT_AT = 256
"""Maximum number of elements of a parameter in FMI 2.0, where each element becomes a variable. A larger parameter is
left out."""


class FmuVariable(NamedTuple):
    """Variable of an FMU. place: path of the variable in the C structure model_data.  start: start value, or None for
    an output."""

    name: str
    place: str
    member: Member
    role: str
    start: Any

    @property
    def dtype(self) -> str:
        """Return the short name of the variable's number type, e.g. f64."""
        return self.member.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of the variable, which is () for a single number."""
        return self.member.shape


class FmuModel(NamedTuple):
    """Part of a scenario that becomes an FMU.

    definition: definition of the part's block.
    prefix: text that is prepended to a parameter's path in the block. The result is the parameter's path as a setting.
    name_input: function from the path of an input in the block to the name of the FMU's variable, or to None for an
    input that the FMU sets itself.
    begin, advance: bodies of the C functions model_begin and model_advance.
    step_s: recommended time between communication points (s).
    """

    definition: BlockDefinition
    prefix: str
    name_input: Callable[[str], str | None]
    begin: str
    advance: str
    step_s: float


AUTOPILOT_ADVANCE = """    const int64_t since = c->next;
    for (; c->next < until; c->next += PERIOD) {
        NAME_in in = d->in;
        in.t = c->next;
STAMPS        NAME_step(&d->p, &d->s, &in, &d->out@);
    }
    (void)since;
"""
LOOP_ADVANCE = """    while (c->next <= until) {
        d->in.t = c->next;
        d->in.h = model_next(c->next) - c->next;
        NAME_step(&d->p, &d->s, &d->in, &d->out@);
        c->next += d->in.h;
    }
"""
VEHICLE_BEGIN = """    NAME_in in = d->in;
    in.t = in.h = 0;
    in.first = true;
    NAME_step(&d->p, &d->s, &in, &d->out@);
"""
VEHICLE_ADVANCE = """    const int64_t since = c->next;
    for (int64_t after; (after = model_next(c->next)) <= until; c->next = after) {
        NAME_in in = d->in;
        in.t = c->next;
        in.h = after - c->next;
        if (in.command.t == FMU_UNSTAMPED)
            in.command.t = since;
        in.fresh = in.command.t != c->seen;
        c->seen = in.command.t;
        NAME_step(&d->p, &d->s, &in, &d->out@);
    }
"""
STAMP = """        if (in.SAMPLE.t == FMU_UNSTAMPED) {
            in.SAMPLE.t = since;
            in.SAMPLE.age = (REAL)((double)(c->next - since) * 1e-7);
            in.SAMPLE.fresh = c->next == since;
        }
"""
NEXT_INSTANT = """/* The instant after t: the next at which a period is due, gaps of more than MAX_STEP split evenly. */
static int64_t model_next(int64_t t)
{
    static const int64_t periods[] = {PERIODS};
    int64_t last = 0, due = INT64_MAX;
    for (size_t i = 0; i < sizeof periods / sizeof periods[0]; i++) {
        const int64_t before = t / periods[i] * periods[i];
        last = before > last ? before : last;
        due = before + periods[i] < due ? before + periods[i] : due;
    }
    const int64_t parts = (due - last + MAX_STEP - 1) / MAX_STEP;
    for (int64_t k = 1; k < parts; k++)
        if (last + k * (due - last) / parts > t)
            return last + k * (due - last) / parts;
    return due;
}
"""


def fmu_model(scenario: Scenario, part: str, seed: int = 0) -> FmuModel:
    """Return the model of a part of a checked scenario: "autopilot", "vehicle" (with world, sensors and links) or
    "loop"."""
    period = scenario.autopilot.period
    if part == "autopilot":
        stamps = AUTOPILOT_ADVANCE.replace("PERIOD", f"INT64_C({period})")
        block = autopilot_block(scenario, seed=seed)
        return FmuModel(block, "autopilot.", _name_sample, "", stamps, period * 1e-7)
    periods = frozenset([*scenario.world.periods(), period])
    if part == "vehicle":
        block = world_block(scenario, seed=seed)
        return FmuModel(block, "", _name_command, VEHICLE_BEGIN, VEHICLE_ADVANCE, period * 1e-7)
    # The set of periods that are due at every instant does not depend on the duration.
    always = timetable(periods, scenario.duration, scenario.world.max_step).always
    begin = "    model_advance(d, c, 0, w);\n"
    return FmuModel(loop_block(scenario, always, seed=seed), "", lambda p: None, begin, LOOP_ADVANCE, period * 1e-7)


def _name_sample(path: str) -> str | None:
    """Return the name of the vehicle's output that is connected to an input of the autopilot, if the input is part of a
    sample. For other inputs, return None."""
    return "downlink" + path.removeprefix("samples") if path.startswith("samples.") else None


def _name_command(path: str) -> str | None:
    return path if path.startswith("command.") else None


def fmu_variables(model: FmuModel, block: BlockText) -> list[FmuVariable]:
    """Return the variables of an FMU: first the parameters that the C code reads, then inputs, then outputs.

    Raises:
        InputError: a variable has a type that FMI does not have, or two variables have the same name.
    """
    values = [np.asarray(v) for v in jax.tree.leaves(model.definition.parameters)]
    begins, steps = _function_texts(block, "init"), _function_texts(block, "step")
    variables = []
    for m, value in zip(block.parameters, values, strict=True):
        role = "tunable" if _reads(steps, m) else "fixed"
        if m.size and (role == "tunable" or _reads(begins, m)):
            variables.append(FmuVariable(f"{model.prefix}{m.path}", f"p.{m.path}", m, role, value))
    for m in block.inputs:
        name = model.name_input(m.path)
        if name is not None and m.size:
            variables.append(FmuVariable(name, f"in.{m.path}", m, "input", _input_start(m)))
    variables += [FmuVariable(m.path, f"out.{m.path}", m, "output", None) for m in block.outputs if m.size]
    names = [v.name for v in variables]
    for v in variables:
        if v.dtype not in TYPES or names.count(v.name) > 1:
            problem = (
                f"the variable {v.name!r} is of type {v.dtype}"
                if v.dtype not in TYPES
                else f"two variables are named {v.name!r}"
            )
            raise InputError(
                "export --fmu",
                f"{problem}, which FMI does not allow",
                fix="export C code instead: type trimtab export without --fmu",
            )
    return variables


def split_variables(variables: Iterable[FmuVariable]) -> list[FmuVariable]:
    """Return the variables with each array split into scalar variables, as FMI 2.0 requires. Parameters with more than
    SPLIT_AT elements are left out."""
    single = []
    for v in variables:
        if not v.shape:
            single.append(v)
        elif v.role in ("input", "output") or v.member.size <= SPLIT_AT:
            flat = None if v.start is None else np.ravel(v.start)
            for k in range(v.member.size):
                member = v.member._replace(shape=())
                start = None if flat is None else flat[k]
                single.append(FmuVariable(f"{v.name}[{k}]", f"{v.place}[{k}]", member, v.role, start))
    return single


def model_header(
    model: FmuModel, block: BlockText, scenario: Scenario, variables: list[FmuVariable], token: str
) -> str:
    """Return the text of model.h, which connects the variables of an FMU with the C code of the block."""
    name, more = block.name, ", w" if block.workspace else ""
    real = "double" if all(m.dtype != "f32" for m in [*block.inputs, *block.parameters]) else "float"
    samples = [m.path.removesuffix(".age") for m in block.inputs if m.path.endswith(".age")]
    stamps = "".join(STAMP.replace("SAMPLE", s).replace("REAL", real) for s in samples)
    advance = model.advance.replace("STAMPS", stamps)
    starts = [
        f"    d->{v.place}{f'[{k}]' if v.shape else ''} = {_literal(x, v.dtype)};"
        for v in variables
        if v.role == "input"
        for k, x in enumerate(np.ravel(v.start))
        if x != 0
    ]
    parts = [
        f'#include "{name}.h"\n',
        f'#define MODEL_TOKEN "{token}"',
        f"#define MODEL_WORKSPACE {block.workspace}\n",
        f"typedef struct {{\n    {name}_params p;\n    {name}_state s;\n    {name}_in in;\n    {name}_out out;\n}} "
        "model_data;\n",
        _next_instant(scenario) if "model_next" in advance else "",
        f"static void model_defaults(model_data *d)\n{{\n    {name}_defaults(&d->p);",
        *starts,
        "}\n",
        "static void model_advance(model_data *d, fmu_clock *c, int64_t until, void *w)\n{",
        f"{advance}    (void)w;\n}}\n",
        "static void model_begin(model_data *d, fmu_clock *c, void *w)\n{",
        f"    memset(&d->s, 0, sizeof d->s);\n    {name}_init(&d->p, &d->s@);",
        f"{model.begin}    (void)c, (void)w;\n}}\n",
        "static const fmu_variable model_variables[] = {",
        *(f"    {_row_text(v)}," for v in variables),
        "};",
    ]
    return "\n".join(parts).replace("NAME", name).replace("@", more) + "\n"


def _next_instant(scenario: Scenario) -> str:
    periods = sorted({*scenario.world.periods(), scenario.autopilot.period})
    text = NEXT_INSTANT.replace("PERIODS", ", ".join(f"INT64_C({p})" for p in periods))
    return text.replace("MAX_STEP", f"INT64_C({scenario.world.max_step})")


def _row_text(v: FmuVariable) -> str:
    d = v.member.declaration
    low, strict = (
        (d.above, True) if d is not None and d.above is not None else (d.low if d is not None else None, False)
    )
    high = d.high if d is not None else None
    bounds = f"{_bound(low, '-')}, {_bound(high, '')}"
    kind, role = f"FMU_{v.dtype.upper()}", f"FMU_{v.role.upper()}"
    place = v.place + ("[0]" if v.shape else "")
    count = v.member.size
    return f'{{offsetof(model_data, {place}), {count}, {kind}, {role}, {str(strict).lower()}, {bounds}, "{v.name}"}}'


def _bound(value: float | None, sign: str) -> str:
    return f"{sign}INFINITY" if value is None or not math.isfinite(value) else repr(float(value))


def _literal(value: Any, dtype: str) -> str:
    if dtype == "bool":
        return str(bool(value)).lower()
    if dtype == "i64":
        return "FMU_UNSTAMPED" if int(value) == UNSTAMPED else f"INT64_C({int(value)})"
    return repr(float(value)) if dtype[0] == "f" else str(int(value))


def _input_start(m: Member) -> Any:
    """Return the start value of an input: the valid value closest to zero. A sample or command is valid and current at
    the start."""
    last = m.path.rpartition(".")[2]
    if m.dtype == "bool":
        return np.full(m.shape, last in ("valid", "fresh"))
    if m.dtype == "i64" and last == "t":
        return np.full(m.shape, UNSTAMPED, np.int64)
    d = m.declaration
    low = d.low if d is not None and d.low is not None else -np.inf
    high = d.high if d is not None and d.high is not None else np.inf
    return np.full(m.shape, np.clip(0.0, low, high)).astype(m.numpy_type)


def _function_texts(block: BlockText, kind: str) -> str:
    """Return the C code of a block's init or step function, including the functions into which this function is
    divided."""
    functions = re.split(r"^}$", block.source, flags=re.MULTILINE)
    return "\n".join(f for f in functions if re.search(rf"^\S.*\b{block.name}_{kind}", f, flags=re.MULTILINE))


def _reads(text: str, m: Member) -> bool:
    return re.search(rf"p->{re.escape(m.path)}\b", text) is not None
