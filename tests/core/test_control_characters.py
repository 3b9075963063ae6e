"""Control characters of files, as they are shown."""

import pytest

from trimtab.core.control_characters import KEPT, show_controls
from trimtab.core.errors import InputError

ATTACKS = (
    "\x1b[2Jproved",
    "a\rproved",
    "a\nproved",
    "\x9b2J",
    "\u202edevorp",
    "\x00",
    "\x7f",
    "\u2028proved",
    "\ud800",
)


@pytest.mark.parametrize("text", ATTACKS)
def test_escapes_control_characters(text):
    shown = show_controls(text)
    assert shown.isprintable()
    assert "\\" in shown


def test_keeps_printable_text():
    assert show_controls("ω² in °, 1 m") == "ω² in °, 1 m"
    assert show_controls("one\n\ttwo\x1b", KEPT) == "one\n\ttwo\\x1b"


@pytest.mark.parametrize("text", ATTACKS)
def test_error_message_contains_no_control_character(text):
    error = InputError(f"file, {text}", f"{text} is unknown", choices=(text,), fix=f"write {text}")
    for line in str(error).split("\n"):
        assert line.isprintable()
    assert error.choices == (text,)
