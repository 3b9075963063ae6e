"""Keys under which the generator finds values again: each holds all that the value depends on."""

import itertools

import numpy as np

from trimtab.compiler.arrays import scalars, store_in_memory
from trimtab.compiler.ir import Builder, Local
from trimtab.compiler.values import Buffer, Value


def inputs(dtype: str, count: int) -> list[Value]:
    return [Value("input", (), dtype) for _ in range(count)]


def test_constants_are_found_by_bits_and_type() -> None:
    b = Builder()
    numbers = [(0.0, "f64"), (-0.0, "f64"), (np.nan, "f64"), (-np.nan, "f64"), (0.0, "f32"), (-0.0, "f32"), (1, "i32")]
    numbers += [(1, "u32"), (1, "i64"), (1, "bool"), (1, "i8"), (1, "u8")]
    made = [b.const(number, dtype) for number, dtype in numbers]
    assert all(x is not y for x, y in itertools.combinations(made, 2))
    assert all(b.const(number, dtype) is x for (number, dtype), x in zip(numbers, made, strict=True))
    assert b.index(1) is b.const(1, "i32")


def test_computed_values_are_found_by_operation_operands_type_and_table() -> None:
    b = Builder()
    x, y = inputs("f64", 2)
    [i] = inputs("i32", 1)
    tables = [Buffer("f64", 60, "const", data=np.full(60, k)) for k in range(2)]

    def values() -> list[Value]:
        arithmetic = [b.op(op, *v, dtype="f64") for op in ("add", "sub") for v in ((x, y), (y, x))]
        return [*arithmetic, *(b.op("convert", x, dtype=t) for t in ("i32", "i64", "u32"))] + [
            b.load(table, i) for table in tables
        ]

    first, again = values(), values()
    assert all(p is q for p, q in zip(first, again, strict=True))
    assert all(p is not q for p, q in itertools.combinations(first, 2))


def test_values_of_changed_memory_are_read_again() -> None:
    b = Builder()
    buffer, [i] = b.local_buffer("f64", 60), inputs("i32", 1)
    first = b.load(buffer, i)
    b.store(buffer, i, b.const(1.0, "f64"))
    assert b.load(buffer, i) is not first


def test_stored_arrays_are_found_by_their_elements() -> None:
    b = Builder()
    x, y = inputs("f64", 2)
    first = store_in_memory(b, scalars([x, y], (2,), "f64"))
    assert store_in_memory(b, scalars([x, y], (2, 1), "f64")).buffer is first.buffer  # row-major: the same numbers
    assert store_in_memory(b, scalars([y, x], (2,), "f64")).buffer is not first.buffer
    assert store_in_memory(b, scalars([x], (1,), "f64")).buffer is not first.buffer


def test_loop_values_are_forgotten_after_the_loop() -> None:
    b = Builder()
    [x] = inputs("f64", 1)
    inside: list[object] = []

    def body(_: Value) -> None:
        inside.append(b.op("add", x, x, dtype="f64"))
        inside.append(b.memoise("here", lambda: b.local_buffer("f64", 60)))
        inside.append(b.before_all("before", lambda: b.local_buffer("f64", 60)))

    b.repeat(3, body)
    assert b.op("add", x, x, dtype="f64") is not inside[0]
    assert b.memoise("here", lambda: b.local_buffer("f64", 60)) is not inside[1]
    assert b.before_all("before", lambda: b.local_buffer("f64", 60)) is inside[2]
    declared = [item.buffer for item in b.top.items if isinstance(item, Local)]
    assert inside[2] is declared[0]
