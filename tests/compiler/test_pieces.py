"""A program written in pieces flies the same numbers, to the bit, as the same program in one function."""

import re
from typing import Any

import numpy as np
import pytest

from trimtab.compiler import pieces, workspace
from trimtab.core.time import ms
from trimtab.run.inputs import flat_inputs, own_inputs, run_inputs
from trimtab.run.program import RunResults, fly_runs, row_numbers
from trimtab.run.runner import prepare_run
from trimtab.run.walk_program import build_program, lower_structure, walk_structure
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


@pytest.mark.parametrize("lanes", [0, 4])
@pytest.mark.parametrize("name", ["hovercraft/zero-velocity", "hypersonic/climb-small"])
def test_pieces_fly_the_same_bits(monkeypatch: pytest.MonkeyPatch, name: str, lanes: int) -> None:
    whole, expected = flights(name, lanes)
    monkeypatch.setattr(pieces, "WHOLE", 100)
    monkeypatch.setattr(pieces, "PIECE", 60)
    monkeypatch.setattr(pieces, "LEAST", 3)
    divided, flown = flights(name, lanes)
    assert "piece1(f);" not in whole
    assert divided.count("(f);") > 10
    for a, b in zip(expected, flown, strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("lanes", [0, 4])
def test_pieces_share_arrays_of_the_workspace(monkeypatch: pytest.MonkeyPatch, lanes: int) -> None:
    whole, expected = flights("hovercraft/zero-velocity", lanes)
    for module, bound, size in ((pieces, "WHOLE", 100), (pieces, "PIECE", 60), (pieces, "LEAST", 3)):
        monkeypatch.setattr(module, bound, size)
    monkeypatch.setattr(workspace, "STACK", 64)
    monkeypatch.setattr(workspace, "LARGE", 16)
    divided, flown = flights("hovercraft/zero-velocity", lanes)
    assert "workspace" not in whole
    assert "= f->workspace;" in divided, "pieces find the workspace"
    assert re.search(r"f->\w+ = \(\w+ \*\)\(\(char \*\)workspace", divided), "and an array of it is one of several"
    for a, b in zip(expected, flown, strict=True):
        assert a.tobytes() == b.tobytes()


def statements(items: list[Any]) -> int:
    blocks = [
        getattr(item, name) for item in items for name in ("first", "second", "head", "body") if hasattr(item, name)
    ]
    return len(items) + sum(statements(block.items) for block in blocks)


def test_no_piece_is_larger_than_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "WHOLE", 100)
    monkeypatch.setattr(pieces, "PIECE", 60)
    scenario, table, _ = prepare_run(load_scenario("hovercraft/zero-velocity")[0], [0], ms(400), ms(1))
    program = lower_structure(walk_structure(run_inputs(scenario), table.always, ()))
    runs = [run for runs in pieces.plan_pieces(program.blocks, program.final).runs.values() for run in runs]
    sizes = [statements(items) for number, items in runs if number]
    assert len(sizes) > 10
    assert max(sizes) <= 60
