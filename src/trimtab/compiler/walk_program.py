"""C code of a walk: a simulation loop over instants of time, which writes the rows of a log and their statistics.

A walk has a start and a step, both given as a jaxpr. The step is repeated for each instant of a timetable. Threads
share the runs.
"""

from pathlib import Path
from typing import Any, NamedTuple

from trimtab.compiler import jaxprs
from trimtab.compiler.analysis import defined_values, find_varying, prune
from trimtab.compiler.arrays import Array, element_list, scalar
from trimtab.compiler.elementary import preamble_text
from trimtab.compiler.function import parameter_array
from trimtab.compiler.ir import Block, Builder, Emit, If, Loop
from trimtab.compiler.lower import Lowering
from trimtab.compiler.native.build import build_library
from trimtab.compiler.pieces import PieceFrame, build_level, plan_pieces
from trimtab.compiler.rules import RULES
from trimtab.compiler.rules.control import LoopCarries
from trimtab.compiler.text import C_TYPES
from trimtab.compiler.uniform import branch_uniform_selects
from trimtab.compiler.values import Buffer, Value
from trimtab.compiler.workspace import plan_workspace
from trimtab.compiler.writer import Writer


class WalkProgram(NamedTuple):
    """Lowered walk over instants.

    blocks: a block that is computed once, and a block with the start and the loop.
    inputs: parameters, initial state and random key, as a flat list.
    loop: loop over the instants.
    final: first leaves of the state, at the end of the run.
    width: number of columns of the log.
    live: ids of the values that are needed.
    """

    blocks: list[Block]
    inputs: list[Array]
    loop: Loop
    final: list[Value]
    width: int
    live: set[int]

    def text(self, lanes: int = 0, own: frozenset[int] = frozenset()) -> str:
        """Return C, or C++ for lanes. own: positions of the inputs that differ from run to run."""
        inputs = [t for i in own for t in _array_leaves(self.inputs[i])]
        varying, blocks = find_varying(self.blocks, inputs, []) if lanes else None, self.blocks
        if varying is not None:
            blocks = branch_uniform_selects(blocks, varying, self.final)
        tables = [self.inputs[i].buffer for i in own]
        whole = [b for b in tables if b is not None and id(b) in self.live]
        workspace = plan_workspace(blocks, whole, lanes=lanes, varying=varying)
        w = Writer({}, self.live, varying, workspace)
        w.note_sincos(blocks)
        w.record = lambda values: _write_row(w, values)
        _write_parameters(w, self, lanes, own)
        for block in blocks:
            for name, buffer in _timetable_buffers(block):
                w.names[id(buffer)] = name
        arguments = [("void *", "workspace")] if workspace.size else []
        w.divide(plan_pieces(blocks, self.final), PieceFrame("fly", lanes, arguments))
        w.write_line("double least[WIDTH][RUNS], most[WIDTH][RUNS], sum[WIDTH][RUNS], squares[WIDTH][RUNS];")
        w.write_line("for (int i = 0; i < WIDTH; i++) EACH_RUN least[i][l] = INFINITY, most[i][l] = -INFINITY;")
        w.write_line("for (int i = 0; i < WIDTH; i++) EACH_RUN sum[i][l] = squares[i][l] = 0;")
        for block in blocks:
            w.write_block(block)
        _write_final_values(w, self)
        return _assemble_source(w, self, lanes)


def lower_walk(begin: Any, step: Any, final_count: int) -> WalkProgram:
    """Lower a walk.

    Args:
        begin: jaxpr, inputs -> state.
        step: jaxpr, (inputs, state, t, h) -> (state, row of float64).
        final_count: number of leaves of the state, counted from the first, whose last values are returned.
    """
    b = Builder(hoist=True)
    lowering = Lowering(b, RULES)
    avals = [v.aval for v in begin.jaxpr.invars]
    indexed = jaxprs.indexed_inputs(step.jaxpr)
    inputs = [parameter_array(v.shape, lowering.type_name(v.dtype), i in indexed) for i, v in enumerate(avals)]
    for array in inputs:
        for v in [] if array.items is None else array.items.ravel():
            v.invariant = True
    n = len(inputs)
    first = lowering.lower_program(begin, inputs, [False] * n)
    carried = LoopCarries(b, first, [True] * len(first), jaxprs.indexed_inputs(step.jaxpr, n))
    loop = Loop("n", Value("index", (), "i32"), Block())
    variables = [Value("carry", (), v.dtype) for v in carried.values]
    with b.write_into(loop.body):
        now = [scalar(b.load(Buffer("i64", 0, "input", name), loop.index)) for name in ("t", "h")]
        arrays = [*inputs, *carried.arrays(variables), *now]
        dying = [False] * n + [True] * len(first) + [False] * 2
        results = lowering.lower_program(step, arrays, dying)
        row = [v for a in results[len(first) :] for v in element_list(b, a)]
        if row:
            _record_row(b, loop.index, row)
        nexts = carried.close_iteration(results[: len(first)])
    loop.carries = list(zip(variables, carried.values, nexts, strict=True))
    b.block.items.append(loop)
    final = [v for a in carried.arrays(variables)[:final_count] for v in element_list(b, a)]
    live = prune([b.prologue, b.top], final, [])
    return WalkProgram([b.prologue, b.top], inputs, loop, final, len(row), live)


def build_program(program: WalkProgram, lanes: int, own: frozenset[int]) -> Path:
    """Build a program and return the path of its shared library. lanes, own: as in `WalkProgram.text`."""
    extra = ("-pthread", *build_level(program.blocks, lanes))
    return build_library(program.text(lanes, own), "c++" if lanes else "c", extra=extra)


def _record_row(b: Builder, index: Value, row: list[Value]) -> None:
    """Write a row of the log at the instants for which the timetable has a row."""
    where = b.load(Buffer("i32", 0, "input", "row"), index)
    rows = b.load(Buffer("i32", 0, "input", "rows"), b.index(0))
    branch = If(b.op("lt", where, rows, dtype="bool"), Block(), Block())
    branch.first.items.append(Emit([where, *row]))
    b.block.items.append(branch)


JOB_TEXT = """
/* Runs to simulate. shared: inputs that are equal in all runs, as double. own: inputs that differ, runs x own_count.
 * t, h, row: the instants, the time to the next instant, and the row of the log to write (`rows`: no row).
 * log: runs x rows x width or null. stats: runs x width x 4 (minimum, maximum, sum, sum of squares) or null.
 * final: runs x count. next, done and stop are shared by the threads. */
typedef struct {
    const double *shared, *own;
    int64_t own_count, runs;
    int32_t n, rows;
    const int64_t *t, *h;
    const int32_t *row;
    double *log, *stats, *final;
    int64_t next, done, stop;
} job;
"""

FLY_TEXT = """static void fly(job *j, int64_t first)
{
    const int64_t *const t = j->t;
    const int64_t *const h = j->h;
    const int32_t *const row = j->row, *const rows = &j->rows;
    const int32_t n = j->n;
    const double *const shared = j->shared;
    (void)shared; (void)t; (void)h;"""

WORK_TEXT = """
static void *work(void *given)
{
    job *j = (job *)given;
    while (!__atomic_load_n(&j->stop, __ATOMIC_RELAXED)) {
        const int64_t first = __atomic_fetch_add(&j->next, RUNS, __ATOMIC_RELAXED);
        if (first >= j->runs)
            break;
        fly(j, first);
        __atomic_fetch_add(&j->done, RUNS, __ATOMIC_RELAXED);
    }
    return 0;
}

/* Simulate all runs with this number of threads, the caller's included. Returns the number of threads that worked. */
EXPORT int32_t trimtab_fly(job *j, int32_t threads)
{
    pthread_t others[255];
    int32_t started = 0;
    while (started < threads - 1 && started < 255 && !pthread_create(others + started, 0, work, j))
        started++;
    work(j);
    for (int32_t i = 0; i < started; i++)
        pthread_join(others[i], 0);
    return started + 1;
}
"""


def _assemble_source(w: Writer, program: WalkProgram, lanes: int) -> str:
    frame, space = w.frame.place(w.workspace.size)
    text = [
        preamble_text(w, lanes),
        "#include <pthread.h>\n" + ("#include <stdlib.h>\n" if space else ""),
        f"#define RUNS {'LANES' if lanes else '1'}\n",
        f"#define EACH_RUN for (int l = 0; l < RUNS; l++)\n#define WIDTH {max(program.width, 1)}\n",
        '#define EXPORT extern "C"\n' if lanes else "#define EXPORT\n",
        JOB_TEXT,
        w.frame.text(),
        FLY_TEXT.replace("first)", "first, void *workspace)", 1) if space else FLY_TEXT,
        frame,
        *w.lines,
        "}",
        _work_with_workspace(space) if space else WORK_TEXT,
    ]
    return "\n".join(text)


def _work_with_workspace(size: int) -> str:
    """Return the C text of a thread that allocates the workspace first. If that fails, the thread takes no runs."""
    taken = f"""    char *const memory = (char *)malloc({size} + 64);
    if (!memory)
        return 0;
    void *const workspace = memory + (64 - (uintptr_t)memory % 64) % 64;
"""
    text = WORK_TEXT.replace("    job *j = (job *)given;\n", "    job *j = (job *)given;\n" + taken)
    return text.replace("fly(j, first);", "fly(j, first, workspace);").replace(
        "    }\n    return 0;", "    }\n    free(memory);\n    return 0;"
    )


def _array_leaves(array: Array) -> list[Any]:
    return [array.buffer] if array.items is None else list(array.items.ravel())


def _write_parameters(w: Writer, program: WalkProgram, lanes: int, own: frozenset[int]) -> None:
    """Write the declaration of each input, read from the inputs shared by all runs or from the inputs of the run."""
    at = {False: 0, True: 0}
    for i, array in enumerate(program.inputs):
        differs = i in own
        start, at[differs] = at[differs], at[differs] + array.size
        if array.items is None:
            if id(array.buffer) in w.live:
                _write_table(w, f"p{i}", array, differs, start, lanes)
            continue
        for k, v in enumerate(array.items.ravel()):
            if id(v) not in w.live:
                continue
            name = w.names[id(v)] = f"p{i}_{k}"
            source = _input_text(start + k, v.dtype, differs, lanes)
            if differs and lanes:
                w.write_line(f"{w.type(v.dtype, True)} {name};")
                w.write_line(f"EACH_RUN {name}[l] = {source};")
            else:
                w.write_line(f"const {C_TYPES[v.dtype]} {name} = {source};")


def _write_table(w: Writer, name: str, array: Array, differs: bool, start: int, lanes: int) -> None:
    assert array.buffer is not None
    if array.dtype == "f64" and not differs:
        w.names[id(array.buffer)] = name
        w.write_line(f"const double *const {name} = shared + {start};")
        return
    varies = differs and lanes > 0
    each, to = ("EACH_RUN ", f"{name}[i][l]") if varies else ("", f"{name}[i]")
    source = _input_text(f"{start} + i", array.dtype, differs, lanes)
    w.declare_buffer(array.buffer, name)
    w.write_line(f"for (int32_t i = 0; i < {array.size}; i++) {each}{to} = {source};")


def _input_text(position: int | str, dtype: str, differs: bool, lanes: int) -> str:
    """Return the C text that reads an input and converts it to its type. In lanes, true has all bits set."""
    cast = "-(tt_mask)" if differs and lanes and dtype == "bool" else f"({C_TYPES[dtype]})"
    if not differs:
        return f"{cast}shared[{position}]"
    run = "first + l" if lanes else "first"
    return f"{cast}j->own[({run} < j->runs ? {run} : j->runs - 1) * j->own_count + {position}]"


def _timetable_buffers(block: Block) -> list[tuple[str, Buffer]]:
    return [
        (v.attr.name, v.attr)
        for v in defined_values([block])
        if v.op == "load" and isinstance(v.attr, Buffer) and v.attr.name in ("t", "h", "row", "rows")
    ]


def _number_text(w: Writer, v: Value) -> str:
    """Return the C text of a value in lane l as a double."""
    text = w.name(v)
    if not w.varies(v):
        return f"(double){text}"
    return f"(double)({text}[l] != 0)" if v.dtype == "bool" else f"(double){text}[l]"


ROW_TEXT = """
if (j->log) EACH_RUN if (first + l < j->runs) {
    double *const to = j->log + ((first + l) * j->rows + at) * WIDTH;
    for (int i = 0; i < WIDTH; i++) to[i] = x[i][l];
}
if (j->stats) for (int i = 0; i < WIDTH; i++) EACH_RUN {
    least[i][l] = x[i][l] < least[i][l] ? x[i][l] : least[i][l];
    most[i][l] = x[i][l] > most[i][l] ? x[i][l] : most[i][l];
    sum[i][l] += x[i][l], squares[i][l] += x[i][l] * x[i][l];
}"""


def _write_row(w: Writer, values: list[Value]) -> None:
    where, *numbers = values
    w.write_line(f"const int64_t at = {w.name(where)};")
    w.write_line(f"{'double x[WIDTH][RUNS]' if w.varying is None else 'wf64 x[WIDTH]'};")
    for k, v in enumerate(numbers):
        if w.varies(v) and v.dtype == "f64":
            w.write_line(f"x[{k}] = {w.name(v)};")
        else:
            w.write_line(f"EACH_RUN x[{k}][l] = {_number_text(w, v)};")
    for line in ROW_TEXT.strip().splitlines():
        w.write_line(line)


def _write_final_values(w: Writer, program: WalkProgram) -> None:
    w.write_line("if (j->final) EACH_RUN if (first + l < j->runs) {")
    w.write_line(f"    double *const to = j->final + (first + l) * {max(len(program.final), 1)};")
    for k, v in enumerate(program.final):
        w.write_line(f"    to[{k}] = {_number_text(w, v)};")
    w.write_line("}")
    w.write_line("if (j->stats) EACH_RUN if (first + l < j->runs) for (int i = 0; i < WIDTH; i++) {")
    w.write_line("    double *const to = j->stats + ((first + l) * WIDTH + i) * 4;")
    w.write_line("    to[0] = least[i][l]; to[1] = most[i][l]; to[2] = sum[i][l]; to[3] = squares[i][l];")
    w.write_line("}")
