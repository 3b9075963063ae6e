"""Plugin of pytest that limits the memory and the garbage collection of a process that runs many tests."""

import gc
import sys

import pytest

FILES_BETWEEN_CLEARINGS = 20
"""Number of test files between two clearings. A worker of the gate then takes 2.2 GB at most."""


class Memory:
    """Frees compiled programs now and then, and spares the garbage collector the objects that live to the end."""

    def __init__(self) -> None:
        self._files = 0

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        """Switch garbage collection off while tests are collected: they live to the end."""
        gc.disable()

    def pytest_collection_finish(self) -> None:
        """Exempt tests and modules from garbage collection, and switch it on."""
        gc.collect()
        gc.freeze()
        gc.enable()
        gc.set_threshold(20_000, 20, 100)

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_teardown(self, item: pytest.Item, nextitem: pytest.Item | None) -> None:
        """Clear the caches of JAX after every FILES_BETWEEN_CLEARINGS files: they grow by gigabytes otherwise."""
        if nextitem is not None and nextitem.path == item.path:
            return
        self._files += 1
        if "jax" in sys.modules and self._files % FILES_BETWEEN_CLEARINGS == 0:
            sys.modules["jax"].clear_caches()
