"""Scenarios of a cart and a pole."""
