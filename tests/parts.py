"""Parts of a tier: each test belongs to one of N parts, by a hash of its name.

With `--part K/N`, pytest runs part K only. All parts together are the tier.
"""

import argparse
import zlib

import pytest


def parse_part(text: str) -> tuple[int, int]:
    """Return K and N of "K/N". Raise ArgumentTypeError unless they are whole numbers with 1 <= K <= N."""
    k, _, n = text.partition("/")
    if not (k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
        raise argparse.ArgumentTypeError(f"must be K/N with 1 <= K <= N, for example 2/4, got {text!r}")
    return int(k), int(n)


def is_in_part(name: str, k: int, n: int) -> bool:
    """Return True if a test of this name belongs to part k of n."""
    return zlib.crc32(name.encode()) % n == k - 1


def deselect_other_parts(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the tests that do not belong to the part of the option --part."""
    if config.option.part is not None:
        others = [item for item in items if not is_in_part(item.nodeid, *config.option.part)]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if is_in_part(item.nodeid, *config.option.part)]
