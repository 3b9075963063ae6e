"""Recomputed publications. Each folder is one study, and each file in it one group of results."""
