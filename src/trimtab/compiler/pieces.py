"""Division of large programs into pieces: C functions of bounded size, and the values that they share.

The time that a C compiler takes for a function grows faster than its text. So a program that is too large is written as
several functions, which are called one after the other. Values and arrays that several pieces need are in a frame, a
struct that is passed to each piece.
"""

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from trimtab.compiler.ir import TYPES, Block, Define, Emit, If, Local, Loop, Store
from trimtab.compiler.values import Buffer, Value

FUNCTION_STATEMENTS_MAX = 6000
"""Maximum number of statements of one C function. A program with more statements is divided into pieces."""
EXPORTED_STATEMENTS_MAX = 20_000
"""Maximum number of statements of one function of an exported block.

An exported block is compiled once and runs on small processors, where a frame costs more. On a Cortex-M7, the aided INS
in pieces needs 1.8 times the instructions and five times the stack.
"""
PIECE = 400
"""Maximum number of statements of one piece of a divided program."""
CALL_STATEMENTS_MIN = 40
"""Minimum number of statements that become a piece; fewer stay in the calling function."""
STACK = 1 << 14
"""Maximum bytes of a frame on the stack; a larger frame is in the workspace."""
ALIGNMENT = 64
PAIRED = ("sin_of", "cos_of")
PIECE_TEXT = """\
#ifndef TT_PIECE
#if defined(__GNUC__)
#define TT_PIECE static __attribute__((noinline))
#else
#define TT_PIECE static
#endif
#endif
"""


class Pieces(NamedTuple):
    """Division of a program into pieces. Piece 0 is the function that calls the other pieces.

    runs: id of a divided block -> groups of the block's statements, in order, each group with the number of its piece.
    crossing: ids of the values and buffers in the frame.
    uses: piece -> values and buffers that it needs from other pieces.
    inputs: values and buffers in the frame that no piece computes.
    pairs: id of a sincos -> those of its results, sine and cosine, that are needed.
    """

    runs: dict[int, list[tuple[int, list[Any]]]]
    crossing: set[int]
    uses: dict[int, list[Any]]
    inputs: list[Any]
    pairs: dict[int, list[Value]]


NO_PIECES = Pieces({}, set(), {}, [], {})


class PieceFrame:
    """Frame: the data that the pieces of a function share, a struct on the stack or, if too large, in the workspace.

    function: name of the function that is divided.
    lanes: number of runs computed side by side; 0 for scalar code.
    arguments: (type, name) of the arguments of each piece besides the frame.
    names: id of a value or buffer -> name of its member.
    functions: text of the pieces.
    fresh: values and buffers that the piece being written has added to the frame.
    """

    def __init__(self, function: str = "", lanes: int = 0, arguments: Sequence[tuple[str, str]] = ()) -> None:
        self.function, self.lanes, self.arguments = function, lanes, arguments
        self.members: list[tuple[int, int, str]] = []  # (bytes of an element, of the member, C text)
        self.names: dict[int, str] = {}
        self.functions: list[str] = []
        self.fresh: list[Value | Buffer] = []

    def add_value(self, kind: str, name: str, dtype: str, varies: bool) -> None:
        """Add a struct member for a value or mask. kind: C type."""
        size = _byte_count(dtype, self.lanes if varies else 0)
        self.members.append((size, size, f"{kind} {name};"))

    def add_array(self, kind: str, name: str, buffer: Buffer, varies: bool) -> None:
        """Add a struct member that contains an array. kind: C type of its elements."""
        each, count = _byte_count(buffer.dtype, self.lanes if varies else 0), max(buffer.size, 1)
        self.members.append((each, each * count, f"{kind} {name}[{count}];"))

    def add_pointer(self, kind: str, name: str) -> None:
        """Add a struct member that points to an array. kind: C type of the pointer."""
        self.members.append((8, 8, f"{kind}{name};"))

    @property
    def size(self) -> int:
        """Return the size of the struct in bytes, with pointers of eight bytes; 0 if the program is not divided."""
        return -(-sum(size for _, size, _ in self.members) // ALIGNMENT) * ALIGNMENT if self.functions else 0

    @property
    def stack(self) -> int:
        """Return the bytes that the struct takes on the stack: its size, or 0 if it is in the workspace."""
        return self.size if self.size <= STACK else 0

    def text(self) -> str:
        """Return the C text of the struct and of the pieces; empty if the program is not divided."""
        if not self.functions:
            return ""
        members = [f"    {text}" for _, _, text in sorted(self.members, key=lambda m: -m[0])]  # no padding
        return "\n".join([PIECE_TEXT, "typedef struct {", *members, f"}} {self.function}_frame;\n", *self.functions])

    def place(self, workspace: int) -> tuple[str, int]:
        """Return the C declaration of the frame, and the bytes of the workspace including the frame."""
        if not self.functions:
            return "", workspace
        kind = f"{self.function}_frame"
        if self.stack:
            return f"    {kind} space, *const f = &space;", workspace
        return f"    {kind} *const f = ({kind} *)((char *)workspace + {workspace});", workspace + self.size

    def piece_text(self, number: int, lines: list[str]) -> tuple[str, str]:
        """Return the C text of a piece, and the statement that calls it."""
        name, keyword = f"{self.function}_piece{number}", "__restrict" if self.lanes else "restrict"
        given = ", ".join([f"{self.function}_frame *{keyword} f", *(f"{kind}{name}" for kind, name in self.arguments)])
        silence = " ".join(f"(void){name};" for name in ["f", *(name for _, name in self.arguments)])
        text = [f"TT_PIECE void {name}({given})\n{{", *lines, f"    {silence}", "}\n"]
        return "\n".join(text), f"{name}({', '.join(['f', *(name for _, name in self.arguments)])});"


def _byte_count(dtype: str, lanes: int) -> int:
    return 8 * lanes if dtype == "bool" and lanes else TYPES[dtype]().itemsize * max(lanes, 1)


def plan_pieces(
    blocks: list[Block], results: Sequence[Value | Buffer], elsewhere: Collection[int] = (), exported: bool = False
) -> Pieces:
    """Return the division of a program into pieces, or NO_PIECES if the program is small.

    results: values and buffers that are read after the program.
    elsewhere: ids of buffers that the program declares, but that are in the caller's memory.
    exported: True for the program of an exported block.
    """
    if not is_large(blocks, exported):
        return NO_PIECES
    division = _Division(elsewhere)
    for thing in results:
        division.use(0, thing)
    for block in blocks:
        division.divide(block)
    return division.close()


def is_large(blocks: list[Block], exported: bool = False) -> bool:
    """Return True if a program has more statements than one function may have. exported: True for the limit of exported
    blocks."""
    return sum(_count_statements(block.items) for block in blocks) > (
        EXPORTED_STATEMENTS_MAX if exported else FUNCTION_STATEMENTS_MAX
    )


def build_level(blocks: list[Block], lanes: int = 0) -> tuple[str, ...]:
    """Return the optimisation flag for a large program. It halves the build time and costs at most 1/7 of the speed.

    For lanes it is -Og, because -O1 makes vector code hardly faster.
    """
    return ("-Og" if lanes else "-O1",) if is_large(blocks) else ()


def _inner_blocks(item: Any) -> list[Block]:
    if isinstance(item, If):
        return [item.first, item.second]
    return [item.head, item.body] if isinstance(item, Loop) else []


def _count_statements(items: list[Any]) -> int:
    return sum(1 + sum(_count_statements(block.items) for block in _inner_blocks(item)) for item in items)


def _must_stay(item: Any) -> bool:
    """Return True if a statement must stay in the calling function, as it uses the timetable or writes the log."""
    if isinstance(item, Define):
        return item.value.op == "load" and item.value.attr.name.isidentifier()  # else an argument points to the buffer
    return isinstance(item, Emit) or any(_must_stay(i) for block in _inner_blocks(item) for i in block.items)


class _Division:
    def __init__(self, elsewhere: Collection[int]) -> None:
        self.count, self.elsewhere = 0, elsewhere
        self.runs: dict[int, list[tuple[int, list[Any]]]] = {}
        self.owner: dict[int, int] = {}
        self.used: dict[int, dict[int, Any]] = {}
        self.pairs: dict[int, list[Value]] = {}

    def use(self, piece: int, thing: Any) -> None:
        known = thing.data is not None if isinstance(thing, Buffer) else thing is None or thing.op == "const"
        if not known:
            self.used.setdefault(piece, {})[id(thing)] = thing

    def divide(self, block: Block) -> None:
        """Put the statements of a block into pieces. A branch or loop that is too large for a piece is divided, too."""
        runs = self.runs[id(block)] = []
        taken: list[Any] = []
        weight = 0
        for item in [*block.items, None]:
            size = 0 if item is None else _count_statements([item])
            apart = item is None or size > PIECE or _must_stay(item)
            if taken and (apart or weight + size > PIECE):
                self.count += weight >= CALL_STATEMENTS_MIN
                runs.append((self.count if weight >= CALL_STATEMENTS_MIN else 0, taken))
                self.note_items(*runs[-1])
                taken, weight = [], 0
            if item is None:
                break
            if not apart:
                taken.append(item)
                weight += size
                continue
            runs.append((0, [item]))
            self.note_own(0, item)
            for inner in _inner_blocks(item):
                if size > PIECE:
                    self.divide(inner)
                else:
                    self.note_items(0, inner.items)

    def note_items(self, piece: int, items: list[Any]) -> None:
        """Record the values that these statements and the statements nested in them compute and use."""
        for item in items:
            self.note_own(piece, item)
            for block in _inner_blocks(item):
                self.note_items(piece, block.items)

    def note_own(self, piece: int, item: Any) -> None:
        """Record the values that a statement computes and uses, without those of nested statements."""
        if isinstance(item, Define):
            self.note_definition(piece, item.value)
        elif isinstance(item, Local):
            if id(item.buffer) not in self.elsewhere:
                self.owner[id(item.buffer)] = piece
        elif isinstance(item, Store):
            for thing in (item.buffer, item.index, item.value):
                self.use(piece, thing)
        elif isinstance(item, Emit):
            for value in item.values:
                self.use(piece, value)
        else:
            triples = item.joins if isinstance(item, If) else item.carries
            for own, first, second in triples:
                self.owner[id(own)] = piece
                self.use(piece, first)
                self.use(piece, second)
            self.use(piece, item.test)
            if isinstance(item, Loop):
                self.owner[id(item.index)] = piece
                if isinstance(item.count, Value):
                    self.use(piece, item.count)

    def note_definition(self, piece: int, value: Value) -> None:
        if value.op in PAIRED:  # computed in the piece of the sincos
            self.owner[id(value)] = self.owner[id(value.args[0])]
            self.pairs.setdefault(id(value.args[0]), []).append(value)
            return
        self.owner[id(value)] = piece
        for thing in (*value.args, *([value.attr] if value.op == "load" else [])):
            self.use(piece, thing)

    def close(self) -> Pieces:
        uses = {
            piece: [thing for key, thing in things.items() if self.owner.get(key, 0) != piece]
            for piece, things in self.used.items()
        }
        crossing = {id(thing): thing for things in uses.values() for thing in things}
        inputs = [thing for key, thing in crossing.items() if key not in self.owner]
        return Pieces(self.runs, set(crossing), uses, inputs, self.pairs)
