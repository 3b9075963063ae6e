"""Scenarios of a car that can't turn more tightly than on a circle."""
