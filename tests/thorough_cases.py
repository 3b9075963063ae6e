"""The mark thorough with names of cases: only these cases are thorough tests, the others stay at the gate."""

from collections.abc import Sequence

import pytest


def keep_quick_cases(tests: Sequence[pytest.Item]) -> None:
    """Remove a mark that names cases from all other cases of one test.

    A mark without names stays: of the whole test, or of a case that has it from pytest.param.

    Args:
        tests: all cases of the test.

    Raises:
        CollectError: the mark names a case that the test does not have.
    """
    named = [str(case) for mark in tests[0].iter_markers("thorough") for case in mark.args] if tests else []
    if not named:
        return
    cases = [test.name.partition("[")[2].removesuffix("]") for test in tests]
    if unknown := [name for name in named if name not in cases]:
        what = f"{tests[0].nodeid.partition('[')[0]}: the mark thorough names {unknown}, which are no cases of the test"
        raise pytest.Collector.CollectError(f"{what}. Its cases: {cases}")
    for test, case in zip(tests, cases, strict=True):
        test.own_markers[:] = [
            m for m in test.own_markers if m.name != "thorough" or not m.args or case in map(str, m.args)
        ]
