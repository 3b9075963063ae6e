"""Cache of the C text of compiled blocks, so that a second block with the same content is not traced by JAX again.

Tracing a block with JAX takes a second or more. Loading a cached block takes a few milliseconds. Blocks loaded from the
same C text do not share memory.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from trimtab.compiler.block import BlockDefinition, BlockText, block_text
from trimtab.compiler.compiled_block import CompiledBlock

MOST_KEPT = 64
"""Maximum number of C texts in the cache."""


class Content:
    """Cache key made from records. Two keys are equal if the records have equal structures, types and numbers."""

    def __init__(self, *records: Any) -> None:
        self.records = records
        leaves, self._tree = jax.tree.flatten(records)
        self._numbers = tuple(_describe_leaf(leaf) for leaf in leaves)

    def __hash__(self) -> int:
        return hash((self._tree, self._numbers))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Content) and (self._tree, self._numbers) == (other._tree, other._numbers)


def _describe_leaf(leaf: Any) -> Any:
    """Return a hashable description of a leaf of a record.

    The description of an array consists of type, shape and bytes. Any other object is its own description, or is
    described by its id if it is not hashable.
    """
    array = np.asarray(leaf)
    if array.dtype != np.dtype(object):
        return str(array.dtype), array.shape, array.tobytes()
    try:
        hash(leaf)
    except TypeError:
        return id(leaf)  # the record is kept, so no other object gets this id
    return leaf


@functools.lru_cache(MOST_KEPT)
def _keep_text(
    make: Callable[..., BlockDefinition], content: Content, numbers: tuple[tuple[str, int], ...]
) -> BlockText:
    return block_text(make(*content.records, **dict(numbers)))


def compile_kept(make: Callable[..., BlockDefinition], *records: Any, **numbers: int) -> CompiledBlock:
    """Compile a block, or load it if a block of the same content was compiled before.

    Args:
        make: module-level function that makes the block from the records and numbers.
        records: records from which the block is made.
        numbers: seed and run number, by argument name.

    Raises:
        InputError: a JAX operation cannot be translated to C (the message names the source line of the operation), or
            no C compiler is found.
    """
    return CompiledBlock(_keep_text(make, Content(*records), tuple(sorted(numbers.items()))))
