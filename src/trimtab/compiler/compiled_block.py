"""Compiled block, loaded into Python. A call from Python adds less than a microsecond to the time of the block."""

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from trimtab.compiler.block import BlockDefinition, BlockText, block_text
from trimtab.compiler.native.build import build_library, load_library
from trimtab.compiler.structs import Member, row_declarations, row_functions
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest

ENTRY = """
#include <stddef.h>

typedef struct {
WORKSPACEOWN    NAME_in in;
    NAME_out out;
    double inputs[VECTORS_IN], outputs[VECTORS_OUT];
} NAME_memory;

static const int64_t NAME_offsets[] = {OFFSETS};

int64_t NAME_size(void) { return sizeof(NAME_memory); }
double *NAME_inputs(NAME_memory *a) { return a->inputs; }
double *NAME_outputs(NAME_memory *a) { return a->outputs; }
void *NAME_parameter(NAME_memory *a, int64_t k) { return (char *)FIRST + NAME_offsets[k]; }
void NAME_begin(NAME_memory *a)
{
    memset(a, 0, sizeof *a);
BEGIN}
void NAME_fast(NAME_memory *a)
{
    vectors_set_in(a->inputs, &a->in);
    STEP
    vectors_get_out(&a->out, a->outputs);
}
"""


def compile_block(block: BlockDefinition) -> "CompiledBlock":
    """Compile a block with the machine's C compiler, and set it to its initial state.

    Raises:
        InputError: if a JAX primitive cannot be written as C (the error names the Python line), or no C compiler works.
    """
    return CompiledBlock(block_text(block))


class CompiledBlock:
    """Block with a compiled step: write `inputs`, call `step()`, read `outputs`.

    inputs, outputs: float64 arrays that the compiled code reads and writes in place. Truth values are 0 and 1. Times
    are integers in units of 100 ns.
    reads, writes: path -> position in `inputs` or `outputs`, e.g. ``inputs[reads["t"]] = now``.
    parameters: path -> array that the compiled code reads in place, e.g. ``parameters["law.k1"][...] = 2``.
    text: C text of the block, as `trimtab export` writes it.
    """

    def __init__(self, text: BlockText) -> None:
        """Compile and load the text of a block."""
        library, name = load_library(build_library(_library_source(text), extra=text.flags)), text.name
        self.text = text
        size, parameter = library[f"{name}_size"], library[f"{name}_parameter"]
        size.restype = ctypes.c_int64
        parameter.restype = ctypes.c_void_p
        self._memory = ctypes.create_string_buffer(size() + 64)
        start = -ctypes.addressof(self._memory) % 64 + ctypes.addressof(self._memory)
        self._at = ctypes.c_void_p(start)
        self._begin = library[f"{name}_begin"]
        self._step = library[f"{name}_fast"]
        self.reads, self.writes = _member_slots(text.inputs), _member_slots(text.outputs)
        self.inputs = self._array_view(library[f"{name}_inputs"], text.inputs)
        self.outputs = self._array_view(library[f"{name}_outputs"], text.outputs)
        self.parameters: Mapping[str, Any] = {
            m.name: _array_at(parameter(self._at, ctypes.c_int64(k)), m) for k, m in enumerate(text.parameters)
        }
        self.reset()

    def _array_view(self, where: Any, members: list[Member]) -> Any:
        where.restype = ctypes.POINTER(ctypes.c_double)
        return np.ctypeslib.as_array(where(self._at), shape=(sum(m.size for m in members),))

    def reset(self) -> None:
        """Restore the initial state, and the parameters with which the block was compiled."""
        self._begin(self._at)

    def step(self) -> None:
        """Run one step: read `inputs`, write `outputs`."""
        self._step(self._at)

    def set_inputs(self, values: Mapping[str, Any]) -> None:
        """Write inputs by path. This is slower than writing to the array `inputs` directly."""
        for path, value in values.items():
            self.inputs[self._find_slot(self.reads, "input", path)] = value

    def result(self, path: str) -> Any:
        """Return the output with this path."""
        return self.outputs[self._find_slot(self.writes, "output", path)]

    def _find_slot(self, slots: Mapping[str, Any], kind: str, path: str) -> Any:
        if path not in slots:
            near = closest(path, slots, 6) or list(slots)[:6]
            problem = f"the block has no {kind} {path!r}"
            raise InputError(f"block {self.text.name!r}", problem, choices=near, fix=f"name {near[0]!r}")
        return slots[path]


def _library_source(text: BlockText) -> str:
    """Return C text with the block, functions that convert rows of numbers to structs, and functions for Python."""
    name = text.name
    source = text.source.replace(f'#include "{name}.h"\n', "")
    offsets = ", ".join(f"offsetof({name}_params, {m.path})" for m in text.parameters) or "0"
    space = f"    char workspace[{text.workspace}] __attribute__((aligned(64)));\n" if text.workspace else ""
    init = "NAME_init(&a->p, &a->s, a->workspace);" if space else "NAME_init(&a->p, &a->s);"
    own, begin, first = "    NAME_params p;\n    NAME_state s;\n", f"    NAME_defaults(&a->p);\n    {init}\n", "&a->p"
    if text.is_function:
        own, begin, first = "", "", "a"
    step = text.call("&a->p", "&a->s", "&a->in", "&a->out", "a->workspace")
    entry = ENTRY.replace("WORKSPACE", space).replace("OWN", own).replace("BEGIN", begin)
    entry = entry.replace("FIRST", first).replace("STEP", step)
    entry = entry.replace("NAME", name).replace("OFFSETS", offsets)
    rows = name, text.inputs, text.outputs
    return "\n".join([text.header, row_declarations(*rows), row_functions(*rows), source, entry])


def _array_at(address: int, m: Member) -> Any:
    raw: Any = (ctypes.c_char * (m.size * m.numpy_type.itemsize)).from_address(address)
    return np.frombuffer(raw, m.numpy_type).reshape(m.shape)


def _member_slots(members: list[Member]) -> dict[str, Any]:
    slots, k = {}, 0
    for m in members:
        slots[m.name] = slice(k, k + m.size) if m.shape else k
        k += m.size
    return slots
