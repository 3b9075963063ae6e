"""Thousands of runs: what is dispersed, where it runs, what it says."""
