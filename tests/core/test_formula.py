"""Parser of formulas: the tree of each valid text, and the error for each invalid one."""

import pytest

from trimtab.core.errors import InputError
from trimtab.core.formula import (
    EXAMPLE,
    Arithmetic,
    Connective,
    Literal,
    Predicate,
    SignalPath,
    Temporal,
    is_temporal,
    parse_formula,
)
from trimtab.core.time import ms, seconds


def outline(tree):
    """A tree as nested words, without columns."""
    if isinstance(tree, Literal):
        return f"{tree.value:g} {tree.unit}".strip()
    if isinstance(tree, SignalPath):
        return tree.path if tree.component is None else f"{tree.path}[{tree.component}]"
    if isinstance(tree, Predicate):
        return (tree.relation, outline(tree.left), outline(tree.right))
    if isinstance(tree, Arithmetic):
        return (tree.operator, *map(outline, tree.numbers))
    if isinstance(tree, Connective):
        return (tree.word, *map(outline, tree.formulas))
    assert isinstance(tree, Temporal)
    return (tree.word, tree.low, tree.high, *map(outline, tree.formulas))


X, Y, Z = (">", "x", "0"), (">", "y", "0"), (">", "z", "0")


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        (EXAMPLE, (
            "always", seconds(5), seconds(15), ("<", ("abs", ("-", "truth.yaw_rate", "3 rad/s")), "0.15 rad/s"))),
        ("always x > 0 and y > 0", ("and", ("always", 0, None, X), Y)),
        ("x > 0 or y > 0 and z > 0", ("or", X, ("and", Y, Z))),
        ("x > 0 implies y > 0 implies z > 0", ("implies", X, ("implies", Y, Z))),
        ("x > 0 or y > 0 implies z > 0", ("implies", ("or", X, Y), Z)),
        ("x > 0 and y > 0 until[0, 2 s] z > 0", ("and", X, ("until", 0, seconds(2), Y, Z))),
        ("not x > 0 until y > 0", ("until", 0, None, ("not", X), Y)),
        ("once[20 ms, 0.5 min](x > 0)", ("once", ms(20), seconds(30), X)),
        ("historically[1, inf](x > 0)", ("historically", seconds(1), None, X)),
        ("(x > 0) since[0, 6.5536 ms](y > 0)", ("since", 0, 65536, X, Y)),
        ("eventually(not(always[0,1](x > 0)))", ("eventually", 0, None, ("not", ("always", 0, seconds(1), X)))),
        ("((x)) > ((0))", X),
        ("1 - 2 - x * 3 / y > -abs(-z)", (
            ">", ("-", "-1", ("/", ("*", "x", "3"), "y")), ("negative", ("abs", ("negative", "z"))))),
        ("x > -3 deg and y < 2*(3 - 1)/8", ("and", (">", "x", "-3 deg"), ("<", "y", "0.5"))),
        ("2*(x + y) != .5e1", ("!=", ("*", "2", ("+", "x", "y")), "5")),
        ("a.b_1.c[2]<=3m/s^2", ("<=", "a.b_1.c[2]", "3 m/s^2")),
        ("x < 2 m/s*y", ("<", "x", ("*", "2 m/s", "y"))),
        ("x < 3 deg and y == 1", ("and", ("<", "x", "3 deg"), ("==", "y", "1"))),
        ("x < 5 % or y > 3 °", ("or", ("<", "x", "5 %"), (">", "y", "3 °"))),
    ],
)  # fmt: skip
def test_parses_text_into_the_expected_tree(text, tree):
    assert outline(parse_formula(text)) == tree


@pytest.mark.parametrize(
    ("text", "column", "says"),
    [
        ("", 1, "expected a signal, a number or '(', got the end"),
        ("always", 7, "got the end"),
        ("always(x > 0", 13, "expected ')' that closes '('"),
        ("always(x > 0))", 14, "')' cannot follow a complete formula"),
        ("always[5 s 15 s](x > 0)", 12, "expected ',' between the ends of an interval"),
        ("always[15 s, 5 s](x > 0)", 7, "must begin before it ends"),
        ("always[-1 s, 5 s](x > 0)", 8, "'-' is not a time of at least 0"),
        ("always[1 m, 5 m](x > 0)", 8, "'m' is not a unit of time"),
        ("always[1 ns, 5 s](x > 0)", 8, "must be a whole number of 100 ns"),
        ("alwais(x > 0)", 1, "Fix: write always(…)"),
        ("x > 0 adn y > 0", 7, "Fix: write 'and'"),
        ("x > 0 & y > 0", 7, "'&' is not allowed in a formula.\nFix: write words for operators"),
        ("x = 0", 3, "'=' is not allowed in a formula"),
        ("0 < x < 3", 7, "Fix: write 0 m < x and x < 3 m"),
        ("x", 1, "this is a number, but a formula needs a comparison"),
        ("always(x)", 8, "this is a number"),
        ("always(x > 0) > 1", 10, "this is a formula, but a number is needed"),
        ("abs(x > 0) < 1", 7, "this is a formula, but a number is needed"),
        ("(x > 0) + 1 > 2", 4, "this is a formula, but a number is needed"),
        ("x < 3 dag", 7, "Choices: deg"),
        ("x < 3 y", 7, "unknown unit 'y'"),
        ("x[one] < 3", 3, "'one' is not an index of a component"),
        ("x > 0 until y > 0 until z > 0", 19, "Fix: write (F until G) until H"),
        ("min(x) > 0", 1, "unknown function 'min'"),
    ],
)  # fmt: skip
def test_rejects_invalid_formula_with_the_column(text, column, says):
    with pytest.raises(InputError) as refused:
        parse_formula(text)
    assert f"at column {column}: " in str(refused.value)
    assert says in str(refused.value)
    assert refused.value.fix


def test_rejects_word_after_a_complete_formula():
    with pytest.raises(InputError, match="at column 13: 's' cannot follow a complete formula"):
        parse_formula("x < 3 rad/s s")


def test_recognises_temporal_formulas_by_their_operators():
    assert all(map(is_temporal, ("always(x > 0)", "not once[0,1](x>0)", "x > 0 until y > 0", "( eventually x > 0)")))
    assert not any(map(is_temporal, ("settling:x <= 3", "settling:once <= 3", "mean:law.always > 2", "nonce <= 3")))
