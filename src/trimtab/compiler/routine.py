"""One C function of a jaxpr whose operands and results are members of structs; state is read and written in place."""

from typing import Any, NamedTuple

from trimtab.compiler import jaxprs
from trimtab.compiler.arrays import Array, copy_array, copy_into, is_small, scalars
from trimtab.compiler.c_functions import C_TYPES
from trimtab.compiler.dead_code import prune
from trimtab.compiler.fold import fold
from trimtab.compiler.ir import Block, Buffer, Builder, If, Local, Loop, Value
from trimtab.compiler.lower import Lowering
from trimtab.compiler.rules import RULES
from trimtab.compiler.structs import Member
from trimtab.compiler.writer import Writer


class StructPlace(NamedTuple):
    """Members behind one pointer, e.g. "s->"; writable: their large arrays may be changed in place."""

    base: str
    members: list[Member]
    writable: bool = False


class Routine:
    """A lowered function, with where its operands come from and its results go."""

    def __init__(self, jaxpr: Any, sources: list[StructPlace], targets: list[StructPlace], real: str) -> None:
        self.b = b = Builder(fold, hoist=False)
        indexed = jaxprs.indexed_inputs(jaxpr.jaxpr)
        self.operands: list[tuple[str, Member, Array, bool]] = []
        dying: list[bool] = []
        for place in sources:
            for m in place.members:
                array = _operand_array(m, place, len(dying) in indexed)
                self.operands.append((place.base, m, array, place.writable))
                dying.append(place.writable)
        found = Lowering(b, RULES, real).lower_program(jaxpr, [a for _, _, a, _ in self.operands], dying)
        self.results: list[tuple[str, Member, Array]] = []
        rest = iter(found)
        pairs = [(place, m, next(rest)) for place in targets for m in place.members]
        # what others read of the state's arrays goes out before these are overwritten
        self.kept = [self._write_result(place, m, a) for place, m, a in pairs if not self._state_buffer(place, m)]
        self._write_states([(place, m, a) for place, m, a in pairs if self._state_buffer(place, m)])
        values = [v for _, _, a in self.results if a.items is not None for v in a.items.ravel()]
        buffers = [a.buffer for _, _, a in self.results if a.buffer is not None]
        self.live = prune([b.prologue, b.top], values, buffers)

    def _state_buffer(self, place: StructPlace, m: Member) -> Buffer | None:
        """The buffer in which a member is kept between calls, if it is one."""
        for base, other, array, _ in self.operands:
            if base == place.base and other.path == m.path:
                return array.buffer
        return None

    def _write_result(self, place: StructPlace, m: Member, array: Array) -> None:
        if self._alias_result(array):
            self.results.append((place.base, m, array))
            return
        if array.items is None or not is_small(array.shape):
            target = Buffer(array.dtype, array.size, "state", f"{place.base}{m.path}")
            copy_into(self.b, target, array)
            array = Array(array.shape, array.dtype, buffer=target)
        self.results.append((place.base, m, array))

    def _alias_result(self, array: Array) -> bool:
        """Let a result's own memory be the member itself, where nothing else needs it: no copy, and no stack."""
        buffer = array.buffer
        if buffer is None or buffer.kind != "local" or array.offset is not None:
            return False
        own = [item for item in self.b.top.items if isinstance(item, Local) and item.buffer is buffer]
        if own:
            self.b.top.items.remove(own[0])
            buffer.kind = "state"
        return bool(own)

    def _write_states(self, pairs: list[tuple[StructPlace, Member, Array]]) -> None:
        """Large states end in their own buffers; one that another state reads from is copied first."""
        own = [self._state_buffer(place, m) for place, m, _ in pairs]
        moves = []
        for (place, m, a), target in zip(pairs, own, strict=True):
            assert target is not None
            if a.buffer is not target:
                crossing = a.buffer is not None and any(a.buffer is t for t in own)
                moves.append((target, copy_array(self.b, a) if crossing else a))
            self.results.append((place.base, m, Array(a.shape, a.dtype, buffer=target)))
        for target, source in moves:
            copy_into(self.b, target, source)

    def has_data_dependent_loop(self) -> bool:
        """Whether some loop runs as long as a condition holds."""
        return _has_while_loop([self.b.prologue, self.b.top])

    def body_lines(self, w: Writer) -> list[str]:
        """The body of the function."""
        blocks = [self.b.prologue, self.b.top]
        w.live, start = self.live, len(w.lines)
        w.note_sincos(blocks)
        for base, m, array, writable in self.operands:
            if array.buffer is not None:
                w.names[id(array.buffer)] = f"{base}{m.path}"
                continue
            assert array.items is not None
            for k, v in enumerate(array.items.ravel()):
                if not writable and id(v) in self.live:  # read where it is used: a branch not taken loads nothing
                    w.names[id(v)] = m.at(base, k)
                elif id(v) in self.live:
                    w.names[id(v)] = name = w.fresh("x")
                    w.write_line(f"const {C_TYPES[v.dtype]} {name} = {m.at(base, k)};")
        for base, m, array in self.results:
            if array.buffer is not None:
                w.names[id(array.buffer)] = f"{base}{m.path}"
        for block in blocks:
            w.write_block(block)
        for base, m, array in self.results:
            if array.items is not None:
                for k, v in enumerate(array.items.ravel()):
                    text = w.name(v)
                    w.write_line(f"{m.at(base, k)} = {text};")
        return w.lines[start:]


def _has_while_loop(blocks: list[Block]) -> bool:
    for item in (i for block in blocks for i in block.items):
        if isinstance(item, If) and _has_while_loop([item.first, item.second]):
            return True
        if isinstance(item, Loop) and (item.count is None or _has_while_loop([item.body])):
            return True
    return False


def _operand_array(m: Member, place: StructPlace, indexed: bool) -> Array:
    if is_small(m.shape) and not (indexed and m.shape):
        return scalars([Value("input", (), m.dtype) for _ in range(m.size)], m.shape, m.dtype)
    kind = "state" if place.writable else "input"
    return Array(m.shape, m.dtype, buffer=Buffer(m.dtype, m.size, kind, f"{place.base}{m.path}"))
