"""The reader of generated C: what C means, and what it refuses."""

import pytest

from compiler.reader.c_grammar import Refusal, tokenize
from compiler.reader.c_machine import Program


def evaluate(body: str, kind: str = "int32_t") -> object:
    return Program(tokenize(f"{kind} f(int32_t n)\n{{\n{body}\n}}\n", {})).call("f", 3)


@pytest.mark.parametrize(
    ("kind", "body", "value"),
    [
        ("int32_t", "return 2147483647 + n;", -2147483646),
        ("uint32_t", "return 0U - 1U;", 4294967295),
        ("int32_t", "return -7 / 2 * 10 + -7 % 2;", -31),
        ("double", "return (double)(0.1f) + n;", 3.100000001490116),
        ("float", "return 16777216.0f + 1.0f;", 16777216.0),
        ("int8_t", "return (int8_t)(n + 126);", -127),
        ("bool", "return -1 < 1U;", False),
        ("int32_t", "int32_t s = 0; for (int32_t i = 0; i < n; i++) { s = s + i * 2; } return s;", 6),
        ("int32_t", "int32_t a[2]; a[0] = 5; { int32_t n = 1; a[n] = 7; } return a[1] > a[0] ? n : 0;", 3),
        ("double", "return fma(0.1, 10.0, -1.0);", 5.551115123125783e-17),
    ],
)
def test_evaluates_c_like_the_standard(kind: str, body: str, value: object) -> None:
    assert evaluate(body, kind) == value


@pytest.mark.parametrize(
    "body",
    [
        "int32_t a; return a;",
        "int32_t a[3]; a[0] = 1; return a[1];",
        "int32_t a[3]; a[n] = 1; return n;",
        "int32_t a[3]; a[0] = 1; return a[n - 4];",
        "return m;",
        "int32_t a = 1; int32_t a = 2; return a;",
        "const int32_t a = 1; a = 2; return a;",
        "if (n < 0) { return 1; }",
        "return n / (n - 3);",
        "return (-1) << n;",
        "return 1 << (n + 30);",
        "return (int32_t)(1e10 * n);",
        "while (true) { n = n + 1; } return n;",
        "n; return n;",
        "return sqrt(1.0, 2.0);",
        "double *p = n; return n;",
        "return 1.5 & n;",
        "return n",
    ],
)
def test_rejects_invalid_c(body: str) -> None:
    with pytest.raises(Refusal):
        evaluate(body)
