"""Cache of the C text of compiled blocks. A second block with the same content is not traced by JAX again.

Tracing takes a second or more. Loading a cached block takes a few milliseconds. The loaded blocks do not share memory.
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
    """Cache key made from records. Two keys are equal if structure, types and numbers of their records are equal."""

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

    For an array, it is the type, shape and bytes; for any other object, the object itself, or its id if not hashable.
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
        numbers: seed and run, by name.

    Raises:
        InputError: a JAX primitive cannot be written as C (the error names the line that uses it), or no C compiler
            is found.
    """
    return CompiledBlock(_keep_text(make, Content(*records), tuple(sorted(numbers.items()))))
