"""Hypersonic vehicle: altitude and speed follow commands that its inside must follow too."""
