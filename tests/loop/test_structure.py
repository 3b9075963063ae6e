"""Mistakes in a user's own law or vehicle, each reported with file, line and fix."""

import pytest
from findings.first_day_slips import SLIPS, answer

QUICK = ("init without key", "dynamics returns nothing")


@pytest.mark.thorough(*(name for name in SLIPS if name not in QUICK))
@pytest.mark.parametrize("name", SLIPS)
def test_mistake_is_reported_with_file_line_and_fix(name):
    outcome = answer(name)
    assert outcome.holds, outcome.text
