"""Seeded changes of generated text at random places, one at a time.

Only what the generator wrote is changed: the function `go` and the tables, not the fixed functions before it, which
have tests of their own. A change is a different program by construction:

- an operator becomes another one: + -, * /, & |, < with its contrary >= or its mirror >, == with !=, % to /
- a name in an expression becomes another in scope of the same type, the nearest of those
- a constant changes in one of its first ten digits or its sign; a whole number (bound, index) becomes one more or less,
  except in the test of a clamp: x < 9 ? x : 9 is x < 10 ? x : 9; for the same reason < does not become <=, and the
  name in that test stays: of two numbers that are the same where they are positive either may be asked
- a statement is deleted, or exchanged with the next where that one reads what this one writes
- the arms of a choice are exchanged; a cast is removed, but not right after =, which converts alike, nor to uint64_t
  of one operand whose other has it too: that gives its type to both
"""

import random
import re
from collections.abc import Iterator
from typing import NamedTuple

from compiler.reader.c_grammar import NAMES, Token

OTHERS = {"+": "-", "-": "+", "*": "/+", "/": "*", "&": "|^", "|": "&", "^": "&", "%": "/", "<<": [">>"], ">>": ["<<"]}
OTHERS |= {"<": [">=", ">"], ">=": ["<"], ">": ["<=", "<"], "<=": [">"], "==": ["!="], "!=": ["=="]}
OTHERS |= {"++": ["--"], "&&": ["||"], "||": ["&&"]}
LOCAL = re.compile(r"(?:v|a|i|in|out|table|j)\d*(?:_\d+)?[sc]?")


class Mutation(NamedTuple):
    """kind and place of a change, with the changed tokens."""

    kind: str
    line: int
    what: str
    tokens: list[Token]


class Mutator:
    """All that may be changed in the tokens of a text, from the function `go` on."""

    def __init__(self, tokens: list[Token]) -> None:
        self.tokens = tokens
        self.first = next(k for k, t in enumerate(tokens) if t.text == "go")
        start = next(k for k in range(self.first, len(tokens)) if tokens[k].text == "{") + 1
        self.types = self._types(start)
        self.body = range(start, len(tokens) - 17)  # without (void)in; (void)out; (void)workspace; (void)runs; }
        self.excluded = 0
        """Places in the test of a clamp, and casts right after =."""
        self.places = [k for k in self.body if self._kinds(k)]

    def mutations(self, seed: int) -> Iterator[Mutation]:
        """In random order, no text twice, until none is new."""
        draw, seen, idle = random.Random(seed), set(), 0
        while idle < 2000:
            idle += 1
            k = draw.choice(self.places)
            kind = draw.choice(self._kinds(k))
            new = getattr(self, f"_{kind}")(k, draw)
            if new is None:
                continue
            tokens, what = new
            text = " ".join(t.text for t in tokens)
            if text not in seen:
                seen.add(text)
                idle = 0
                yield Mutation(kind, self.tokens[k].line, what, tokens)

    def _types(self, start: int) -> dict[str, str]:
        """Type of each local, as it is written."""
        types = {}
        for k in range(start, len(self.tokens)):
            if self.tokens[k].text in NAMES and self.tokens[k - 1].text != "(":
                j, words = k + 1, [self.tokens[k].text]
                while self.tokens[j].text in ("*", "const", "restrict"):
                    words += ["*"] * (self.tokens[j].text == "*")
                    j += 1
                array = self.tokens[j + 1].text == "["
                types[self.tokens[j].text] = " ".join(words) + (" *" if array else "")
        return types

    def _kinds(self, k: int) -> list[str]:
        token, before = self.tokens[k], self.tokens[k - 1].text
        after = self.tokens[k + 1].text
        if token.kind == "number":
            clamp = after == "?" and self.tokens[k + 4].text == token.text
            self.excluded += clamp
            return [] if clamp or (before == "[" and self._declares(k)) else ["constant"]
        if token.text in OTHERS:
            unary = before in ("=", "(", ",", "?", ":", "return", "&", "|", "*") or (
                token.text == "*" and before in NAMES
            )
            return [] if unary or after == ")" else ["operator"]
        if token.text == "?":
            return ["arms"]
        if token.text in (";", "{", "}"):
            return ["deletion", "exchange"]
        if token.text == "(" and after in NAMES and self.tokens[k + 2].text == ")":
            alike = before == "=" or (after == "uint64_t" and self._is_shared(k))
            self.excluded += alike
            return [] if alike else ["cast"]
        clamp = self.tokens[k + 3].text == "?" and self.tokens[k + 4].text == token.text
        self.excluded += clamp
        return (
            ["name"]
            if not clamp and token.kind == "name" and token.text in self.types and not self._declares(k)
            else []
        )

    def _is_shared(self, k: int) -> bool:
        """Whether the other operand of +, - or * is cast alike; k: the cast's parenthesis."""
        texts = [t.text for t in self.tokens]
        end = next(i for i in range(k + 3, len(texts)) if texts[i] in ("+", "-", "*", ")", ";", ","))
        cast = ["(", texts[k + 1], ")"]
        before = texts[max(k - 8, 0) : k - 1]
        first = any(before[i : i + 3] == cast for i in range(len(before))) and ";" not in before
        return (texts[end] in "+-*" and texts[end + 1 : end + 4] == cast) or (texts[k - 1] in "+-*" and first)

    def _declares(self, k: int) -> bool:
        k -= 2 if self.tokens[k].kind == "number" else 0
        return (
            self.tokens[k - 1].text in (*NAMES, "restrict") or self.tokens[k - 1].text == "*" == self.tokens[k - 2].text
        )

    def _replace(self, first: int, last: int, *texts: str) -> tuple[list[Token], str]:
        """With other tokens in the place of those from first to before last."""
        line = self.tokens[first].line
        kinds = ["number" if t[0].isdigit() else "name" if t[0].isalpha() else "sign" for t in texts]
        new = [Token(kind, t, line) for kind, t in zip(kinds, texts, strict=True)]
        old = " ".join(t.text for t in self.tokens[first:last])
        return [*self.tokens[:first], *new, *self.tokens[last:]], f"{old} -> {' '.join(texts)}"

    def _operator(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        one = any(t.text.rstrip("L") in ("1", "1.0") for t in self.tokens[k + 1 : k + 4])
        others = "+" if one and self.tokens[k].text in "*/" else OTHERS[self.tokens[k].text]  # x * 1 is x / 1
        return self._replace(k, k + 1, draw.choice(others))

    def _constant(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        text = self.tokens[k].text
        if re.fullmatch(r"\d+[UL]*", text):
            number, end = re.match(r"(\d+)(.*)", text).groups()  # pyright: ignore[reportOptionalMemberAccess]
            return self._replace(k, k + 1, f"{abs(int(number) + draw.choice((-1, 1)))}{end}")
        if text[:2] == "0x" or draw.random() < 0.2:
            return None if float(text.rstrip("f")) == 0 else self._replace(k, k + 1, "(", "-", text, ")")
        digits = [m.start() for m in re.finditer(r"\d", text.split("e")[0])]
        shown = [d for d in digits if text[: d + 1].strip("0.")] or digits
        at = draw.choice(shown[:10])
        return self._replace(k, k + 1, text[:at] + str((int(text[at]) + draw.randint(1, 9)) % 10) + text[at + 1 :])

    def _name(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        name = self.tokens[k].text
        near = dict.fromkeys(t.text for t in self.tokens[max(k - 90, self.body.start) : k + 30])
        others = [n for n in near if n != name and self.types.get(n) == self.types[name]]
        return self._replace(k, k + 1, draw.choice(others)) if others else None

    def _statement(self, k: int) -> int | None:
        """The end of the plain statement after this place."""
        j = k + 1
        while j < self.body.stop and self.tokens[j].text not in ("{", "}", ";", "for", "if"):
            j += 1
        return j + 1 if j < self.body.stop and self.tokens[j].text == ";" and j > k + 1 else None

    def _deletion(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        end = self._statement(k)
        return None if end is None or "for" in (t.text for t in self.tokens[k - 12 : k]) else self._replace(k + 1, end)

    def _exchange(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        middle = self._statement(k)
        end = None if middle is None else self._statement(middle - 1)
        if middle is None or end is None:
            return None
        first, second = ([t.text for t in self.tokens[a:b]] for a, b in ((k + 1, middle), (middle, end)))
        if "=" not in first or "=" not in second:
            return None
        if first[first.index("=") - 1] not in second[second.index("=") :]:
            return None
        return self._replace(k + 1, end, *second, *first)

    def _arms(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        middle = next(j for j in range(k, len(self.tokens)) if self.tokens[j].text == ":")
        depth, end = 0, middle + 1
        while self.tokens[end].text not in (";", ",") and depth >= 0:
            depth += {"(": 1, ")": -1}.get(self.tokens[end].text, 0)
            end += depth >= 0
        first, second = ([t.text for t in self.tokens[a:b]] for a, b in ((k + 1, middle), (middle + 1, end)))
        return self._replace(k + 1, end, *second, ":", *first)

    def _cast(self, k: int, draw: random.Random) -> tuple[list[Token], str] | None:
        return self._replace(k, k + 3)
