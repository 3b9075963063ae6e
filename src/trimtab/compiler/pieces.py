"""Large programs in pieces: functions of bounded size, and which values and arrays go from one to another.

A C compiler's time for one function grows faster than its text. What is too large is written as functions that
are called one after the other; what several of them need lies in a frame, a struct that each is given.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from trimtab.compiler.ir import Block, Buffer, Define, Emit, If, Local, Loop, Store, Value

WHOLE = 6000
"""Statements that one function may have."""
PIECE = 1000
"""Statements of each piece of a program that has more."""
LEAST = 40
"""Fewer statements than this are not worth a call."""
PAIRED = ("sin_of", "cos_of")


class Pieces(NamedTuple):
    """How a program is divided. Piece 0 is the function that calls the others.

    runs: id of a block that is divided -> its statements in order, with the number of their piece.
    crossing: ids of what lies in the frame.  uses: piece -> what it needs from others.  inputs: what is in the frame
    and nobody computes.  pairs: id of a sincos -> the sine and cosine that are needed of it.
    """

    runs: dict[int, list[tuple[int, list[Any]]]]
    crossing: set[int]
    uses: dict[int, list[Any]]
    inputs: list[Any]
    pairs: dict[int, list[Value]]


NO_PIECES = Pieces({}, set(), {}, [], {})


class PieceFrame:
    """What pieces of a program share. members: of the struct.  names: of the values in it and of the places of inputs.

    functions: text of the pieces.  fresh: what the present piece has added.
    """

    def __init__(self) -> None:
        self.members: list[str] = []
        self.names: dict[int, str] = {}
        self.functions: list[str] = []
        self.fresh: list[Value | Buffer] = []

    def text(self) -> str:
        """The struct and the functions; nothing for a program in one piece."""
        if not self.functions:
            return ""
        members = [f"    {line}" for line in self.members]
        return "\n".join(["typedef struct {", *members, "} frame;\n", *self.functions])


def plan_pieces(blocks: list[Block], results: Sequence[Value | Buffer]) -> Pieces:
    """Divide a program of too many statements; results: what is read after it."""
    if not is_large(blocks):
        return NO_PIECES
    division = _Division()
    for thing in results:
        division.use(0, thing)
    for block in blocks:
        division.divide(block)
    return division.close()


def is_large(blocks: list[Block]) -> bool:
    """Whether a program has more statements than one function may have."""
    return sum(_count_statements(block.items) for block in blocks) > WHOLE


def _inner_blocks(item: Any) -> list[Block]:
    if isinstance(item, If):
        return [item.first, item.second]
    return [item.head, item.body] if isinstance(item, Loop) else []


def _count_statements(items: list[Any]) -> int:
    return sum(1 + sum(_count_statements(block.items) for block in _inner_blocks(item)) for item in items)


def _must_stay(item: Any) -> bool:
    """Whether a statement needs what only the first function has: the timetable, the log."""
    if isinstance(item, Define):
        return item.value.op == "load" and bool(item.value.attr.name)
    return isinstance(item, Emit) or any(_must_stay(i) for block in _inner_blocks(item) for i in block.items)


class _Division:
    def __init__(self) -> None:
        self.count = 0
        self.runs: dict[int, list[tuple[int, list[Any]]]] = {}
        self.owner: dict[int, int] = {}
        self.used: dict[int, dict[int, Any]] = {}
        self.pairs: dict[int, list[Value]] = {}

    def use(self, piece: int, thing: Any) -> None:
        known = thing.data is not None if isinstance(thing, Buffer) else thing is None or thing.op == "const"
        if not known:
            self.used.setdefault(piece, {})[id(thing)] = thing

    def divide(self, block: Block) -> None:
        """Put the statements of a block in pieces; a branch or loop that is too large is divided itself."""
        runs = self.runs[id(block)] = []
        taken: list[Any] = []
        weight = 0
        for item in [*block.items, None]:
            size = 0 if item is None else _count_statements([item])
            apart = item is None or size > PIECE or _must_stay(item)
            if taken and (apart or weight + size > PIECE):
                self.count += weight >= LEAST
                runs.append((self.count if weight >= LEAST else 0, taken))
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
        """Note what these statements compute and use, nested ones included."""
        for item in items:
            self.note_own(piece, item)
            for block in _inner_blocks(item):
                self.note_items(piece, block.items)

    def note_own(self, piece: int, item: Any) -> None:
        """Note what a statement computes and uses itself."""
        if isinstance(item, Define):
            self.note_definition(piece, item.value)
        elif isinstance(item, Local):
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
        if value.op in PAIRED:  # comes with the sincos, wherever that is
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
