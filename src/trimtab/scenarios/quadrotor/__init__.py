"""Scenarios of the quadrotor."""
