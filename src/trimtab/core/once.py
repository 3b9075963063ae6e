"""How to compile what runs once: there compiling is what takes the time."""

from typing import Any

FAST_COMPILE_OPTIONS: Any = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
"""For jax.jit(…, compiler_options=QUICKLY)."""
