"""The page on MISRA C:2012 says what cppcheck says today, and argues every rule that is broken."""

import re
import shutil

import pytest
from firmware.misra import DEVIATIONS, PAGE, PARTS, find_violations, page_text, unargued


def test_each_rule_on_the_page_is_argued_as_in_the_list():
    rows = re.findall(r"^\| ([\d.]+) \| (.+?) \| (\d*) \| (\d*) \| (.+?) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert len(rows) > 20
    assert {rule: (title, reason) for rule, title, _, _, reason in rows} == {r: DEVIATIONS[r] for r, *_ in rows}
    assert set(DEVIATIONS) == {rule for rule, *_ in rows}  # nothing is argued that is not broken


@pytest.mark.thorough
@pytest.mark.skipif(not shutil.which("cppcheck"), reason="needs Debian's cppcheck")
def test_nothing_is_broken_that_is_not_argued():
    violations = find_violations()
    assert unargued(violations) == []
    written = {part: len(rows) for part, rows in violations.items()}
    assert all(written[part] > 0 for part in PARTS)
    assert page_text(violations) == PAGE.read_text("utf-8"), "write it anew: python tests/firmware/misra.py"
