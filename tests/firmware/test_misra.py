"""The page on MISRA C:2012 has the report of cppcheck and a reason for every violated rule."""

import re
import shutil

import pytest
from firmware.misra import DEVIATIONS, PAGE, PARTS, find_unreasoned, find_violations, page_text


def test_page_matches_list_of_deviations_and_reasons():
    rows = re.findall(r"^\| ([\d.]+) \| (.+?) \| (\d*) \| (\d*) \| (.+?) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert len(rows) > 20
    assert {rule: (title, reason) for rule, title, _, _, reason in rows} == {r: DEVIATIONS[r] for r, *_ in rows}
    assert set(DEVIATIONS) == {rule for rule, *_ in rows}  # no reason without a violation


@pytest.mark.thorough
@pytest.mark.skipif(not shutil.which("cppcheck"), reason="needs Debian's cppcheck")
def test_every_violated_misra_rule_has_a_reason():
    violations = find_violations()
    assert find_unreasoned(violations) == []
    written = {part: len(rows) for part, rows in violations.items()}
    assert all(written[part] > 0 for part in PARTS)
    assert page_text(violations) == PAGE.read_text("utf-8"), "write it again: python tests/firmware/misra.py"
