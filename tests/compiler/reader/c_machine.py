"""Reads generated C99 and makes Python of it, type by type and operator by operator; what is wrong C is refused."""

import math
from collections.abc import Callable
from typing import Any

from compiler.reader import c_memory as memory
from compiler.reader.c_grammar import (
    BITS,
    KEYWORDS,
    NAMES,
    QUALIFIERS,
    SIZES,
    Refusal,
    Token,
    Type,
    bounds,
    common_type,
    read_number,
)
from compiler.reader.c_memory import Memory, Pointer, cell

RANKS = ("||", "&&", "|", "^", "&", "== !=", "< > <= >=", "<< >>", "+ -", "* / %")
LEVELS = {sign: level for level, signs in enumerate(RANKS) for sign in signs.split()}
ASSIGNING = ("=", "++", "--", *(f"{sign}=" for sign in ("|", "^", "&", "<<", ">>", "+", "-", "*", "/", "%")))
KNOWN = {"true": ("True", "bool"), "false": ("False", "bool"), "INFINITY": ("inf", "f32"), "NAN": ("nan", "f32")}
KNOWN |= {"DBL_MIN": (repr(2.0**-1022), "f64"), "DBL_MAX": (repr((2 - 2.0**-52) * 2.0**1023), "f64")}
for t in BITS:
    if t != "bool":
        ends, kind = zip(("_MIN", "_MAX"), bounds(t), strict=True), t if BITS[t] >= 32 else "i32"
        KNOWN |= {f"{'U' * (t[0] == 'u')}INT{t[1:]}{end}": (f"({n})", kind) for end, n in ends}
TYPES = {name.removesuffix("_t"): t for name, t in NAMES.items()} | {"float64": "f64", "float32": "f32"}
"""Names of numpy's types."""
Value = tuple[str, Any]
"""Python of an expression, and its type: a number's name or a Type."""


class Program:
    """Functions of a text, callable by name; `fuel` bounds the turns of all loops of a call."""

    def __init__(self, tokens: list[Token]) -> None:
        self.functions: dict[str, tuple[Any, list[Any]]] = {}
        self.space: dict[str, Any] = {k: getattr(memory, k) for k in dir(memory) if not k.startswith("_")}
        self.space |= {"inf": math.inf, "nan": math.nan, "fuel": memory.Fuel(), "Type": Type}
        self.python = Reader(tokens, self).read()
        exec(self.python, self.space)

    def run(self, name: str, arrays: list[Any], results: list[Any], workspace: int = 0) -> list[list[Any]]:
        """Results, as lists, of a function that takes arrays and results by their addresses.

        arrays: numpy arrays.  results: (type such as f64, count) of each.  workspace: bytes.
        """
        sources = [Pointer(Memory(a.ravel().tolist(), TYPES[a.dtype.name])) for a in arrays]
        places = [cell(t, n) for t, n in results]
        space = Pointer(memory.Workspace(workspace))
        self.call(name, Pointer(Memory(sources, "void")), Pointer(Memory(places, "void")), space, 1)
        return [[memory.at(p, i) for i in range(n)] for p, (_, n) in zip(places, results, strict=True)]

    def call(self, name: str, *arguments: Any, turns: int = 500_000) -> Any:
        """One call; whatever has no meaning is a Refusal."""
        self.space["fuel"].turns = turns
        try:
            return self.space[f"c_{name}"](*arguments)
        except (IndexError, TypeError, AttributeError, OverflowError) as error:
            raise Refusal(f"{type(error).__name__}: {error}") from error


class Variable:
    """A name in scope.  held: its value lies in memory, for its address is taken.  sure: it has a value."""

    def __init__(self, python: str, type_: Any, const: bool, held: bool, sure: bool) -> None:
        self.python, self.type, self.const, self.held, self.sure = python, type_, const, held, sure


class Reader:
    """Recursive descent; each method takes one construct from the tokens and gives, or writes, its Python."""

    def __init__(self, tokens: list[Token], program: Program) -> None:
        self.tokens, self.k, self.program = [*tokens, Token("sign", "end", 0)], 0, program
        self.lines: list[str] = []
        self.depth, self.names = 0, 0
        self.scopes: list[dict[str, Variable]] = [{}]
        self.structs: dict[str, dict[str, Type]] = {}
        self.result: Any = "void"
        triples = zip(tokens, tokens[1:], tokens[2:], strict=False)  # & that begins an expression: it takes an address
        self.held = {c.text for a, b, c in triples if b.text == "&" and a.text in ("(", ",", "=")}

    def read(self) -> str:
        """All functions, tables and structs."""
        while self.text() != "end":
            if self.text() == "typedef":
                self.struct()
                continue
            const = self.qualifiers()
            type_ = self.number_type()
            name = self.name()
            if self.text() == "(":
                self.function(type_, name)
            else:
                self.declaration(type_, const, name)
        return "\n".join(self.lines)

    def text(self) -> str:
        """The next token."""
        return self.tokens[self.k].text

    def fail(self, what: str) -> Refusal:
        return Refusal(f"line {self.tokens[self.k].line}, at {self.text()!r}: {what}")

    def take(self, text: str | None = None) -> str:
        if text is not None and self.text() != text:
            raise self.fail(f"{text!r} is missing")
        self.k += 1
        return self.tokens[self.k - 1].text

    def accept(self, text: str) -> bool:
        same = self.text() == text
        self.k += same
        return same

    def name(self) -> str:
        if self.tokens[self.k].kind != "name" or self.text() in KEYWORDS or self.text() in NAMES:
            raise self.fail("a name is missing")
        return self.take()

    def write(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def struct(self) -> None:
        """typedef struct { TYPE *NAME; TYPE NAME[COUNT]; … } NAME;"""
        fields: dict[str, Type] = {}
        for text in ("typedef", "struct", "{"):
            self.take(text)
        while not self.accept("}"):
            const = self.qualifiers()
            type_, _ = self.stars(self.number_type(), const)
            name, count = self.name(), 1
            shape = "[]" if self.accept("[") else ""
            if shape:
                count, _ = read_number(self.take())
                self.take("]")
            if name in fields:
                raise self.fail(f"{name} is declared twice")
            fields[name] = Type(type_, shape, False, count)
            self.take(";")
        self.structs[self.name()] = fields
        self.take(";")

    def qualifiers(self) -> bool:
        const = False
        while self.text() in QUALIFIERS:
            const |= self.take() == "const"
        return const

    def number_type(self) -> Any:
        if not self.is_type():
            raise self.fail("a type is missing")
        name = self.take()
        return Type(name, "struct") if name in self.structs else NAMES[name]

    def is_type(self) -> bool:
        return self.text() in NAMES or self.text() in self.structs

    def stars(self, type_: Any, const: bool) -> tuple[Any, bool]:
        while self.text() == "*":
            self.take()
            type_, const = Type(type_, "*", const), self.qualifiers()
        return type_, const

    def declare(self, name: str, type_: Any, const: bool, sure: bool) -> Variable:
        if name in self.scopes[-1]:
            raise self.fail(f"{name} is declared twice")
        self.names += 1
        held = name in self.held and not isinstance(type_, Type)
        python = name if len(self.scopes) == 1 else f"{name}_{self.names}"
        self.scopes[-1][name] = variable = Variable(python, type_, const, held, sure)
        return variable

    def function(self, type_: Any, name: str) -> None:
        if name in self.program.functions:
            raise self.fail(f"{name} is defined twice")
        self.scopes.append({})
        self.take("(")
        names = self.several(")", self.parameter)
        self.program.functions[name], self.result = (type_, [v.type for v in names]), type_
        self.write(f"def c_{name}({', '.join(v.python for v in names)}):")
        for v in names:
            if v.held:
                self.write(f"    {v.python} = Pointer(Memory([{v.python}], {v.type!r}))")
        self.block()
        self.write("    return None" if type_ == "void" else "    return known(None)")
        self.scopes.pop()

    def parameter(self) -> Variable:
        const = self.qualifiers()
        kind, const = self.stars(self.number_type(), const)
        return self.declare(self.name(), kind, const, True)

    def several(self, end: str, item: Callable[[], Any]) -> list[Any]:
        """What stands between commas up to this end."""
        items: list[Any] = []
        while not self.accept(end):
            items.append(item())
            if self.text() != end:
                self.take(",")
        return items

    def block(self) -> None:
        """{ … }, or one statement, one step further in."""
        self.depth += 1
        self.scopes.append({})
        if self.accept("{"):
            while not self.accept("}"):
                self.statement()
        else:
            self.statement()
        self.write("pass")
        self.scopes.pop()
        self.depth -= 1

    def statement(self) -> None:
        word = self.text()
        if word == "{":
            self.write("if True:")
            return self.block()
        if word == "if":
            return self.branch()
        if word in ("for", "while"):
            return self.loop()
        if word in ("const", "static") or self.is_type():
            const = self.qualifiers()
            return self.declaration(self.number_type(), const)
        if word == "break":
            self.write(self.take())
        elif word == "return":
            self.take()
            value = "" if self.text() == ";" else self.convert(self.expression(), self.result)
            if (value == "") != (self.result == "void"):
                raise self.fail("a result that the function does not have, or none")
            self.write(f"return {value}")
        elif word != ";":
            self.write(self.action())
            while self.accept(","):
                self.write(self.action())
        self.take(";")

    def branch(self) -> None:
        self.take("if")
        self.take("(")
        self.write(f"if {self.truth(self.expression())}:")
        self.take(")")
        self.block()
        if self.accept("else"):
            self.write("else:")
            self.block()

    def loop(self) -> None:
        self.scopes.append({})
        kind, test, turn = self.take(), "True", ""
        self.take("(")
        if kind == "for":
            if self.text() in NAMES:
                self.declaration(self.number_type(), False)
            else:
                self.take(";")
            test = test if self.text() == ";" else self.truth(self.expression())
            self.take(";")
            turn = "" if self.text() == ")" else self.action()
        else:
            test = self.truth(self.expression())
        self.take(")")
        self.write(f"while {test}:")
        self.write("    fuel.burn()")
        self.block()
        self.write(f"    {turn or 'pass'}")
        self.scopes.pop()

    def declaration(self, base: Any, const: bool, name: str = "") -> None:
        """One type and its names, each with or without a value."""
        while True:
            type_, fixed = (base, const) if name else self.stars(base, const)
            name = name or self.name()
            if self.accept("["):
                count, _ = read_number(self.take())
                self.take("]")
                v = self.declare(name, Type(type_, "[]", fixed, count), fixed, True)
                self.array(v, type_, count)
            elif self.accept("="):
                value = self.convert(self.expression(), type_)
                v = self.declare(name, type_, fixed, True)
                self.write(f"{v.python} = {f'Pointer(Memory([{value}], {type_!r}))' if v.held else value}")
            else:
                struct = isinstance(type_, Type) and type_.shape == "struct"
                v = self.declare(name, type_, fixed, struct)
                self.write(f"{v.python} = {self.cells(type_.of) if struct else f'cell({type_!r})' if v.held else None}")
            name = ""
            if not self.accept(","):
                break
        self.take(";")

    def array(self, v: Variable, type_: Any, count: int) -> None:
        values: list[str] = []
        if self.accept("="):
            self.take("{")
            values = self.several("}", lambda: self.convert(self.expression(), type_))
            if len(values) > count:
                raise self.fail(f"{len(values)} numbers for {count}")
            values += [self.convert(("0", "i32"), type_)] * (count - len(values))
        numbers = f"[{', '.join(values)}]" if values else f"[None] * {count}"
        self.write(f"{v.python} = Pointer(Memory({numbers}, {type_!r}))")

    def action(self) -> str:
        """An expression for what it does: an assignment, a count, a call."""
        if [t.text for t in self.tokens[self.k : self.k + 3]] == ["(", "void", ")"]:
            self.k += 3
            return self.expression()[0]
        start = self.k
        value = self.unary(stored=True)
        sign = self.text()
        if sign in (";", ",") and self.tokens[start].kind == "name" and self.tokens[start + 1].text == "(":
            return value[0]
        old = f"known({value[0]})" if "(" not in value[0] else value[0]
        if sign not in ASSIGNING:
            raise self.fail("this does nothing")
        self.take()
        new = ("1", "i32") if sign in ("++", "--") else self.expression()
        if sign != "=":
            new = self.arithmetic(sign[0] if sign in ("++", "--") else sign[:-1], (old, value[1]), new)
        text = self.convert(new, value[1])
        if value[0].startswith("at(") and value[0].endswith(")"):
            return f"put({value[0][3:-1]}, {text})"
        return f"{value[0]} = {text}"

    def expression(self) -> Value:
        test = self.binary(0)
        if not self.accept("?"):
            return test
        first = self.expression()
        self.take(":")
        second = self.expression()
        if isinstance(first[1], Type) or isinstance(second[1], Type):
            raise self.fail("a choice of pointers")
        t = first[1] if first[1] == second[1] and first[1] in ("f32", "f64") else common_type(first[1], second[1])
        return f"({self.convert(first, t)} if {self.truth(test)} else {self.convert(second, t)})", t

    def binary(self, least: int) -> Value:
        """Operators that bind as closely as this, or closer."""
        left = self.unary()
        while (level := LEVELS.get(self.text(), -1)) >= least:
            sign = self.take()
            right = self.binary(level + 1)
            if sign in ("&&", "||"):
                word = "and" if sign == "&&" else "or"
                left = f"({self.truth(left)} {word} {self.truth(right)})", "i32"
            else:
                left = self.arithmetic(sign, left, right)
        return left

    def arithmetic(self, sign: str, a: Value, b: Value) -> Value:
        if isinstance(a[1], Type) and a[1].shape == "*" and sign == "+" and a[1].of == "char" and b[1] in BITS:
            return f"shift_pointer({a[0]}, {b[0]})", a[1]
        if isinstance(a[1], Type) or isinstance(b[1], Type) or "void" in (a[1], b[1]):
            raise self.fail(f"{sign} of {a[1]} and {b[1]}")
        if sign in ("<<", ">>"):
            t = common_type(a[1], "i32")
            return f"shift({self.convert(a, t)}, {b[0]}, {t!r}, {sign == '<<'})", t
        t = common_type(a[1], b[1])
        x, y = self.convert(a, t), self.convert(b, t)
        if sign in ("==", "!=", "<", ">", "<=", ">="):
            return f"({x} {sign} {y})", "i32"
        if t in ("f64", "f32"):
            if sign not in ("+", "-", "*", "/"):
                raise self.fail(f"{sign} of {t}")
            value = f"divide({x}, {y})" if sign == "/" else f"({x} {sign} {y})"
            return (f"single({value})" if t == "f32" else value), t
        if sign in ("/", "%"):
            return f"{'quotient' if sign == '/' else 'remainder'}({x}, {y}, {t!r})", t
        value = f"({x} {sign} {y})"
        return (self.wrap(value, t) if sign in ("+", "-", "*") else value), t

    def wrap(self, value: str, t: str) -> str:
        if t[0] == "u":
            return f"({value} & {bounds(t)[1]})"
        half = 1 << BITS[t] - 1
        return f"((({value} + {half}) & {2 * half - 1}) - {half})"

    def unary(self, stored: bool = False) -> Value:
        sign = self.text()
        if sign in ("-", "~", "!", "+") and not stored:
            self.take()
            value = self.unary()
            if sign == "!":
                return f"(not {self.truth(value)})", "i32"
            if isinstance(value[1], Type):
                raise self.fail(f"{sign} of a pointer")
            t = value[1] if value[1] in ("f64", "f32") else common_type(value[1], "i32")
            if sign == "~" and t in ("f64", "f32"):
                raise self.fail("~ of a floating-point number")
            result = f"({sign}{self.convert(value, t)})"
            return (result if t in ("f64", "f32") else self.wrap(result, t)), t
        if self.accept("*"):
            return self.element(self.unary(), ("0", "i32"), stored)
        if self.accept("&"):
            v = self.variable(self.name())
            if isinstance(v.type, Type) and v.type.shape == "struct":
                return v.python, Type(v.type, "*")
            if not v.held:
                raise self.fail("the address of this")
            return v.python, Type(v.type, "*", v.const)
        if self.accept("sizeof"):
            return str(SIZES[self.variable(self.name()).type]), "u64"
        if sign == "(" and (self.tokens[self.k + 1].text in (*NAMES, *self.structs, "const")):
            self.take()
            const = self.qualifiers()
            t, _ = self.stars(self.number_type(), const)
            self.take(")")
            return self.convert(self.unary(), t, explicit=True), t
        return self.suffixes(self.primary(stored), stored)

    def suffixes(self, value: Value, stored: bool) -> Value:
        while self.text() in ("[", "->"):
            if self.accept("->"):
                value = self.field(value, self.name())
                continue
            self.take()
            index = self.expression()
            self.take("]")
            value = self.element(value, index, stored and self.text() != "[")
        return value

    def cells(self, struct: str) -> str:
        """A struct in memory: a place for each member, which nobody has written."""
        return f"{{{', '.join(f'{n!r}: cell({t.of!r}, {t.size})' for n, t in self.structs[struct].items())}}}"

    def field(self, pointer: Value, name: str) -> Value:
        """A member of the struct that is pointed to: a number or pointer in it, or where an array of it begins."""
        t = pointer[1]
        fields = self.structs.get(t.of.of, {}) if isinstance(t, Type) and isinstance(t.of, Type) else {}
        if name not in fields:
            raise self.fail(f"{name} of {t}")
        place, kind = f"{pointer[0]}[{name!r}]", fields[name]
        return (place, kind) if kind.shape else (f"at({place}, 0)", kind.of)

    def element(self, pointer: Value, index: Value, stored: bool) -> Value:
        t = pointer[1]
        if not isinstance(t, Type) or t.of == "void" or index[1] not in BITS:
            raise self.fail(f"an element of {t}")
        if stored and t.const:
            raise self.fail("assignment to what is constant")
        return f"at({pointer[0]}, {index[0]})", t.of

    def variable(self, name: str) -> Variable:
        for scope in reversed(self.scopes):
            if name in scope:
                return scope[name]
        raise self.fail(f"{name} is not declared")

    def primary(self, stored: bool) -> Value:
        token = self.tokens[self.k]
        if token.kind == "number":
            value, t = read_number(self.take())
            return (f"({value!r})" if value == value else "nan"), t
        if self.accept("("):
            value = self.expression()
            self.take(")")
            return value
        name = self.name()
        if name in KNOWN:
            return KNOWN[name]
        if self.text() == "(":
            return self.called(name)
        v = self.variable(name)
        fixed = v.const or (isinstance(v.type, Type) and v.type.shape == "[]")
        if stored and fixed and self.text() not in ("[", "->"):
            raise self.fail(f"assignment to {name}, which is constant")
        python = f"at({v.python}, 0)" if v.held else v.python
        return (python if v.sure or v.held or stored else f"known({python})"), v.type

    def called(self, name: str) -> Value:
        self.take("(")
        given: list[Value] = self.several(")", self.expression)
        if name in ("UINT64_C", "INT64_C", "__builtin_expect"):
            return given[0][0], {"U": "u64", "I": "i64"}.get(name[0], given[0][1])
        if name == "memcpy":
            return f"copy_bytes({', '.join(g[0] for g in given)})", "void"
        if name in self.program.functions:
            result, kinds = self.program.functions[name]
            python = f"c_{name}"
        else:
            function = memory.library_function(name)
            if function is None:
                raise self.fail(f"{name} is no function")
            self.program.space[f"m_{name}"], count, result = function
            kinds, python = [result] * count, f"m_{name}"
        if len(kinds) != len(given):
            raise self.fail(f"{name} takes {len(kinds)} arguments")
        call = f"{python}({', '.join(self.convert(g, t) for g, t in zip(given, kinds, strict=True))})"
        return (call if result == "void" or python[0] == "m" else f"known({call})"), result

    def truth(self, value: Value) -> str:
        if value[1] == "void" or isinstance(value[1], Type):
            raise self.fail("this is neither true nor false")
        return value[0]

    def convert(self, value: Value, t: Any, explicit: bool = False) -> str:
        python, s = value
        if isinstance(t, Type) or isinstance(s, Type):
            return self.convert_pointer(value, t, explicit)
        if s == t and t != "void":
            return python
        if "void" in (s, t):
            raise self.fail("nothing is no number")
        if t == "bool":
            return f"({python} != 0)"
        if t == "f64":
            return python if s == "f32" else f"float({python})"
        if t == "f32":
            return f"single({python})"
        if s in ("f64", "f32"):
            return f"truncate({python}, {t!r})"
        if bounds(t)[0] <= bounds(s)[0] and bounds(s)[1] <= bounds(t)[1]:
            return python
        return self.wrap(python, t)

    def convert_pointer(self, value: Value, t: Any, explicit: bool) -> str:
        python, s = value
        if not (isinstance(t, Type) and isinstance(s, Type) and t.shape == "*"):
            raise self.fail(f"{s} is no {t}")
        if not explicit and ((s.const and not t.const) or (s.of != t.of and "void" not in (s.of, t.of))):
            raise self.fail(f"{s} is given for {t}")
        if isinstance(t.of, Type) and t.of.shape == "struct" and explicit and s.of == "char":
            return self.cells(t.of.of)
        return python if s.of == t.of else f"cast_pointer({python}, {t.of!r})"
