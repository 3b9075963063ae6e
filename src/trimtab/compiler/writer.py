"""Writer of a program as scalar C, or as C++ for lanes, where a mask selects the lanes that execute a statement."""

from collections.abc import Callable
from typing import Any

from trimtab.compiler.analysis import VaryingValues, defined_values
from trimtab.compiler.ir import Block, Define, Emit, If, Local, Loop, Store
from trimtab.compiler.pieces import NO_PIECES, PieceFrame, Pieces
from trimtab.compiler.tables import LITERALS, table_text
from trimtab.compiler.text import (
    C_TYPES,
    check_lane_type,
    expression,
    lane_mask,
    number_literal,
    vector_type,
)
from trimtab.compiler.values import Buffer, Value
from trimtab.compiler.workspace import NO_WORKSPACE, Workspace

PAIR = {"sin_of": "s", "cos_of": "c"}


class Writer:
    """Writer of blocks as C text.

    names: id of an input, state or buffer -> its text.
    live: ids of the values that are needed.
    varying: None for scalar C, else the values and buffers that differ between lanes.
    workspace: places of large arrays.
    """

    def __init__(
        self,
        names: dict[int, str],
        live: set[int],
        varying: VaryingValues | None = None,
        workspace: Workspace = NO_WORKSPACE,
    ) -> None:
        self.names, self.live, self.varying, self.workspace = names, live, varying, workspace
        self.lines: list[str] = []
        self.depth, self.count = 1, 0
        self.masks: list[str] = []
        self.used: dict[str, int] = {}  # number of uses of each helper and elementary function
        self.constants: dict[int, str] = {}
        self.tables: list[str] = []
        self.data: list[Buffer] | None = None  # tables whose numbers are passed when the library is loaded
        self.record: Callable[[list[Value]], None] = lambda values: None
        self.keep: list[Any] = []  # ids serve as names, so their objects must stay alive
        self.pieces, self.piece, self.frame = NO_PIECES, 0, PieceFrame()

    def varies(self, thing: Any) -> bool:
        """Return True if a value or buffer differs between lanes."""
        return self.varying is not None and self.varying(thing)

    def write_line(self, text: str) -> None:
        """Write one line of C with the current indentation."""
        self.lines.append("    " * self.depth + text)

    def fresh(self, prefix: str = "v") -> str:
        """Return an unused C name, e.g. v12."""
        self.count += 1
        return f"{prefix}{self.count}"

    def note_use(self, name: str) -> str:
        """Count a call of a helper or elementary function, and return the function's name."""
        self.used[name] = self.used.get(name, 0) + 1
        return name

    def type(self, dtype: str, varies: bool) -> str:
        """Return the C type of a value: a scalar or, if it varies between lanes, a vector."""
        if varies:
            check_lane_type(dtype)
        return vector_type(dtype) if varies else C_TYPES[dtype]

    def name(self, thing: Any) -> str:
        """Return the C text of a value or buffer, without conversion to a vector."""
        if isinstance(thing, Buffer):
            return self.buffer(thing)
        if thing.op == "const":
            return number_literal(thing.const, thing.dtype)
        return self.names[id(thing)]

    def vector_text(self, thing: Any) -> str:
        """Return the C text of a value as a vector; a scalar is copied to all lanes."""
        text = self.name(thing)
        if isinstance(thing, Buffer) or self.varies(thing):
            return text
        return f"{self.note_use(f'tv_splat_{thing.dtype}')}({text})"

    def buffer(self, buffer: Buffer) -> str:
        """Return the C name of a buffer. The declaration of a table of constants is written at its first use."""
        if id(buffer) not in self.names and buffer.data is not None:
            self.names[id(buffer)] = name = self.fresh("table")
            self.keep.append(buffer)
            as_data = self.data is not None and buffer.size > LITERALS
            if self.data is not None and as_data:
                self.data.append(buffer)
            self.tables.append(table_text(name, buffer, as_data))
        return self.names[id(buffer)]

    def write_block(self, block: Block) -> None:
        """Write all statements of a block. The statements of a large program are written in pieces."""
        runs = self.pieces.runs.get(id(block)) if not self.piece else None
        for number, items in runs or [(0, block.items)]:
            if number:
                self.write_piece(number, items)
            else:
                self.write_items(items)

    def write_items(self, items: list[Any]) -> None:
        """Write these statements as C text, one after the other."""
        for item in items:
            if isinstance(item, Define):
                self.write_definition(item.value)
            elif isinstance(item, Local):
                self.declare_buffer(item.buffer)
            elif isinstance(item, Store):
                self.write_store(item)
            elif isinstance(item, If):
                self.write_branch(item)
            elif isinstance(item, Emit):
                self.record(item.values)
            else:
                self.write_loop(item)

    def declare_buffer(self, buffer: Buffer, name: str = "") -> str:
        """Declare an array on the stack, in the frame, or at its place in the workspace, and return its C name.

        A buffer that already has a name is in other memory and is not declared.
        """
        if id(buffer) in self.names:
            return self.names[id(buffer)]
        kind = self.type(buffer.dtype, self.varies(buffer))
        name, size = name or self.fresh("a"), max(buffer.size, 1)
        shared = id(buffer) in self.pieces.crossing
        self.names[id(buffer)] = f"f->{name}" if shared else name
        if buffer in self.workspace:
            place = f"({kind} *)((char *)workspace + {self.workspace.places[id(buffer)]})"
            keyword = "restrict" if self.varying is None else "__restrict"
            self.write_line(f"f->{name} = {place};" if shared else f"{kind} *{keyword} {name} = {place};")
        elif not shared:
            self.write_line(f"{kind} {name}[{size}];")
        if shared and buffer in self.workspace:
            self.frame.add_pointer(f"{kind} *", name)
        elif shared:
            self.frame.add_array(kind, name, buffer, self.varies(buffer))
        return self.names[id(buffer)]

    def write_definition(self, v: Value) -> None:
        """Write the C statement `const TYPE name = expression;` for a value."""
        varies = self.varies(v)
        if v.op in PAIR:
            if id(v) not in self.frame.names:
                self.names[id(v)] = self.names[id(v.args[0])] + PAIR[v.op]
            return
        name = self.names[id(v)] = self.fresh()
        kind = self.type(v.dtype, varies)
        if v.op == "sincos":
            self.write_sincos(v, name, kind)
            for pair in self.pieces.pairs.get(id(v), []):
                self.names[id(pair)] = name + PAIR[pair.op]
                self.share(pair)
            return
        naming = self.vector_text if varies and v.op != "load" else self.name  # an index or table may be uniform
        right = expression(v, naming, self.note_use, self.varies if varies else None)
        self.write_line(f"const {kind} {name} = {right};")
        self.share(v)

    def write_sincos(self, v: Value, name: str, kind: str) -> None:
        """Write the sine and cosine of an angle, or only the one that is needed."""
        name_of = ("ttv_{}" if self.varies(v) else "tt_{}") + ("f" if v.dtype == "f32" else "")
        wanted = [which for which in ("sin_of", "cos_of") if (which, id(v)) in self.live_pairs]
        functions = ["sincos"] if len(wanted) == 2 else [which.removesuffix("_of") for which in wanted]
        if v.dtype == "f32" and self.varies(v):
            name_of = "tv_{}_f32"
            for function in functions:
                self.note_use(f"ttv_{function}")  # which the helper calls
        angle = self.name(v.args[0])
        if len(wanted) == 2:
            self.write_line(f"{kind} {name}s, {name}c;")
            self.write_line(f"{self.note_use(name_of.format('sincos'))}({angle}, &{name}s, &{name}c);")
            return
        for which, function in zip(wanted, functions, strict=True):
            self.write_line(f"const {kind} {name}{PAIR[which]} = {self.note_use(name_of.format(function))}({angle});")

    def note_sincos(self, blocks: list[Block]) -> None:
        """Record, for each sincos, which of its two results are needed. Call this before writing any text."""
        self.live_pairs: set[tuple[str, int]] = set()
        for v in defined_values(blocks):
            if v.op in PAIR:
                self.live_pairs.add((v.op, id(v.args[0])))

    def write_store(self, item: Store) -> None:
        """Write the C statement `buffer[index] = value;` for the lanes that the current mask selects."""
        target, index = self.name(item.buffer), self.name(item.index)
        if not self.varies(item.buffer):
            self.write_line(f"{target}[{index}] = {self.name(item.value)};")
            return
        value, t = self.vector_text(item.value), item.buffer.dtype
        if self.varies(item.index):
            put = self.note_use(f"tv_put_{t}")
            self.write_line(f"{put}({target}, {index}, {value}, {self.active_mask()});")
        elif self.masks:
            self.write_line(f"{target}[{index}] = {lane_mask(self.masks[-1], t)} ? {value} : {target}[{index}];")
        else:
            self.write_line(f"{target}[{index}] = {value};")

    def active_mask(self) -> str:
        """Return the C text of the mask of the lanes that execute the current statement."""
        return self.masks[-1] if self.masks else f"{self.note_use('tv_splat_bool')}(true)"

    def write_braces(self, opening: str, block: Block) -> None:
        """Write the opening of a block in braces, and its statements. The caller closes the brace."""
        self.write_line(opening)
        self.depth += 1
        self.write_block(block)

    def write_branch(self, item: If) -> None:
        """Write a C branch if the test is equal in all lanes, else both sides under masks."""
        if self.varies(item.test):
            self.write_masked_branch(item)
            return
        results = [(self.declare_join(joined), x, y) for joined, x, y in item.joins]
        self.write_braces(f"if ({self.name(item.test)}) {{", item.first)
        for (name, wide), x, _ in results:
            self.write_line(f"{name} = {self.vector_text(x) if wide else self.name(x)};")
        self.depth -= 1
        if item.second.items or results:
            self.write_braces("} else {", item.second)
            for (name, wide), _, y in results:
                self.write_line(f"{name} = {self.vector_text(y) if wide else self.name(y)};")
            self.depth -= 1
        self.write_line("}")
        self.share_variables([joined for joined, _, _ in item.joins])

    def declare_join(self, joined: Value, start: str = "") -> tuple[str, bool]:
        """Declare a variable that blocks assign, and return its C name, and True if it is a vector."""
        wide = self.varies(joined)
        name, kind = self.fresh(), self.type(joined.dtype, wide)
        if id(joined) in self.pieces.crossing and not self.piece:
            self.frame.add_value(kind, name, joined.dtype, wide)
            self.frame.names[id(joined)] = name
            name = f"f->{name}"
            if start:
                self.write_line(f"{name} = {f'({kind}){{}}' if start == '{}' else start};")
        else:
            self.write_line(f"{kind} {name}{f' = {start}' if start else ''};")
        self.names[id(joined)] = name
        return name, wide

    def write_masked_branch(self, item: If) -> None:
        """Write both sides of a branch under masks. A side is skipped at run time if no lane takes it."""
        outer = f" & {self.masks[-1]}" if self.masks else ""
        test, yes, no = self.name(item.test), self.fresh("m"), self.fresh("m")
        self.write_line(f"const vmask {yes} = {test}{outer};")
        self.write_line(f"const vmask {no} = ~{test}{outer};")
        results = []
        for joined, x, y in item.joins:
            results.append((self.declare_join(joined, "{}")[0], x, y))
        self.write_side(yes, item.first, results, True)
        self.write_side(no, item.second, results, False)
        self.share_variables([joined for joined, _, _ in item.joins])

    def write_side(self, mask: str, block: Block, results: list[Any], first: bool) -> None:
        """Write one side of a masked branch, and the assignments of its results."""
        braces = bool(block.items)
        if braces:
            self.share_mask(mask)
            self.write_line(f"if ({self.note_use('tv_any')}({mask})) {{")
            self.depth += 1
        self.masks.append(mask)
        self.write_block(block)
        self.masks.pop()
        for name, x, y in results:
            value = self.vector_text(x if first else y)
            kept = lane_mask(mask, (x if first else y).dtype)
            self.write_line(f"{name} = {value};" if first else f"{name} = {kept} ? {value} : {name};")
        if braces:
            self.depth -= 1
            self.write_line("}")

    def write_loop(self, item: Loop) -> None:
        """Write a C loop. Lanes whose test has become false keep their carried values."""
        carried = []
        for variable, start, next_ in item.carries:
            begin = self.vector_text(start) if self.varies(variable) else self.name(start)
            carried.append((*self.declare_join(variable, begin), next_))
        apart = item.test is not None and self.varies(item.test)
        live = self.fresh("m")
        if apart:
            self.write_line(f"vmask {live} = {self.active_mask()};")
        if item.count is not None:
            index = self.names[id(item.index)] = self.fresh("i")
            assert not self.varies(item.count), "the number of iterations must be equal in all lanes"
            count = self.name(item.count) if isinstance(item.count, Value) else item.count
            self.write_line(f"for (int32_t {index} = 0; {index} < {count}; {index}++) {{")
        else:
            self.write_line("for (;;) {")
        self.depth += 1
        if item.count is not None:
            self.share(item.index)
        self.write_block(item.head)
        if apart:
            self.write_line(f"{live} &= {self.name(item.test)};")
            self.write_line(f"if (!{self.note_use('tv_any')}({live})) break;")
            self.masks.append(live)
            self.share_mask(live)
        elif item.test is not None:
            self.write_line(f"if (!({self.name(item.test)})) break;")
        self.write_block(item.body)
        self.write_assignments(carried, live if apart else None)
        if apart:
            self.masks.pop()
        self.depth -= 1
        self.write_line("}")
        self.share_variables([variable for variable, _, _ in item.carries])

    def write_assignments(self, carried: list[tuple[str, bool, Value]], mask: str | None = None) -> None:
        """Write the assignments of the next values of all carried variables, as if they were simultaneous."""
        targets = {name for name, _, _ in carried}
        moves = []
        for name, wide, next_ in carried:
            text = self.vector_text(next_) if wide else self.name(next_)
            if text == name:
                continue
            if any(other in targets for other in (text, self.name(next_))):
                held = self.fresh()
                self.write_line(f"const {self.type(next_.dtype, wide)} {held} = {text};")
                text = held
            moves.append((name, text, next_.dtype))
        for name, text, dtype in moves:
            self.write_line(f"{name} = {f'{lane_mask(mask, dtype)} ? {text} : {name}' if mask else text};")

    def share(self, thing: Value | Buffer) -> None:
        """Put a value, or a pointer to an array, into the frame if another piece needs it."""
        if id(thing) not in self.pieces.crossing:
            return
        name, kind = self.names[id(thing)], self.share_type(thing)
        if isinstance(thing, Buffer):
            self.frame.add_pointer(kind, name)
        else:
            self.frame.add_value(kind, name, thing.dtype, self.varies(thing))
        self.frame.names[id(thing)] = name
        self.write_line(f"f->{name} = {name};")
        if self.piece:
            self.frame.fresh.append(thing)

    def share_type(self, thing: Value | Buffer) -> str:
        """Return the C type of the frame member for a value. For an array, the member is a pointer to the array."""
        kind = self.type(thing.dtype, self.varies(thing))
        if isinstance(thing, Value):
            return kind
        return f"const {kind} *" if thing.is_read_only and not self.varies(thing) else f"{kind} *"

    def share_variables(self, variables: list[Value]) -> None:
        """Put the results of a branch or loop into the frame, if a piece is being written."""
        for variable in variables if self.piece else []:
            self.share(variable)

    def share_mask(self, mask: str) -> None:
        """Put a mask into the frame, for the pieces that are executed under it."""
        if self.pieces.runs and not self.piece:
            self.frame.add_value("vmask", mask, "bool", True)
            self.write_line(f"f->{mask} = {mask};")

    def divide(self, pieces: Pieces, frame: PieceFrame) -> None:
        """Write the statements that follow in these pieces, with their inputs in this frame."""
        self.pieces, self.piece, self.frame = pieces, 0, frame
        for thing in pieces.inputs:
            if self.names[id(thing)].isidentifier():  # else an argument points to it, as in s->x
                self.share(thing)

    def write_piece(self, number: int, items: list[Any]) -> None:
        """Write these statements as a function of their own, and write the call of that function."""
        lines, depth, outer = self.lines, self.depth, dict[int, str]()
        self.lines, self.depth, self.piece = [], 1, number
        for thing in self.pieces.uses.get(number, []):
            if id(thing) not in self.frame.names:
                continue  # the array is in the frame, or an argument points to it
            outer[id(thing)], name = self.names[id(thing)], self.frame.names[id(thing)]
            kind = self.share_type(thing)
            self.write_line(
                f"{kind}const {name} = f->{name};" if kind[-1] == "*" else f"const {kind} {name} = f->{name};"
            )
            self.names[id(thing)] = name
        if self.masks:
            self.write_line(f"const vmask {self.masks[-1]} = f->{self.masks[-1]};")
        self.write_items(items)
        text, call = self.frame.piece_text(number, self.lines)
        self.frame.functions.append(text)
        self.lines, self.depth, self.piece = lines, depth, 0
        self.names |= outer
        for thing in self.frame.fresh:
            self.names[id(thing)] = f"f->{self.frame.names[id(thing)]}"
        self.frame.fresh.clear()
        self.write_line(call)
