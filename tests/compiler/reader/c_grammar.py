"""Tokens and types of C99 as far as generated text uses them: comments and directives resolved, nothing evaluated."""

import re
import struct
from typing import Any, NamedTuple

TOKEN = re.compile(
    r"(?P<number>0[xX][0-9a-fA-F.]+(?:[pP][+-]?\d+)?[uUlLfF]*|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[uUlLfF]*)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>->|\+\+|--|<<=|>>=|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=|[-+*/%&|^~!<>=?:;,.(){}\[\]])"
    r"|(?P<space>\s+)"
)
CONTROL = ["if", "else", "for", "while", "do", "break", "continue", "return"]
KEYWORDS = frozenset([*CONTROL, "sizeof", "typedef", "struct", "static", "const"])
QUALIFIERS = frozenset(["static", "inline", "const", "restrict", "__restrict", "extern", "volatile"])
BITS = {"i8": 8, "i16": 16, "i32": 32, "i64": 64, "u8": 8, "u16": 16, "u32": 32, "u64": 64, "bool": 1}
NAMES = {f"{'u' if s == 'u' else ''}int{n}_t": f"{s}{n}" for s in "iu" for n in (8, 16, 32, 64)}
NAMES |= {"double": "f64", "float": "f32", "bool": "bool", "int": "i32", "void": "void", "char": "char"}
NAMES |= {"uintptr_t": "u64", "size_t": "u64"}
SIZES = {t: max(b // 8, 1) for t, b in BITS.items()} | {"f64": 8, "f32": 4, "char": 1}


class Refusal(Exception):
    """What a C compiler would diagnose, or what has no defined meaning when it runs."""


class Token(NamedTuple):
    """kind: number, name or sign.  line: of the text, from 1."""

    kind: str
    text: str
    line: int


class Type(NamedTuple):
    """of: a number type such as f64, `void`, `char`, or for a pointer, array or struct what it points to or its name.

    shape: "" for numbers, "*" pointer, "[]" array, "struct".  const: whether what a pointer points to is constant.
    """

    of: Any
    shape: str = ""
    const: bool = False
    size: int = 0


def bounds(t: str) -> tuple[int, int]:
    """Least and greatest number of an integer type."""
    if t == "bool":
        return 0, 1
    return (-(1 << BITS[t] - 1), (1 << BITS[t] - 1) - 1) if t[0] == "i" else (0, (1 << BITS[t]) - 1)


def tokenize(text: str, macros: dict[str, str]) -> list[Token]:
    """The tokens that a compiler with these macros sees; names of macros are replaced."""
    text = re.sub(r"/\*.*?\*/", lambda m: " " + "\n" * m[0].count("\n"), text, flags=re.S)
    known, shown, tokens = dict(macros), [True], []
    taken = [True]
    for line, row in enumerate(text.split("\n"), 1):
        if row.lstrip().startswith("#"):
            word, _, rest = row.lstrip()[1:].strip().partition(" ")
            if word in ("if", "ifdef", "ifndef"):
                test = {"if": rest, "ifdef": f"defined({rest})", "ifndef": f"!defined({rest})"}[word]
                taken.append(_holds(test, known))
                shown.append(shown[-1] and taken[-1])
            elif word == "else":
                shown[-1] = shown[-2] and not taken[-1]
            elif word == "endif":
                shown.pop()
                taken.pop()
            elif word == "define" and shown[-1]:
                name, _, value = rest.partition(" ")
                known[name] = value.strip()
            elif word == "error" and shown[-1]:
                raise Refusal(f"line {line}: {row}")
        elif shown[-1]:
            tokens += _row_tokens(row, line, known)
    return tokens


def _holds(test: str, known: dict[str, str]) -> bool:
    test = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda m: str(int(m[1] in known)), test)
    while re.search(r"[A-Za-z_]\w*", test):
        test = re.sub(r"[A-Za-z_]\w*", lambda m: known.get(m[0], "0") or "0", test)
    return bool(eval(test.replace("&&", " and ").replace("||", " or ").replace("!", " not ").replace(" not =", "!=")))


def _row_tokens(row: str, line: int, known: dict[str, str]) -> list[Token]:
    row = re.sub(r"__attribute__\s*\(\(.*?\)\)", " ", row)
    tokens, at = [], 0
    while at < len(row):
        match = TOKEN.match(row, at)
        if match is None:
            raise Refusal(f"line {line}: no token: {row[at:]!r}")
        at, kind = match.end(), match.lastgroup or ""
        if kind == "name" and match[0] in known:
            tokens += _row_tokens(known[match[0]], line, {k: v for k, v in known.items() if k != match[0]})
        elif kind != "space":
            tokens.append(Token(kind, match[0], line))
    return tokens


def read_number(text: str) -> tuple[Any, str]:
    """Value and type of a literal."""
    match = re.fullmatch(r"(0[xX][0-9a-fA-F.]+(?:[pP][+-]?\d+)?|[\d.]+(?:[eE][+-]?\d+)?)([uUlLfF]*)", text)
    assert match
    body, rest = match[1], match[2].upper()
    hexadecimal = body[:2] in ("0x", "0X")
    if re.search("[.pP]" if hexadecimal else "[.eE]", body):
        number = float.fromhex(body) if hexadecimal else float(body)
        return (struct.unpack("f", struct.pack("f", number))[0], "f32") if rest == "F" else (number, "f64")
    value = int(body, 0)
    wide, unsigned = "LL" in rest, "U" in rest
    for t in ("i32", "u32", "i64", "u64"):
        fits = bounds(t)[0] <= value <= bounds(t)[1]
        decimal = t == "u32" and not unsigned and not hexadecimal
        if fits and not (wide and t[1:] == "32") and not (unsigned and t[0] == "i") and not decimal:
            return value, t
    raise Refusal(f"{text} is too large for any type")


def common_type(a: str, b: str) -> str:
    """The type in which two numbers are computed (C99, 6.3.1.8)."""
    for t in ("f64", "f32"):
        if t in (a, b):
            return t
    a, b = (t if BITS[t] >= 32 else "i32" for t in (a, b))
    order = ("i32", "u32", "i64", "u64")
    return order[max(order.index(a), order.index(b))]
