"""Compiled functions are compared with JAX in float64, which importing the compiler does not switch on."""

import jax

jax.config.update("jax_enable_x64", True)
