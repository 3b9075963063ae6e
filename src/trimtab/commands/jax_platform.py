"""Platform on which JAX computes: the CPU, unless the user selects another platform."""

import os
import sys
from collections.abc import Sequence
from itertools import pairwise

from trimtab.core.errors import InputError, install_command

VARIABLES = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME")
"""Environment variables of JAX that select a platform."""


def choose_platform(words: Sequence[str]) -> None:
    """Select the CPU if the user selects no other platform.

    Raises: InputError if JAX cannot compute on the platform that an environment variable selects.
    """
    asked = [name for name in VARIABLES if os.environ.get(name)]
    if not asked and not _asks_for_gpu(words) and "jax" not in sys.modules:  # JAX reads this when imported
        os.environ[VARIABLES[0]] = "cpu"
    others = [name for name in asked if os.environ[name] != "cpu"]
    if others:
        _check_platform(others[0])


def _asks_for_gpu(words: Sequence[str]) -> bool:
    return "--device=gpu" in words or ("--device", "gpu") in pairwise(words)


def _check_platform(name: str) -> None:
    """Raise InputError if JAX cannot compute on the platform that this environment variable selects."""
    import jax

    try:
        jax.devices()
    except (AssertionError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        problem = f"JAX cannot compute on this platform{f': {reason}' if reason else ''}"
        fix = f"{name}=cpu to compute on the CPU; for a GPU by NVIDIA, {install_command('cuda12', 'jax')}"
        raise InputError(f"{name}={os.environ[name]}", problem, fix=fix) from None
