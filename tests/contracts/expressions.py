"""Random expressions: each function gives the text and what it is (a Var without name)."""

from typing import Any

from contracts.variables import DTYPES, INTEGERS, Var

Made = tuple[str, Var]


def _float(shape: Any, *of: Var, size: int | None = None, fine: int | None = None, factor: float = 1.0) -> Var:
    """A float made of others: exact where they all are and a size is given."""
    exact = all(v.exact for v in of) and size is not None
    growth = factor * sum(v.growth for v in of) if not exact else 1.0
    return Var("", "f", shape, exact, size or 0, fine or 0, growth)


def _two(w: Any, env: list[Var], kind: str, exact: bool | None = None) -> tuple[Var, Var, Any]:
    shape = w.one(w.shapes)
    x, y = w.pick(env, kind, shape, exact), w.pick(env, kind, shape, exact)
    return x, y, max(x.shape, y.shape, key=len)


def sums(w: Any, env: list[Var]) -> Made:
    x, y, shape = _two(w, env, "f")
    return f"{x.name} {w.one('+-')} {y.name}", _float(
        shape, x, y, size=max(x.size, y.size) + 1, fine=max(x.fine, y.fine)
    )


def products(w: Any, env: list[Var]) -> Made:
    x, y, shape = _two(w, env, "f")
    if not (x.exact and y.exact):
        x, y = (v if not v.exact else v._replace(name=f"jnp.sin({v.name})", exact=False) for v in (x, y))
    return f"{x.name} * {y.name}", _float(shape, x, y, size=x.size + y.size, fine=x.fine + y.fine)


def extremes(w: Any, env: list[Var]) -> Made:
    x, y, shape = _two(w, env, "f")
    text = f"jnp.{w.one(['maximum', 'minimum'])}({x.name}, {y.name})"
    return text, _float(shape, x, y, size=max(x.size, y.size), fine=max(x.fine, y.fine))


def signs(w: Any, env: list[Var]) -> Made:
    x = w.pick(env, "f")
    return w.one(["-{}", "jnp.abs({})"]).format(x.name), x


def elementary(w: Any, env: list[Var]) -> Made:
    x, y, shape = _two(w, env, "f")
    a, b = (f"jnp.clip({w.whole(v, shape)}, -1.0, 1.0)" for v in (x, y))
    texts = ["jnp.sin({0})", "jnp.cos({0})", "jnp.tanh({0})", "jnp.exp({0} - 1)", "jnp.sqrt(1 + {0} * {0}) - 1"]
    texts += [
        "{0} / (1 + {1} * {1})",
        "jnp.arctan2({0}, 2 + {1})",
        "jnp.log1p(jnp.abs({0}))",
        "0.5 * {0} ** 3 + 0.25 * {1}",
    ]
    texts += ["jnp.arcsin(0.5 * {0})", "jax.nn.sigmoid({0}) * {1}", "lax.rsqrt(1 + {0} * {0})"]
    return w.one(texts).format(a, b), _float(shape, x, y, factor=2.0)


def roundings(w: Any, env: list[Var]) -> Made:
    x = w.pick(env, "f", exact=True)
    name = w.one(["floor", "ceil", "round", "sign", "trunc"])
    return f"jnp.{name}({x.name})", _float(x.shape, x, size=x.size + 1, fine=0)


def integers(w: Any, env: list[Var]) -> Made:
    kind = w.one(INTEGERS)
    x, y, shape = _two(w, env, kind)
    x, y = (w.whole(v, shape) for v in (x, y))
    texts = ["{0} + {1}", "{0} - {1}", "{0} * {1}", "{0} & {1}", "{0} ^ {1}"]
    # a divisor that XLA knows to be zero brings its compiler down: never zero here; tests of primitives divide by zero
    texts += ["lax.div({0}, {1} | 1)", "lax.rem({0}, {1} | 1)"]
    texts += [
        "{0} | {1}",
        "lax.shift_left({0}, {1} % 40)",
        "lax.shift_right_logical({0}, {1} % 40)",
        "{0} // ({1} | 1)",
    ]
    texts += [
        "lax.shift_right_arithmetic({0}, {1} % 40)",
        "jnp.maximum({0}, {1})",
        "jnp.minimum({0}, {1})",
        "{0} % ({1} | 1)",
    ]
    texts += [
        "~{0}",
        "jnp.sign({0})",
        "lax.population_count({0})",
        "lax.clz({0})",
        "{0} * 3 - 7",
        "lax.div({0}, {0} * 0 + 5)",
    ]
    return w.one(texts).format(x, y), Var("", kind, shape)


def truths(w: Any, env: list[Var]) -> Made:
    kind = w.one(["f", "b", *INTEGERS])
    x, y, shape = _two(w, env, kind, True if kind == "f" else None)
    compare = w.one(["<", "<=", ">", ">=", "==", "!="]) if kind != "b" else w.one(["&", "|", "^", "!=", "=="])
    text = f"{x.name} {compare} {y.name}"
    if kind == "f" and w.chance(0.2):
        text, shape = f"jnp.isfinite({x.name})", x.shape
    if w.chance(0.2):
        text = f"~({text})" if shape else f"jnp.logical_not({text})"
    return f"jnp.asarray({text})", Var("", "b", shape)


def conversions(w: Any, env: list[Var]) -> Made:
    source, to = w.one(["f", "b", *INTEGERS]), w.one(["f", "b", *INTEGERS])
    x = w.pick(env, source, exact=True)
    if to == "f" and source in INTEGERS:
        return f"(({x.name}) % 16).astype('float64') / 4", Var("", "f", x.shape, size=3, fine=2)
    made = Var("", to, x.shape, size=x.size if source == "f" else 1, fine=x.fine if source == "f" else 0)
    return f"jnp.asarray({x.name}).astype('{DTYPES[to]}')", made


def selects(w: Any, env: list[Var]) -> Made:
    kind, shape = w.one(["f", "f", "b", *INTEGERS]), w.one(w.shapes)
    test, x, y = w.pick(env, "b", shape), w.pick(env, kind, shape), w.pick(env, kind, shape)
    shape = max(test.shape, x.shape, y.shape, key=len)
    made = (
        _float(shape, x, y, size=max(x.size, y.size), fine=max(x.fine, y.fine)) if kind == "f" else Var("", kind, shape)
    )
    if w.chance(0.3):
        which = w.pick(env, "i32", shape)
        shape = max(which.shape, shape, key=len)
        arrays = ", ".join(w.whole(v, shape) for v in (x, y, x))
        return f"lax.select_n({w.whole(which, shape)} % 3, {arrays})", made._replace(shape=shape)
    return f"jnp.where({test.name}, {x.name}, {y.name})", made


def reductions(w: Any, env: list[Var]) -> Made:
    kind = w.one(["f", "f", "i32", "i64", "u32", "b"])
    x = w.pick(env, kind)
    axis = w.one([None, *range(len(x.shape))])
    shape = () if axis is None else tuple(n for a, n in enumerate(x.shape) if a != axis)
    arguments = f"{x.name}, axis={axis}"
    if kind == "b":
        return f"jnp.{w.one(['any', 'all'])}({arguments})", Var("", "b", shape)
    if kind != "f":
        name = w.one(["sum", "prod", "max", "min"])
        return f"jnp.{name}({arguments}).astype('{DTYPES[kind]}')", Var("", kind, shape)
    if w.chance(0.5):
        return f"jnp.{w.one(['max', 'min'])}({arguments})", x._replace(shape=shape)
    if x.exact:
        return f"jnp.sum({arguments})", _float(shape, x, size=x.size + 10, fine=x.fine)
    return f"jnp.mean({arguments})", _float(shape, x, factor=1.0)


def positions(w: Any, env: list[Var]) -> Made:
    kind = w.one(["f", *INTEGERS, "b"])
    x = w.pick(env, kind, exact=True)
    axis = w.one(range(len(x.shape))) if x.shape else 0
    shape = tuple(n for a, n in enumerate(x.shape) if a != axis)
    return f"jnp.{w.one(['argmax', 'argmin'])}(jnp.atleast_1d({x.name}), {axis})", Var("", "i64", shape)


def running(w: Any, env: list[Var]) -> Made:
    kind = w.one(["f", "i32", "i64"])
    x = w.pick(env, kind, (w.one([w.n, w.m]),))
    backwards = w.chance(0.5)
    name = w.one(["cumsum", "cummax", "cummin"]) if x.exact else w.one(["cummax", "cummin"])
    made = _float(x.shape or (1,), x, size=x.size + 7, fine=x.fine) if kind == "f" else Var("", kind, x.shape or (1,))
    return f"lax.{name}(jnp.atleast_1d({x.name}), 0, reverse={backwards})", made


def dots(w: Any, env: list[Var]) -> Made:
    kind = w.one(["f", "f", "i32", "i64"])
    sides = [((w.n, w.m), (w.m,), (w.n,)), ((w.n,), (w.n, w.m), (w.m,)), ((w.n,), (w.n,), ())]
    a, b, shape = w.one([*sides, ((w.n, w.m), (w.n, w.m), (w.m, w.m))])
    x, y = w.pick(env, kind, a), w.pick(env, kind, b)
    first = w.whole(x, a) + (".T" if a == b and len(a) == 2 else "")
    text = f"{first} @ {w.whole(y, b)}"
    if kind != "f":
        return text, Var("", kind, shape)
    if x.exact and y.exact and x.size + y.size + x.fine + y.fine + 6 <= 50:
        return text, _float(shape, x, y, size=x.size + y.size + 6, fine=x.fine + y.fine)
    first, second = (f"jnp.clip({t}, -1.0, 1.0)" for t in (first, w.whole(y, b)))
    return f"({first} @ {second}) / {a[-1]}", _float(shape, x, y)


def _any(w: Any, env: list[Var], shape: Any = None) -> Var:
    return w.pick(env, w.one(["f", "f", "f", "i32", "i64", "u32", "b"]), shape)


def moved(w: Any, env: list[Var]) -> Made:
    shape = w.one([(w.n,), (w.n, w.m), (w.n, w.m)])
    v = _any(w, env, shape)
    x, k = w.whole(v, shape), int(w.rng.integers(0, shape[0]))
    texts = [f"{x}[::-1]", f"jnp.roll({x}, {k}, 0)", f"jnp.concatenate([{x}[{k}:], {x}[:{k}]])", f"jnp.flip({x})"]
    texts += [f"{x}.reshape(-1)[::-1].reshape({shape})"]
    texts += [f"lax.pad({x}, jnp.zeros((), {x}.dtype), [({-k}, {k}, 0){', (1, -1, 0)' * (len(shape) - 1)}])"]
    if len(shape) == 2:
        texts += [
            f"{x}.T.reshape({shape})",
            f"jnp.stack([{x}[:, i] for i in range({w.m})], 1)",
            f"jnp.tile({x}[:1], ({w.n}, 1))",
        ]
    return w.one(texts), v._replace(shape=shape)


def part(w: Any, env: list[Var]) -> Made:
    shape = w.one([(w.n,), (w.n, w.m)])
    v, i = _any(w, env, shape), w.pick(env, w.one(INTEGERS), ())
    x = w.whole(v, shape)
    if len(shape) == 1:
        texts = [
            (f"{x}[{i.name}]", ()),
            (f"{x}.at[{i.name}].get(mode='clip')", ()),
            (f"{x}[{int(w.rng.integers(shape[0]))}]", ()),
        ]
    else:
        texts = [
            (f"{x}[{i.name}]", (w.m,)),
            (f"{x}[:, {i.name} % {w.m}]", (w.n,)),
            (f"lax.dynamic_slice({x}, ({i.name}, {i.name}), (1, {w.m}))[0]", (w.m,)),
        ]
    text, made = w.one(texts)
    return text, v._replace(shape=made)


def taken(w: Any, env: list[Var]) -> Made:
    shape = w.one([(w.n,), (w.n, w.m)])
    v, i = _any(w, env, shape), w.pick(env, w.one(INTEGERS), (w.n,))
    x, at = w.whole(v, shape), w.whole(i, (w.n,))
    mode = "clip" if v.kind == "f" and not v.exact else w.one(["clip", "fill"])
    if v.kind == "f" and w.chance(0.3):
        table = "jnp.array([0.25, 2.0, -1.5, 4.0, 8.0, 0.5, -3.0, 1.0])"
        return f"{table}[{at} % 8]", Var("", "f", (w.n,), size=3, fine=2)
    return f"{x}.at[{at}].get(mode='{mode}')", v._replace(shape=shape)


def updated(w: Any, env: list[Var]) -> Made:
    shape = w.one([(w.n,), (w.n,), (w.n, w.m)])
    v = _any(w, env, shape)
    x = w.whole(v, shape)
    new, i = w.pick(env, v.kind, shape[1:]), w.pick(env, w.one(INTEGERS), ())
    value = w.whole(new, shape[1:])
    both = (
        _float(shape, v, new, size=max(v.size, new.size), fine=max(v.fine, new.fine))
        if v.kind == "f"
        else v._replace(shape=shape)
    )
    sum_ = _float(shape, v, new, size=both.size + 7, fine=both.fine) if v.kind == "f" else both
    at = f"{x}.at[{i.name}]"
    texts = [(f"{at}.set({value})", both), (f"{x}.at[{int(w.rng.integers(shape[0]))}].set({value})", both)]
    texts += [
        (f"lax.dynamic_update_slice({x}, {value}[None], ({i.name}{', ' + i.name if len(shape) == 2 else ''},))", both)
    ]
    if v.kind != "b":
        texts += [(f"{at}.add({value}, mode='{w.one(['drop', 'clip'])}')", sum_), (f"{at}.max({value})", both)]
        if v.kind != "f" or v.exact:
            many = w.whole(w.pick(env, w.one(INTEGERS), (w.n,)), (w.n,))
            texts += [(f"{x}.at[{many}].add({value})", sum_), (f"{x}.at[{many} % {shape[0]}].min({value})", both)]
    return w.one(texts)


EXPRESSIONS = [sums, products, extremes, signs, elementary, elementary, roundings, integers, integers, truths, truths]
EXPRESSIONS += [
    conversions,
    selects,
    selects,
    reductions,
    positions,
    running,
    dots,
    moved,
    part,
    taken,
    updated,
    updated,
]
EXPRESSIONS += [updated, integers]
