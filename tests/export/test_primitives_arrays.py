"""Arrays, indices, branches and loops, against JAX: scalar C and C++ over lanes, edge values included."""

from collections.abc import Callable

import pytest

from contracts import primitive_groups
from contracts.compiled import Case, differences


@pytest.mark.thorough
@pytest.mark.parametrize("make", primitive_groups.ARRAYS + primitive_groups.CONTROL, ids=lambda make: make.__name__)
def test_array_primitives_agree_with_jax(make: Callable[[], list[Case]]) -> None:
    assert not (wrong := differences(make())), "\n".join(wrong)
