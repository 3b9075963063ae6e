"""A program written in pieces computes the same numbers, to the bit, as the same program in one function."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler import pieces, workspace
from trimtab.compiler.compiled_block import compile_block
from trimtab.compiler.compiled_function import export_callable
from trimtab.compiler.walk_program import build_program
from trimtab.core.time import ms
from trimtab.export.verify import verify_folder
from trimtab.run.blocks import autopilot_block
from trimtab.run.inputs import flat_inputs, own_inputs, run_inputs
from trimtab.run.program import RunResults, fly_runs, row_numbers
from trimtab.run.runner import prepare_run
from trimtab.run.walk_structure import lower_structure, walk_structure
from trimtab.scenarios.catalogue import load_scenario


def flights(name: str, lanes: int) -> tuple[str, RunResults]:
    scenario, table, written = prepare_run(load_scenario(name)[0], [0], ms(400), ms(1))
    inputs = run_inputs(scenario)
    own = own_inputs(inputs, [3, 4, 5])
    at = frozenset(own)
    program = lower_structure(walk_structure(inputs, table.always, ()))
    numbers = np.concatenate([np.asarray(own[k], float).reshape(3, -1) for k in sorted(own)], axis=1)
    widths = program.width, len(program.final)
    path = build_program(program, lanes, at)
    flown = fly_runs(path, flat_inputs(inputs, at), numbers, table, row_numbers(written), widths, stats=True)
    return program.text(lanes, at), flown


def bound_pieces(monkeypatch: pytest.MonkeyPatch, whole: int = 100, piece: int = 60) -> None:
    bounds = {"FUNCTION_STATEMENTS_MAX": whole, "EXPORTED_STATEMENTS_MAX": whole, "PIECE": piece}
    for bound, size in (bounds | {"CALL_STATEMENTS_MIN": 3}).items():
        monkeypatch.setattr(pieces, bound, size)


@pytest.mark.thorough
@pytest.mark.parametrize("lanes", [0, 4])
@pytest.mark.parametrize("name", ["hovercraft/zero-velocity", "hypersonic/climb-small"])
def test_flight_in_pieces_is_bit_identical(monkeypatch: pytest.MonkeyPatch, name: str, lanes: int) -> None:
    whole, expected = flights(name, lanes)
    bound_pieces(monkeypatch)
    divided, flown = flights(name, lanes)
    assert "fly_piece1(f);" not in whole
    assert divided.count("(f);") > 10
    for a, b in zip(expected, flown, strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("lanes", [0, 4])
def test_pieces_share_workspace_arrays(monkeypatch: pytest.MonkeyPatch, lanes: int) -> None:
    whole, expected = flights("hovercraft/zero-velocity", lanes)
    bound_pieces(monkeypatch)
    monkeypatch.setattr(workspace, "STACK", 64)
    divided, flown = flights("hovercraft/zero-velocity", lanes)
    assert "workspace" not in whole
    assert "(f, workspace);" in divided, "pieces are given the workspace"
    assert re.search(r"f->\w+ = \(\w+ \*\)\(\(char \*\)workspace", divided), "and an array of it is one of several"
    for a, b in zip(expected, flown, strict=True):
        assert a.tobytes() == b.tobytes()


def statements(items: list[Any]) -> int:
    blocks = [
        getattr(item, name) for item in items for name in ("first", "second", "head", "body") if hasattr(item, name)
    ]
    return len(items) + sum(statements(block.items) for block in blocks)


def test_every_piece_is_within_its_size_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    bound_pieces(monkeypatch)
    scenario, table, _ = prepare_run(load_scenario("hovercraft/zero-velocity")[0], [0], ms(400), ms(1))
    program = lower_structure(walk_structure(run_inputs(scenario), table.always, ()))
    runs = [run for runs in pieces.plan_pieces(program.blocks, program.final).runs.values() for run in runs]
    sizes = [statements(items) for number, items in runs if number]
    assert len(sizes) > 10
    assert max(sizes) <= 60


def chains(x: jax.Array, table: jax.Array, small: dict[str, jax.Array]) -> dict[str, Any]:
    """Straight lines, a branch, loops over memory, other types than float64, and a result that is an argument."""
    values = [x[k] for k in range(x.shape[0])]
    for _ in range(3):
        values = [jnp.sin(v) * values[k - 1] + small["gain"] for k, v in enumerate(values)]
    heavy = jax.lax.cond(values[0] > small["bias"], lambda v: jnp.tanh(v) + table[3], lambda v: v * v, values[1])
    long = jnp.cumsum(jnp.concatenate([jnp.stack(values), table * heavy]))
    count = jax.lax.while_loop(lambda c: c[1] > 0.1, lambda c: (c[0] + 1, c[1] * 0.5), (0, jnp.abs(heavy) + 2.0))[0]
    single = jnp.float32(heavy) * jnp.float32(values[2])
    return {"long": long, "count": count, "above": heavy > 0, "single": single, "same": small["bias"], "first": values}


@pytest.mark.thorough
@pytest.mark.parametrize("stack", [1 << 20, 64], ids=["stack", "workspace"])
def test_function_in_pieces_is_bit_identical(monkeypatch: pytest.MonkeyPatch, stack: int) -> None:
    rng = np.random.default_rng(1)
    few = rng.normal(size=(9, 40)), rng.normal(size=100), {"gain": rng.normal(size=9), "bias": rng.normal(size=9)}
    one = (few[0][0], few[1], {"gain": 0.1, "bias": 0.3})
    many = few[0], few[1], few[2]
    whole = trimtab.compile(chains, *one, lanes=4)
    expected = whole(*one), whole.lanes(*many)
    monkeypatch.setattr(pieces, "STACK", stack)
    bound_pieces(monkeypatch)
    divided = trimtab.compile(chains, *one, lanes=4)
    assert "chains_piece3(f" in divided.c_source
    assert "chains_piece" not in whole.c_source
    assert (divided.workspace > 0) == (stack == 64)
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves((divided(*one), divided.lanes(*many))), strict=True):
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes()
    for row in range(9):
        given = few[0][row], few[1], {name: v[row] for name, v in few[2].items()}
        for a, b in zip(jax.tree.leaves(divided(*given)), jax.tree.leaves(expected[1]), strict=True):
            assert a.tobytes() == b[row].tobytes(), "and those of lanes"


@pytest.mark.thorough("stack")
@pytest.mark.parametrize("stack", [1 << 20, 64], ids=["stack", "workspace"])
def test_block_in_pieces_is_bit_identical(monkeypatch: pytest.MonkeyPatch, stack: int) -> None:
    scenario, _ = load_scenario("hovercraft/zero-velocity")

    def steps() -> tuple[Any, list[bytes]]:
        block = compile_block(autopilot_block(scenario))  # not a kept one: the bounds on pieces change
        rows = []
        for k in range(30):
            block.set_inputs({"t": 10_000 * k, "samples.navigation.t": 10_000 * k, "samples.navigation.valid": True})
            block.set_inputs({"samples.navigation.fresh": True, "samples.navigation.value.yaw_rate": 0.01 * k})
            block.step()
            rows.append(block.outputs.tobytes())
        return block.text, rows

    whole, expected = steps()
    bound_pieces(monkeypatch, 40, 12)
    monkeypatch.setattr(pieces, "STACK", stack)
    divided, flown = steps()
    assert "_step_piece2(" in divided.source
    assert "_step_piece" not in whole.source
    assert (f"_FRAME = {divided.frame} }}" in divided.header) == (stack > 64)
    assert (f"_WORKSPACE = {divided.workspace} }}" in divided.header) == (stack == 64)
    assert flown == expected


@pytest.mark.thorough
@pytest.mark.parametrize("stack", [1 << 20, 64], ids=["stack", "workspace"])
def test_exported_function_in_pieces_passes_verify(monkeypatch: pytest.MonkeyPatch, stack: int, tmp_path: Path) -> None:
    bound_pieces(monkeypatch)
    monkeypatch.setattr(pieces, "STACK", stack)
    example = np.linspace(0.1, 1.0, 40), np.linspace(0.2, 2.0, 100), {"gain": 0.1, "bias": 0.3}
    export_callable(chains, example, tmp_path)
    text = (tmp_path / "chains.c").read_text()
    assert "chains_piece2(f, in, out" in text
    assert verify_folder(tmp_path).good
