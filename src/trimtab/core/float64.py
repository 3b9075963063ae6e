"""JAX, in float64 and with records as pytrees: states are integrated and time is counted in 64 bits everywhere.

Everything that computes imports this first, so that the switch is on before anything is computed. What only declares,
reads or draws does not, and so doesn't wait for JAX.
"""

import os
import threading
from typing import Any

import jax
import jax.numpy as jnp

from trimtab.core.record import PENDING_RECORDS, X64_VARIABLE, X64_WAS_UNSET, Option, declarations

__all__ = ["jax", "jnp", "register_records"]

_LOCK = threading.RLock()


def register_records() -> None:
    """Make every record that waits a pytree: quantities and parts are its children, options its structure."""
    with _LOCK:
        while PENDING_RECORDS:
            _register_pytree(PENDING_RECORDS[0])
            del PENDING_RECORDS[0]  # afterwards: who finds the list empty can rely on it


def _register_pytree(made: Any) -> None:
    declared = declarations(made)
    dynamic = tuple(n for n, d in declared.items() if not isinstance(d, Option))
    static = tuple(n for n, d in declared.items() if isinstance(d, Option))
    keys = tuple(jax.tree_util.GetAttrKey(n) for n in dynamic)

    def aux(r: Any) -> tuple[Any, ...]:
        return tuple(getattr(r, n) for n in static)

    def flatten(r: Any) -> tuple[Any, Any]:
        return [getattr(r, n) for n in dynamic], aux(r)

    def flatten_with_keys(r: Any) -> tuple[Any, Any]:
        return [(k, getattr(r, n)) for k, n in zip(keys, dynamic, strict=True)], aux(r)

    def unflatten(meta: Any, children: Any) -> Any:
        r = object.__new__(made)
        for n, v in zip(dynamic, children, strict=True):
            object.__setattr__(r, n, v)
        for n, v in zip(static, meta, strict=True):
            object.__setattr__(r, n, v)
        return r

    jax.tree_util.register_pytree_with_keys(made, flatten_with_keys, unflatten, flatten)


jax.config.update("jax_enable_x64", True)
if X64_WAS_UNSET and os.environ.get(X64_VARIABLE) == "1":
    del os.environ[X64_VARIABLE]
register_records()
