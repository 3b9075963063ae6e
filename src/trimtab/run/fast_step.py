"""The compiled step of an autopilot, called from Python in well under a microsecond of its own: what `fly` runs."""

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from trimtab.compiler.block import ExportedBlock
from trimtab.compiler.structs import Member
from trimtab.core.errors import InputError, closest
from trimtab.export.export_c import autopilot_step
from trimtab.export.folder import vectors_source
from trimtab.loop.scenario import Scenario
from trimtab.native.build import build_library, load_library

ENTRY = """
#include <stddef.h>

typedef struct {
    NAME_params p;
    NAME_state s;
    NAME_in in;
    NAME_out out;
    double inputs[VECTORS_IN], outputs[VECTORS_OUT];
} NAME_held;

static const int64_t NAME_offsets[] = {OFFSETS};

int64_t NAME_size(void) { return sizeof(NAME_held); }
double *NAME_inputs(NAME_held *a) { return a->inputs; }
double *NAME_outputs(NAME_held *a) { return a->outputs; }
void *NAME_parameter(NAME_held *a, int64_t k) { return (char *)&a->p + NAME_offsets[k]; }
void NAME_again(NAME_held *a) { NAME_init(&a->p, &a->s); }
void NAME_begin(NAME_held *a)
{
    memset(a, 0, sizeof *a);
    NAME_defaults(&a->p);
    NAME_again(a);
}
void NAME_fast(NAME_held *a)
{
    vectors_set_in(a->inputs, &a->in);
    NAME_step(&a->p, &a->s, &a->in, &a->out);
    vectors_get_out(&a->out, a->outputs);
}
"""


class FastStep:
    """A block whose step is compiled: write `inputs`, call `step()`, read `outputs`.

    inputs, outputs: float64 arrays that the compiled code reads and writes in place; truth values are 0 and 1, times
    integers of 100 ns.  reads, writes: path -> where in them, e.g. ``inputs[reads["t"]] = now``.
    """

    def __init__(self, exported: ExportedBlock) -> None:
        """Compile the C text of an exported block; it is the text that `trimtab export` writes."""
        library, name = load_library(build_library(_step_source(exported))), exported.name
        self.exported = exported
        size, parameter = library[f"{name}_size"], library[f"{name}_parameter"]
        size.restype = ctypes.c_int64
        parameter.restype = ctypes.c_void_p
        self._held = ctypes.create_string_buffer(size() + 64)
        start = -ctypes.addressof(self._held) % 64 + ctypes.addressof(self._held)
        self._at = ctypes.c_void_p(start)
        self._begin = library[f"{name}_begin"]
        self._again = library[f"{name}_again"]
        self._step = library[f"{name}_fast"]
        self.reads, self.writes = _member_slots(exported.inputs), _member_slots(exported.outputs)
        self.inputs = self._array_view(library[f"{name}_inputs"], exported.inputs)
        self.outputs = self._array_view(library[f"{name}_outputs"], exported.outputs)
        self._parameters = {
            m.name: _array_at(parameter(self._at, ctypes.c_int64(k)), m) for k, m in enumerate(exported.params)
        }
        self.reset()

    def _array_view(self, where: Any, held: list[Member]) -> Any:
        where.restype = ctypes.POINTER(ctypes.c_double)
        return np.ctypeslib.as_array(where(self._at), shape=(sum(m.size for m in held),))

    def reset(self) -> None:
        """Back to the state before the first step, with the scenario's parameters."""
        self._begin(self._at)

    def reset_state(self) -> None:
        """Back to the state before the first step, with the parameters as they are now."""
        self._again(self._at)

    def step(self) -> None:
        """One control period: from `inputs` to `outputs`."""
        self._step(self._at)

    def set_inputs(self, values: Mapping[str, Any]) -> None:
        """Write inputs by path; convenient, and slower than writing `inputs` itself."""
        for path, value in values.items():
            if path not in self.reads:
                near = closest(path, self.reads, 6) or list(self.reads)[:6]
                problem = f"the autopilot has no input {path!r}"
                raise InputError("fast step", problem, choices=near, fix=f"give({{{near[0]!r}: …}})")
            self.inputs[self.reads[path]] = value

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters by path, as arrays that the compiled code reads in place: ``parameters["law.k1"][...] = 2``."""
        return self._parameters

    def result(self, path: str) -> Any:
        """An output by path."""
        if path not in self.writes:
            near = closest(path, self.writes, 6) or list(self.writes)[:6]
            problem = f"the autopilot has no output {path!r}"
            raise InputError("fast step", problem, choices=near, fix=f"result({near[0]!r})")
        return self.outputs[self.writes[path]]


def compile_autopilot(scenario: Scenario, *, seed: int = 0) -> FastStep:
    """The autopilot of a scenario as a compiled step; refused as `export_c` refuses, or without a C compiler."""
    scenario.check()
    return FastStep(autopilot_step(scenario, "autopilot", "f64", seed).exported)


def _step_source(exported: ExportedBlock) -> str:
    source = exported.source.replace(f'#include "{exported.name}.h"\n', "")
    offsets = ", ".join(f"offsetof({exported.name}_params, {m.path})" for m in exported.params) or "0"
    entry = ENTRY.replace("NAME", exported.name).replace("OFFSETS", offsets)
    return "\n".join([exported.header, vectors_source(exported), source, entry])


def _array_at(address: int, m: Member) -> Any:
    dtype = np.dtype("?" if m.dtype == "bool" else f"{m.dtype[0]}{int(m.dtype[1:]) // 8}")
    raw: Any = (ctypes.c_char * (m.size * dtype.itemsize)).from_address(address)
    return np.frombuffer(raw, dtype).reshape(m.shape)


def _member_slots(held: list[Member]) -> dict[str, Any]:
    found, k = {}, 0
    for m in held:
        found[m.name] = slice(k, k + m.size) if m.shape else k
        k += m.size
    return found
