"""Vocabulary: records, messages, interfaces, time, random numbers and the mathematics that all parts share.

Importing it switches JAX to float64: states are integrated and time is counted in 64 bits everywhere.
"""

import jax

jax.config.update("jax_enable_x64", True)
