"""Scenarios of the air-breathing hypersonic vehicle."""
