"""Text of a flight: parameters in, every instant, rows of the log and statistics out; threads share the runs."""

from typing import Any

from trimtab.compiler.c_functions import C_TYPES
from trimtab.compiler.elementary import preamble_text
from trimtab.compiler.ir import Buffer, Value
from trimtab.compiler.uniform import find_varying
from trimtab.compiler.writer import Writer, defined_values

JOB_TEXT = """
/* What is flown. shared: parameters of all runs, as double. own: those that differ, runs x own_count.
 * t, h, row: the instants, the time to the next, and the row of the log that is written, `rows` for none.
 * log: runs x rows x width or null. stats: runs x width x 4 (least, largest, sum, sum of squares) or null.
 * final: runs x count. next, done, stop are shared by the threads. */
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

/* Fly all runs on this many threads, the caller's among them; gives the number of threads that worked. */
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


def walk_source(flight: Any, lanes: int, varying: frozenset[int]) -> str:
    """The whole source of a flight; see `Flight.text`."""
    inputs = [t for i in varying for t in _array_leaves(flight.inputs[i])]
    differs = find_varying(flight.blocks, inputs, []) if lanes else None
    w = Writer({}, flight.live, differs)
    w.note_sincos(flight.blocks)
    w.record = lambda values: _write_row(w, values)
    _write_parameters(w, flight, lanes, varying)
    for block in flight.blocks:
        for name, buffer in _timetable_buffers(block):
            w.names[id(buffer)] = name
    w.write_line("double least[WIDTH][RUNS], most[WIDTH][RUNS], sum[WIDTH][RUNS], squares[WIDTH][RUNS];")
    w.write_line("for (int i = 0; i < WIDTH; i++) EACH_RUN least[i][l] = INFINITY, most[i][l] = -INFINITY;")
    w.write_line("for (int i = 0; i < WIDTH; i++) EACH_RUN sum[i][l] = squares[i][l] = 0;")
    for block in flight.blocks:
        w.write_block(block)
    _write_final_values(w, flight)
    return _assemble_source(w, flight, lanes)


def _assemble_source(w: Writer, flight: Any, lanes: int) -> str:
    runs = "#define RUNS LANES\n" if lanes else "#define RUNS 1\n"
    each = "#define EACH_RUN for (int l = 0; l < RUNS; l++)\n" + f"#define WIDTH {max(flight.width, 1)}\n"
    export = '#define EXPORT extern "C"\n' if lanes else "#define EXPORT\n"
    head = "static void fly(job *j, int64_t first)\n{"
    local = ["t = j->t", "h = j->h"]
    lines = [f"    const int64_t *const {text};" for text in local]
    lines += ["    const int32_t *const row = j->row, *const rows = &j->rows;", "    const int32_t n = j->n;"]
    lines += ["    const double *const shared = j->shared;", "    (void)shared; (void)t; (void)h;"]
    text = [
        preamble_text(w, lanes),
        "#include <pthread.h>\n",
        runs,
        each,
        export,
        JOB_TEXT,
        head,
        *lines,
        *w.lines,
        "}",
        WORK_TEXT,
    ]
    return "\n".join(text)


def _array_leaves(array: Any) -> list[Any]:
    return [array.buffer] if array.items is None else list(array.items.ravel())


def _write_parameters(w: Writer, flight: Any, lanes: int, varying: frozenset[int]) -> None:
    """Each input under its name: from what all runs share, or from the run's own numbers."""
    at = {False: 0, True: 0}
    for i, array in enumerate(flight.inputs):
        own = i in varying
        start, at[own] = at[own], at[own] + array.size
        if array.items is None:
            if id(array.buffer) in w.live:
                _write_table(w, f"p{i}", array, own, start, lanes)
            continue
        for k, v in enumerate(array.items.ravel()):
            if id(v) not in w.live:
                continue
            name = w.names[id(v)] = f"p{i}_{k}"
            T = C_TYPES[v.dtype]
            if own and lanes:
                sign = "-(int64_t)" if v.dtype == "bool" else f"({T})"
                w.write_line(f"{w.type(v.dtype, True)} {name};")
                w.write_line(f"EACH_RUN {name}[l] = {sign}{_own_input_text(start + k)};")
            else:
                source = _own_input_text(start + k).replace(" + l", "") if own else f"shared[{start + k}]"
                w.write_line(f"const {T} {name} = ({T}){source};")


def _own_input_text(position: int) -> str:
    last = "(first + l < j->runs ? first + l : j->runs - 1)"
    return f"j->own[{last} * j->own_count + {position}]"


def _write_table(w: Writer, name: str, array: Any, own: bool, start: int, lanes: int) -> None:
    w.names[id(array.buffer)] = name
    T, t = C_TYPES[array.dtype], array.dtype
    if not own:
        if t == "f64":
            w.write_line(f"const double *const {name} = shared + {start};")
        else:
            w.write_line(f"{T} {name}[{array.size}];")
            w.write_line(f"for (int32_t i = 0; i < {array.size}; i++) {name}[i] = ({T})shared[{start} + i];")
        return
    source = _own_input_text(start).replace("]", " + i]")
    if lanes:
        sign = "-(int64_t)" if t == "bool" else f"({T})"
        w.write_line(f"{w.type(t, True)} {name}[{array.size}];")
        w.write_line(f"for (int32_t i = 0; i < {array.size}; i++) EACH_RUN {name}[i][l] = {sign}{source};")
    else:
        w.write_line(f"{T} {name}[{array.size}];")
        w.write_line(f"for (int32_t i = 0; i < {array.size}; i++) {name}[i] = ({T}){source.replace(' + l', '')};")


def _timetable_buffers(block: Any) -> list[tuple[str, Buffer]]:
    return [
        (v.attr.name, v.attr)
        for v in defined_values([block])
        if v.op == "load" and isinstance(v.attr, Buffer) and v.attr.name in ("t", "h", "row", "rows")
    ]


def _number_text(w: Writer, v: Value) -> str:
    """A value of this lane as a double."""
    text = w.name(v)
    if not w.varies(v):
        return f"(double){text}"
    return f"(double)({text}[l] != 0)" if v.dtype == "bool" else f"(double){text}[l]"


def _write_row(w: Writer, values: list[Value]) -> None:
    where, *numbers = values
    w.write_line(f"const int64_t at = {w.name(where)};")
    w.write_line("if (j->log) EACH_RUN if (first + l < j->runs) {")
    w.write_line("    double *const to = j->log + ((first + l) * j->rows + at) * WIDTH;")
    for k, v in enumerate(numbers):
        w.write_line(f"    to[{k}] = {_number_text(w, v)};")
    w.write_line("}")
    w.write_line("if (j->stats) EACH_RUN {")
    for k, v in enumerate(numbers):
        w.write_line(f"    const double x{k} = {_number_text(w, v)};")
        w.write_line(f"    least[{k}][l] = x{k} < least[{k}][l] ? x{k} : least[{k}][l];")
        w.write_line(f"    most[{k}][l] = x{k} > most[{k}][l] ? x{k} : most[{k}][l];")
        w.write_line(f"    sum[{k}][l] += x{k}; squares[{k}][l] += x{k} * x{k};")
    w.write_line("}")


def _write_final_values(w: Writer, flight: Any) -> None:
    w.write_line("if (j->final) EACH_RUN if (first + l < j->runs) {")
    w.write_line(f"    double *const to = j->final + (first + l) * {max(len(flight.final), 1)};")
    for k, v in enumerate(flight.final):
        w.write_line(f"    to[{k}] = {_number_text(w, v)};")
    w.write_line("}")
    w.write_line("if (j->stats) EACH_RUN if (first + l < j->runs) for (int i = 0; i < WIDTH; i++) {")
    w.write_line("    double *const to = j->stats + ((first + l) * WIDTH + i) * 4;")
    w.write_line("    to[0] = least[i][l]; to[1] = most[i][l]; to[2] = sum[i][l]; to[3] = squares[i][l];")
    w.write_line("}")
