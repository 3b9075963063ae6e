"""Random branches and loops: bodies are written as inner functions that see the variables around them."""

from typing import Any

from contracts.variables import DTYPES, Var

Statements = list[tuple[str, str]]


def _body(w: Any, env: list[Var], arguments: list[Var], depth: int, count: int) -> tuple[list[Var], Statements]:
    """Statements of an inner function; gives what can be read at its end."""
    inner, statements = [*env, *arguments], []
    for _ in range(count):
        w.statement(inner, statements, depth + 1)
    return inner, statements


def _function(arguments: list[str], statements: Statements, result: str) -> str:
    """An expression that is a function: its statements are the assignments of one lambda after another."""
    text = result
    for name, value in reversed(statements):
        text = f"(lambda {name}: {text})({value})"
    return f"lambda {', '.join(arguments)}: {text}"


def _result(w: Any, inner: list[Var], like: Var) -> tuple[str, Var]:
    """A value of the type and shape of `like` at the end of a body."""
    found = w.pick(inner, like.kind, like.shape)
    text = w.whole(found, like.shape)
    if like.kind == "f" and not like.exact and found.exact:
        text, found = f"jnp.clip({text}, -1.0, 1.0)", found._replace(exact=False, growth=1.0)
    return f"jnp.asarray({text}, '{_dtype(like)}')", found


def _dtype(v: Var) -> str:
    return DTYPES[v.kind]


def _carried(w: Any, env: list[Var]) -> list[Var]:
    """Variables that a branch takes or a loop carries: mostly arrays, sometimes one twice."""
    found = [
        w.pick(env, w.one(["f", "f", "i32", "i64", "u32", "b"]), w.one(w.shapes[1:])) for _ in range(w.one([1, 2, 3]))
    ]
    return found if w.chance(0.7) else [*found, found[0]]


def _named(w: Any, v: Var) -> Var:
    return v._replace(name=w.fresh())


def _give(w: Any, env: list[Var], statements: Statements, text: str, made: list[Var]) -> None:
    """Name the results of one expression."""
    whole = w.fresh()
    statements.append((whole, text))
    for k, v in enumerate(made):
        name = w.fresh()
        statements.append((name, f"{whole}[{k}]"))
        env.append(v._replace(name=name))


def branch(w: Any, env: list[Var], statements: Statements, depth: int) -> None:
    """cond or switch, of results whose floats are exact only where all sides give exact ones."""
    operands = _carried(w, env)
    count = w.one([2, 2, 3, 4])
    sides, results = [], []
    for _ in range(count):
        arguments = [_named(w, v) for v in operands]
        inner, body = _body(w, env, arguments, depth, int(w.rng.integers(0, 4)))
        ends = [_result(w, inner, v) for v in operands]
        sides.append(_function([v.name for v in arguments], body, f"({''.join(t + ', ' for t, _ in ends)})"))
        results.append([v for _, v in ends])
    given = "".join(f", jnp.asarray({v.name}, '{_dtype(v)}')" for v in operands)
    if count == 2:
        test = w.pick(env, "b", ()).name
        text = f"lax.cond({test}, {sides[0]}, {sides[1]}{given})"
    else:
        text = f"lax.switch({w.pick(env, w.one(['i32', 'i64']), ()).name}, [{', '.join(sides)}]{given})"
    made = []
    for v, *ends in zip(operands, *results, strict=True):
        if v.kind == "f":
            exact = all(e.exact for e in ends)
            v = v._replace(exact=exact, size=max(e.size for e in ends), fine=max(e.fine for e in ends))
            v = v._replace(growth=max(e.growth for e in ends))
        made.append(v)
    whole = w.fresh()
    statements.append((whole, text))
    for k, v in enumerate(made):
        name = w.fresh()
        text = f"{whole}[{k}]"
        if v.kind == "f" and not v.exact:
            text = f"jnp.clip({text}, -1.0, 1.0)"
        statements.append((name, text))
        env.append(v._replace(name=name))


def _turn(
    w: Any, env: list[Var], depth: int, extra: list[Var]
) -> tuple[list[Var], list[Var], Statements, list[str], list[Var]]:
    """What one turn of a loop does to what it carries; floats that are carried are bounded and not exact."""
    starts = _carried(w, env)
    carried = [_named(w, v)._replace(exact=v.kind != "f", growth=1.0) for v in starts]
    inner, body = _body(w, env, [*carried, *extra], depth, int(w.rng.integers(1, 5)))
    nexts = []
    for v in carried:
        if v.kind == "f":
            found = w.pick(inner, "f", v.shape)
            slow = found.exact or found.growth <= 10
            term = f"0.25 * jnp.clip({w.whole(found, v.shape)}, -1.0, 1.0)" if slow else "0.0"
            text = v.name if w.chance(0.15) else f"0.5 * {v.name} + {term}"
            nexts.append(f"jnp.asarray({text}, 'float64')")
        else:
            nexts.append(_result(w, inner, v)[0])
    return starts, carried, body, nexts, inner


def _starting(starts: list[Var]) -> str:
    texts = [f"jnp.clip({v.name}, -1.0, 1.0)" if v.kind == "f" else v.name for v in starts]
    return "".join(f"jnp.asarray({t}, '{_dtype(v)}'), " for t, v in zip(texts, starts, strict=True))


def _after(carried: list[Var], turns: int) -> list[Var]:
    return [v._replace(exact=v.kind != "f", growth=3.0**turns if v.kind == "f" else 1.0) for v in carried]


def _unpacked(carried: list[Var], of: str) -> Statements:
    return [(v.name, f"{of}[{k}]") for k, v in enumerate(carried)]


def fori(w: Any, env: list[Var], statements: Statements, depth: int) -> None:
    """fori_loop, of a number of turns that is known or not."""
    index = Var(w.fresh(), "i64", ())
    starts, carried, body, nexts, _ = _turn(w, env, depth, [index])
    turn = _function([index.name, "c"], [*_unpacked(carried, "c"), *body], f"({', '.join(nexts)},)")
    limit = w.one(["4", f"{w.pick(env, 'i64', ()).name} % 5"])
    _give(w, env, statements, f"lax.fori_loop(0, {limit}, {turn}, ({_starting(starts)}))", _after(carried, 4))


def repeat(w: Any, env: list[Var], statements: Statements, depth: int) -> None:
    """while_loop, that ends by a count and an integer or truth of its own."""
    starts, carried, body, nexts, _ = _turn(w, env, depth, [])
    turn = _function(["c"], [*_unpacked(carried, "c[1]"), *body], f"(c[0] + 1, ({', '.join(nexts)},))")
    tests = ["True"]
    for k, v in enumerate(carried):
        if v.kind != "f":
            tests.append(
                f"(c[1][{k}]{'.ravel()[0]' if v.shape else ''} % 3 != 0)" if v.kind != "b" else f"jnp.any(c[1][{k}])"
            )
    most = w.one(["4", f"{w.pick(env, 'i64', ()).name} % 5"])
    test = f"lambda c: (c[0] < {most}) & {w.one(tests)}"
    _give(w, env, statements, f"lax.while_loop({test}, {turn}, (0, ({_starting(starts)})))[1]", _after(carried, 4))


def scan(w: Any, env: list[Var], statements: Statements, depth: int) -> None:
    """scan over an array's rows, with results of each turn; forwards or backwards."""
    shape = w.one([(w.m,), (w.m, w.n)])
    source = w.pick(env, w.one(["f", "i32", "i64", "u32", "b"]), (w.n, w.m) if len(shape) == 2 else shape)
    whole = w.whole(source, (w.n, w.m) if len(shape) == 2 else shape) + (".T" if len(shape) == 2 else "")
    row = source._replace(name="u", shape=shape[1:])
    row = row._replace(name=w.fresh())
    starts, carried, body, nexts, inner = _turn(w, env, depth, [row])
    out = w.pick(inner, w.one(["f", "i32", "b"]), w.one([(), (w.n,)]))
    inside = f"(({', '.join(nexts)},), jnp.asarray({out.name}, '{_dtype(out)}'))"
    turn = _function(["c", row.name], [*_unpacked(carried, "c"), *body], inside)
    whole_name = w.fresh()
    backwards = w.chance(0.4)
    statements.append((whole_name, f"lax.scan({turn}, ({_starting(starts)}), {whole}, reverse={backwards})"))
    _give(w, env, statements, f"{whole_name}[0]", _after(carried, w.m if w.m < 5 else 5))
    if out.kind == "f" and not out.exact:
        out = out._replace(growth=out.growth * 250)
    name = w.fresh()
    rows = f"{whole_name}[1]"
    if out.shape == (w.n,):
        rows, shape = f"jnp.moveaxis({rows}, 0, 1)", (w.n, w.m)
    else:
        shape = (w.m,)
    statements.append((name, rows))
    env.append(out._replace(name=name, shape=shape))


FLOWS = [branch, branch, branch, fori, repeat, scan]
