"""Flights of the hypersonic vehicle, and the design of its gains."""
