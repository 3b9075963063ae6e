"""Primitives that are programs of others, against JAX: scalar C and C++ over lanes."""

from collections.abc import Callable

import pytest

from contracts import primitive_groups
from contracts.compiled import Case, differences


@pytest.mark.thorough
@pytest.mark.parametrize("make", primitive_groups.LIBRARY, ids=lambda make: make.__name__)
def test_library_primitives_agree_with_jax(make: Callable[[], list[Case]]) -> None:
    assert not (wrong := differences(make())), "\n".join(wrong)
