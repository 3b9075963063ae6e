"""JAX, switched to float64: states are integrated and time is counted in 64 bits everywhere.

Part of importing any record, so that the switch is on before anything is computed; not part of importing `trimtab`
itself, so that commands which compute nothing don't wait for JAX.
"""

import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)

__all__ = ["jax", "jnp"]
