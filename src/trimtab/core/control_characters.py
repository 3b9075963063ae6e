"""Control characters in text of unknown origin, shown as escapes, because a terminal would execute them."""

import unicodedata

KEPT = "\n\t"
"""Control characters that only move the cursor forward."""


def show_controls(text: str, kept: str = "") -> str:
    r"""Return a text in which control characters and text-direction characters are replaced by escapes.

    >>> show_controls("mass\n\x1b[2Kproved")
    'mass\\n\\x1b[2Kproved'

    Args:
        text: a name or a value read from a file.
        kept: control characters that are not replaced, e.g. KEPT for several lines.
    """
    if text.isprintable():
        return text
    return "".join(_escape(c) if c not in kept and _is_control(c) else c for c in text)


def _is_control(character: str) -> bool:
    return unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp")


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
