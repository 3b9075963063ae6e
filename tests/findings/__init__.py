"""Findings of reviews, by area: the smallest case of each, what happened at first, and what happens when it is run."""
