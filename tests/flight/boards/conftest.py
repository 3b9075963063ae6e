"""The compiler and the emulator of microcontrollers, as in the tests of exports."""

from export.conftest import board_tools

__all__ = ["board_tools"]
