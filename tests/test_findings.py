"""The command that runs the recorded findings again."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from findings import compiler, first_day, first_day_slips, links
from findings.finding import Finding, Outcome, run_python


def command() -> ModuleType:
    specification = importlib.util.spec_from_file_location("findings_command", Path(__file__).parent / "findings.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def stop() -> Outcome:
    raise ValueError("out of fuel")


CASES = [
    Finding("A1", "f(1)", "2", lambda: Outcome("3", True)),
    Finding("A2", "f(2)", "4", lambda: Outcome("5", False)),
    Finding("A3", "f(3)", "6", stop),
]


def test_each_finding_has_one_row() -> None:
    assert {"compiler", "links"} <= set(command().sets())
    for module in (compiler, links, first_day, first_day_slips):
        ids = [finding.id for finding in module.FINDINGS]
        assert len(set(ids)) == len(ids)
    assert [finding.id for finding in compiler.FINDINGS] == [f"K{k}" for k in range(1, 13)]


def test_prints_original_behaviour_and_current_verdict(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(links, "FINDINGS", CASES)
    assert command().main(["links"]) == 1
    text = capsys.readouterr().out
    assert "A1 holds\n    case      f(1)\n    at first  2\n    now       3\n" in text
    assert "A2 DOES NOT HOLD" in text
    assert "ValueError: out of fuel" in text
    assert text.endswith("do not hold: A2, A3\n")
    assert command().main(["links", "A1"]) == 0


@pytest.mark.parametrize("wrong", [["links", "A9"], ["nothing"]])
def test_refuses_unknown_names(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command().main(wrong)
    assert "choose from" in capsys.readouterr().err


def test_case_that_aborts_its_process_is_reported() -> None:
    assert run_python("print('a'); print('b')") == (0, "b")
    status: Any = run_python("import os; os.abort()")[0]
    assert status != 0
